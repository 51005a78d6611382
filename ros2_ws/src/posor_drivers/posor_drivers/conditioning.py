# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Conditioning of raw scans: several scans of a source become one, with mean, spread, background and flags."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from posor.errors import BagError, ParameterError, PosorError
from posor.model.scan import CONTACTS
from posor.numerics.stamps import NS, time_ns
from posor.ros_names import RAW_TOPIC
from posor_msgs.msg import RawScan
from rclpy.serialization import deserialize_message

from posor_drivers.sample_average import SampleAverage, average_samples
from posor_drivers.sources.source import SourceMessage
from posor_drivers.tick_scheduler import Pause

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from posor_drivers.driver_parameters import ConditioningParameters

MAX_SAMPLES = 65_535
"""Greatest value of ``RawScan.samples``."""
MAX_DARK_SCANS = 100
"""Dark scans in a row that count as neighbours of a lit scan; that many end a group, so that it is not delayed."""
DIODE_CURRENTS = "diode_currents"
READINGS = {"gap_voltages": 1, "ring_voltages": 1, DIODE_CURRENTS: CONTACTS}
"""Fields of readings, and how many readings are kept or dropped together."""
SPREADS = {name: f"{name.removesuffix('s')}_spreads" for name in READINGS}
"""Fields of their spreads."""

TIMES = ("exposure_span", "stamp_uncertainty", "stamp_limit")
"""Fields on the times of a scan, of which the largest of a group is taken."""

ItemT = TypeVar("ItemT", bound=SourceMessage | Pause)


@dataclass
class ScanGroup:
    """Scans (posor_msgs/RawScan) that become one, in the order of exposure."""

    lit: list[Any] = field(default_factory=list)
    """Scans to average; without background subtraction these are all scans, lit or dark."""
    earlier_dark: list[Any] = field(default_factory=list)
    """Dark scans directly before the first lit scan that also belong to the group before."""
    dark: list[Any] = field(default_factory=list)  # dark scans before, between and directly after the lit scans
    trailing: int = 0  # number of dark scans after the last lit scan

    @property
    def status(self) -> int:
        """The flags of all scans; the home mark of a dark scan counts in one group only."""
        status = 0
        for scan in self.lit + self.dark:
            status |= scan.status
        for scan in self.earlier_dark:
            status |= scan.status & ~RawScan.STATUS_HOME_BUMP
        return status

    def next_group(self) -> ScanGroup:
        """Return the group after this one; the dark scans between two groups are neighbours of both."""
        return ScanGroup(earlier_dark=self.dark[len(self.dark) - self.trailing :])


class ScanGrouper:
    """Divides a stream of scans into groups of ``size`` lit scans.

    A group ends early where light source or readings change, the clock steps back, or the stream ends. Groups end
    before multiples of ``size`` of the scan numbers, so that those of all joints of an arm have the same stamps,
    whenever a driver begins or a group ends early; with ``subtract_dark`` they do not, because dark scans do not count.
    """

    def __init__(self, size: int, *, subtract_dark: bool) -> None:
        """Start with an empty group; with ``subtract_dark``, dark scans are background and do not count."""
        self._size = size
        self._subtract_dark = subtract_dark
        self._group = ScanGroup()
        self._previous: Any = None

    def add_scan(self, scan: Any) -> Iterator[ScanGroup]:
        """Add a scan and yield the groups that are now complete."""
        dark = self._subtract_dark and is_dark(scan)
        group = self._group
        if self._previous is not None and not _are_comparable(self._previous, scan):
            yield from self.finish()
            self._group = ScanGroup()
        elif group.lit and not dark and (len(group.lit) == self._size or _source(group.lit[-1]) != _source(scan)):
            yield self._close_group()
        self._previous = scan
        if dark:
            yield from self._add_dark_scan(scan)
        else:
            self._group.lit.append(scan)
            self._group.trailing = 0
            is_last = len(self._group.lit) == self._size or (scan.scan + 1) % self._size == 0
            if is_last and not self._subtract_dark:
                yield self._close_group()

    def finish(self) -> Iterator[ScanGroup]:
        """Yield the incomplete group if it holds a lit scan."""
        if self._group.lit:
            yield self._close_group()

    def _add_dark_scan(self, scan: Any) -> Iterator[ScanGroup]:
        group = self._group
        group.dark.append(scan)
        group.trailing += 1
        if group.lit and group.trailing == MAX_DARK_SCANS:
            yield self._close_group()
        elif not group.lit and len(group.earlier_dark) + len(group.dark) > MAX_DARK_SCANS:
            (group.earlier_dark or group.dark).pop(0)

    def _close_group(self) -> ScanGroup:
        group, self._group = self._group, self._group.next_group()
        return group


def is_dark(scan: Any) -> bool:
    """Return whether no light source was lit."""
    return len(scan.lit_sources) > 0 and all(lit == RawScan.NO_SOURCE for lit in scan.lit_sources)


def stamp_ns(scan: Any) -> int:
    """Return the stamp, the middle of the exposure [ns]."""
    return time_ns(scan.header.stamp.sec, scan.header.stamp.nanosec)


def _are_comparable(before: Any, scan: Any) -> bool:
    """Return whether two successive scans may belong to one group, or be background of one another.

    Where scans are missing between them, their mean would be that of no time.
    """

    def layout(scan: Any) -> tuple[object, ...]:
        readings = (scan.gap_voltages, scan.ring_voltages, scan.diode_currents, scan.lit_sources, scan.exposure_offsets)
        return (scan.header.frame_id, *map(len, readings))

    earlier, later = stamp_ns(before), stamp_ns(scan)
    has_gap = scan.scan > before.scan + 1
    return earlier <= later and (earlier == 0) == (later == 0) and not has_gap and layout(before) == layout(scan)


def _source(scan: Any) -> tuple[object, ...]:
    """Return what must be equal in a group: the lit sources, and whether the background is subtracted already."""
    return (*scan.lit_sources, scan.status & RawScan.STATUS_DARK_SUBTRACTED)


def condition_scans(items: Iterator[ItemT], parameters: ConditioningParameters) -> Iterator[ItemT | SourceMessage]:
    """Return what is to be published: groups of scans become one scan, everything else passes unchanged.

    A scan is published with the last scan of its group, or with the first scan that shows that the group is complete.
    An incomplete group is published at the end, also if the source fails.

    Raises:
        ParameterError: Dark scans are to be subtracted, but all scans are dark.
        PosorError: A scan cannot be decoded or is invalid, or the source cannot be read.

    """
    return items if parameters.passes_scans_unchanged else _condition(items, parameters)


def _condition(items: Iterator[ItemT], parameters: ConditioningParameters) -> Iterator[ItemT | SourceMessage]:
    grouper = ScanGrouper(parameters.samples, subtract_dark=parameters.subtract_dark)
    after_s, all_dark, count = 0.0, True, 0
    failure = None
    try:
        for item in items:
            if isinstance(item, Pause) or item.topic != RAW_TOPIC:
                yield item
                continue
            scan, after_s = decode_scan(item.data), item.after_s
            count, all_dark = count + 1, all_dark and is_dark(scan)
            for group in grouper.add_scan(scan):
                merged = merge_scans(group, parameters)
                yield SourceMessage(RAW_TOPIC, stamp_ns(merged) if item.time_ns else 0, merged, after_s)
    except PosorError as error:
        failure = error
    for group in grouper.finish():
        yield SourceMessage(RAW_TOPIC, 0, merge_scans(group, parameters), after_s)
    if failure is not None:
        raise failure
    if parameters.subtract_dark and all_dark:
        what, where = f"no light source was lit in any of the {count} scans", "parameter 'conditioning.subtract_dark'"
        raise ParameterError(what, where=where, expected="false, or lit scans among the dark ones")


def decode_scan(content: Any) -> Any:
    """Return a scan as a message.

    Raises:
        PosorError: The bytes are not a scan, or the scan is the mean of 0 samples.

    """
    if isinstance(content, bytes):
        try:
            content = deserialize_message(content, RawScan)
        except RuntimeError:
            what = f"the {len(content)} bytes of a scan cannot be decoded"
            raise BagError(what, where=f"topic {RAW_TOPIC}") from None
    if not content.samples:
        raise PosorError("is the mean of 0 samples", where=f"scan {content.scan}", expected="at least 1")
    return content


def merge_scans(group: ScanGroup, parameters: ConditioningParameters) -> Any:
    """Return the scan (posor_msgs/RawScan) that a group of scans becomes.

    Its stamp is half-way between the first and the last lit scan, its number that of the middle one (the earlier of two
    middle ones), so both still refer to the source's scan clock.

    Raises:
        PosorError: There are more samples than the message can hold.

    """
    lit, significance = group.lit, parameters.significance if parameters.method == "trimmed" else None
    first, middle, last = lit[0], lit[(len(lit) - 1) // 2], lit[-1]
    scan = RawScan(scan=middle.scan, status=group.status, lit_sources=middle.lit_sources)
    scan.header.frame_id = middle.header.frame_id
    scan.header.stamp.sec, scan.header.stamp.nanosec = divmod((stamp_ns(first) + stamp_ns(last)) // 2, NS)
    for name in TIMES:  # the error of a mean stamp may be common to all stamps
        setattr(scan, name, max(getattr(each, name) for each in lit))
    averages = {name: _average_readings(lit, name, significance) for name in READINGS}
    scan.exposure_span += (stamp_ns(last) - stamp_ns(first)) / NS
    scan.exposure_offsets = (
        _mean_offsets(lit, averages.values(), stamp_ns(scan)) if len(lit) > 1 else first.exposure_offsets
    )
    means = {name: average.means for name, average in averages.items()}
    dropped = any(average.dropped for average in averages.values())
    dark = group.earlier_dark + group.dark
    if dark and means[DIODE_CURRENTS].size and not scan.status & RawScan.STATUS_DARK_SUBTRACTED:
        background = _average_readings(dark, DIODE_CURRENTS, significance)
        means[DIODE_CURRENTS] = means[DIODE_CURRENTS] - background.means
        scan.status |= RawScan.STATUS_DARK_SUBTRACTED
        dropped |= background.dropped
    counts = [int(count) for average in averages.values() for count in average.counts]
    samples = min(counts, default=sum(sample.samples for sample in lit))
    if samples > MAX_SAMPLES:
        where = f"scans {first.scan} to {last.scan}"
        raise PosorError(f"are the mean of {samples} samples", where=where, expected=f"at most {MAX_SAMPLES}")
    scan.samples = samples
    for name, average in averages.items():
        setattr(scan, name, means[name].ravel().tolist())
        if samples > 1:
            setattr(scan, SPREADS[name], average.spreads.ravel().tolist())
    for name in ("supply_voltage", "temperature", "reference_voltage"):
        value, lost = _average_measured(lit, name, significance)
        setattr(scan, name, value)
        dropped |= lost
    scan.status |= RawScan.STATUS_OUTLIERS_DROPPED * dropped
    return scan


def _mean_offsets(lit: Sequence[Any], averages: Iterable[SampleAverage], middle_ns: int) -> list[float]:
    """Return the mean exposure of the readings that each channel kept, after the stamp of the mean [s]."""
    after_s = np.array([[(stamp_ns(each) - middle_ns) / NS] for each in lit])
    weights = np.hstack([np.repeat(each.weights, each.means.shape[1], axis=1) for each in averages])
    if (count := len(lit[0].exposure_offsets)) not in (0, weights.shape[1]):
        what, expected = f"has {count} exposure_offsets", f"one of each channel, {weights.shape[1]}, or none"
        raise PosorError(what, where=f"scan {lit[0].scan}", expected=expected)
    offsets_s = after_s + np.array([each.exposure_offsets or [0.0] * weights.shape[1] for each in lit])
    kept = np.where(weights > 0, weights * offsets_s, 0.0)  # an unknown exposure of a dropped reading
    return (kept.sum(axis=0) / weights.sum(axis=0)).tolist() if weights.shape[1] else []


def _average_readings(scans: Sequence[Any], name: str, significance: float | None) -> SampleAverage:
    """Average one field of readings; the spread of a sample that has none is NaN."""
    unit = READINGS[name]
    samples = np.array([getattr(scan, name) for scan in scans], dtype=np.float64)
    size = samples.shape[1]
    shape = (len(scans), -1, unit) if size and size % unit == 0 else (len(scans), size, 1)
    known = [getattr(scan, SPREADS[name]) for scan in scans]
    spreads = np.array([spread if len(spread) == size else np.full(size, np.nan) for spread in known], dtype=np.float64)
    counts = np.array([scan.samples for scan in scans], dtype=np.int64)
    return average_samples(samples.reshape(shape), counts, spreads.reshape(shape), significance)


def _average_measured(scans: Sequence[Any], name: str, significance: float | None) -> tuple[float, bool]:
    """Return the mean over the scans that hold a quantity, NaN without any, and whether an outlier was dropped."""
    measured = [scan for scan in scans if not np.isnan(getattr(scan, name))]
    if not measured:
        return float("nan"), False
    values = np.array([getattr(scan, name) for scan in measured], dtype=np.float64)
    counts = np.array([scan.samples for scan in measured], dtype=np.int64)
    average = average_samples(values.reshape(-1, 1, 1), counts, None, significance)
    return float(average.means[0, 0]), average.dropped
