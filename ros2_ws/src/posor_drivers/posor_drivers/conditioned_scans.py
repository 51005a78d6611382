"""Makes one scan of several: mean, spread, background, flags."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import numpy as np
from posor_estimator.errors import BagError, ParameterError, PosorError
from posor_estimator.ros.parameters import ParameterGroup
from posor_estimator.ros.qos import RAW_TOPIC
from posor_msgs.msg import RawScan
from pydantic import Field, model_validator
from rclpy.serialization import deserialize_message

from posor_drivers.conditioning import LEAST_SAMPLES, Average, average
from posor_drivers.scan_groups import Group, ScanGroups, is_dark, stamp_of
from posor_drivers.timeline import Due, Pause

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

CONTACTS = 4
MOST_SAMPLES = 65_535
"""What the message can hold."""

DueT = TypeVar("DueT", bound=Due | Pause)
"""What a recorded source gives, and what a live one gives."""

READINGS = (
    ("gap_voltages", "gap_voltage_spreads", 1),
    ("ring_voltages", "ring_voltage_spreads", 1),
    ("diode_currents", "diode_current_spreads", CONTACTS),
)
"""Readings, their spreads, and how many of them are kept or dropped together."""


class ConditioningParameters(ParameterGroup):
    """How the scans of a source become those that are published."""

    method: Literal["none", "mean", "trimmed"] = Field(
        default="none",
        description="how several scans become one; trimmed: the mean without outliers, one in five at most",
    )
    samples: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=1, description="consecutive scans of the source that become one published scan"
    )
    significance: Annotated[float, Field(gt=0.0, le=0.2)] = Field(
        default=0.01, description="method trimmed: probability that a probe or diode without outliers loses a sample"
    )
    subtract_dark: bool = Field(
        default=False, description="subtract the mean of the neighbouring scans without light from the diode currents"
    )

    @model_validator(mode="after")
    def _samples_fit_method(self) -> ConditioningParameters:
        least = {"none": 1, "mean": 2, "trimmed": LEAST_SAMPLES}[self.method]
        if self.samples < least:
            text = (
                f"'conditioning.samples' {self.samples} is too few for 'conditioning.method' '{self.method}'; "
                f"expected at least {least}"
            )
            raise ValueError(text)
        if self.method == "none" and self.samples > 1:
            text = (
                f"'conditioning.samples' is {self.samples} but 'conditioning.method' is 'none'; "
                "expected method 'mean' or 'trimmed', or 1 sample"
            )
            raise ValueError(text)
        return self

    @property
    def is_idle(self) -> bool:
        """Whether scans are published as the source gives them."""
        return self.method == "none" and not self.subtract_dark


def conditioned(dues: Iterator[DueT], parameters: ConditioningParameters) -> Iterator[DueT | Due]:
    """Return what is to be published, several scans made one; everything else is passed on, in its place.

    A scan goes out with the last of those that it is made of, or with the one that shows that no more will come. One
    that was begun goes out at the end, also if the source fails.

    Raises:
        ParameterError: dark scans are to be subtracted, but there are no others.
        PosorError: a scan cannot be decoded or says what cannot be, or the source cannot be read.

    """
    return dues if parameters.is_idle else _conditioned(dues, parameters)


def _conditioned(dues: Iterator[DueT], parameters: ConditioningParameters) -> Iterator[DueT | Due]:
    groups = ScanGroups(parameters.samples, subtract_dark=parameters.subtract_dark)
    after_s, all_dark, count = 0.0, True, 0
    failure = None
    try:
        for due in dues:
            if isinstance(due, Pause) or due.topic != RAW_TOPIC:
                yield due
                continue
            scan, after_s = _decoded(due.content), due.after_s
            count, all_dark = count + 1, all_dark and is_dark(scan)
            for group in groups.take(scan):
                made = merged(group, parameters)
                yield Due(RAW_TOPIC, made, after_s, stamp_of(made) if due.stamp_ns else 0)
    except PosorError as error:
        failure = error
    for group in groups.rest():
        yield Due(RAW_TOPIC, merged(group, parameters), after_s)
    if failure is not None:
        raise failure
    if parameters.subtract_dark and all_dark:
        raise ParameterError(
            f"no light source was lit in any of the {count} scans",
            where="parameter 'conditioning.subtract_dark'",
            expected="false, or lit scans among the dark ones",
        )


def _decoded(content: Any) -> Any:
    if isinstance(content, bytes):
        try:
            content = deserialize_message(content, RawScan)
        except RuntimeError:
            raise BagError(
                f"the {len(content)} bytes of a scan cannot be decoded", where=f"topic {RAW_TOPIC}"
            ) from None
    if not content.samples:
        raise PosorError("is the mean of 0 samples", where=f"scan {content.scan}", expected="at least 1")
    return content


def merged(group: Group, parameters: ConditioningParameters) -> Any:
    """Return the scan (posor_msgs/RawScan) that a group of scans becomes.

    Its stamp is half-way between the first and the last of the lit scans, its number that of the middle one (the
    earlier of the two if they are even in number), so that both still refer to the source's scan clock.

    Raises:
        PosorError: there are more samples than the message can hold.

    """
    lit, significance = group.lit, parameters.significance if parameters.method == "trimmed" else None
    first, middle, last = lit[0], lit[(len(lit) - 1) // 2], lit[-1]
    scan = RawScan(scan=middle.scan, status=group.status, lit_sources=middle.lit_sources)
    scan.header.frame_id = middle.header.frame_id
    scan.header.stamp.sec, scan.header.stamp.nanosec = divmod((stamp_of(first) + stamp_of(last)) // 2, 1_000_000_000)
    averages = {name: _averaged(lit, name, spread, unit, significance) for name, spread, unit in READINGS}
    currents = averages["diode_currents"].means
    dark = group.earlier_dark + group.dark
    if dark and currents.size and not scan.status & RawScan.STATUS_DARK_SUBTRACTED:
        background = _averaged(dark, *READINGS[-1], significance)
        currents = currents - background.means
        scan.status |= RawScan.STATUS_DARK_SUBTRACTED | RawScan.STATUS_OUTLIERS_DROPPED * background.dropped
    counts = [int(count) for every in averages.values() for count in every.counts]
    scan.samples = _samples(lit, min(counts, default=sum(each.samples for each in lit)))
    for name, spread, _ in READINGS:
        means = currents if name == "diode_currents" else averages[name].means
        setattr(scan, name, means.ravel().tolist())
        if scan.samples > 1:
            setattr(scan, spread, averages[name].spreads.ravel().tolist())
    dropped = any(every.dropped for every in averages.values())
    for name in ("supply_voltage", "temperature"):
        value, lost = _measured(lit, name, significance)
        setattr(scan, name, value)
        dropped |= lost
    scan.status |= RawScan.STATUS_OUTLIERS_DROPPED * dropped
    return scan


def _samples(lit: Sequence[Any], count: int) -> int:
    if count > MOST_SAMPLES:
        where = f"scans {lit[0].scan} to {lit[-1].scan}"
        raise PosorError(f"are the mean of {count} samples", where=where, expected=f"at most {MOST_SAMPLES}")
    return count


def _averaged(scans: Sequence[Any], name: str, spread: str, unit: int, significance: float | None) -> Average:
    """Average one kind of readings; the spread of a sample that came without one is not known, which is NaN."""
    samples = np.array([getattr(scan, name) for scan in scans], dtype=np.float64)
    size = samples.shape[1]
    shape = (len(scans), -1, unit) if size and size % unit == 0 else (len(scans), size, 1)
    unknown = np.full(size, np.nan)
    known = [getattr(scan, spread) for scan in scans]
    spreads = np.array([each if len(each) == size else unknown for each in known], dtype=np.float64)
    return average(samples.reshape(shape), _counts(scans), spreads.reshape(shape), significance)


def _measured(scans: Sequence[Any], name: str, significance: float | None) -> tuple[float, bool]:
    """Return the mean over the scans in which a quantity was measured, NaN if in none, and whether any was dropped."""
    values = np.array([getattr(scan, name) for scan in scans], dtype=np.float64)
    measured = ~np.isnan(values)
    if not measured.any():
        return float("nan"), False
    result = average(values[measured].reshape(-1, 1, 1), _counts(scans)[measured], None, significance)
    return float(result.means[0, 0]), result.dropped


def _counts(scans: Sequence[Any]) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return of how many readings each scan is the mean, shape (n,)."""
    return np.array([scan.samples for scan in scans], dtype=np.int64)
