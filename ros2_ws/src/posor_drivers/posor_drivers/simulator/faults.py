# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faults of a simulated joint, switched on and off at given times: the section ``faults`` of a scenario file.

The kinds cover the failure types of PX4's fault injection (off, stuck, garbage, wrong, slow) and faults of the clock.
A fault changes what the driver publishes, never the truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Self

import numpy as np
from posor.calibration.file_model import EntryError
from posor.errors import CalibrationError
from posor.model.scan import HOME_BUMP
from posor.numerics.stamps import NS
from posor.sensors.diodes import DiodesCalibration
from pydantic import AfterValidator, model_validator

from posor_drivers.simulator.electronics_settings import TimedEntry
from posor_drivers.simulator.imperfections import RandomStream
from posor_drivers.simulator.simulated_scans import DIODE_FIELD, find_channel, stated_exposures

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import IntArray

    from posor_drivers.simulator.simulated_scans import SimulatedScans, SoundScans

READING_FIELDS = ("gap_voltages", "ring_voltages", DIODE_FIELD, "lit_sources")
CONTENT = (*READING_FIELDS, "supply_voltages", "temperatures", "reference_voltages", "at_home", "statuses")
"""Fields of a scan about its time of exposure."""
NOT_STATED = {"stamp_uncertainties": 0.0, "stamp_limits": 0.0}
BURST_STEP_NS = 10_000
"""From one arrival to the next in a burst."""
READING = "reading"
"""Unit of a size that is in the unit of the reading: V of a probe, A of a contact."""


def _check_kind(kind: str) -> str:
    if kind not in KINDS:
        raise EntryError(f"kind '{kind}'", expected=f"one of {', '.join(KINDS)}")
    return kind


class SimulatedFault(TimedEntry):
    """One fault of one joint; ``KINDS`` says whether it concerns a channel, and the unit of its ``size``."""

    kind: Annotated[str, AfterValidator(_check_kind)]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        kind, size = KINDS[self.kind], self.size
        if kind.of_channel != (self.channel is not None):
            expected = "the name of a probe or diode" if kind.of_channel else f"none for '{self.kind}'"
            raise EntryError(f"channel {self.channel}", key=("channel",), expected=expected)
        if self.contact is not None and self.channel is None:
            raise EntryError(f"contact {self.contact}", key=("contact",), expected="a channel that is a diode")
        units = ("V", "A") if kind.unit == READING else (kind.unit,)
        if bool(kind.unit) != (size is not None) or (size is not None and (size.unit not in units or size.array.shape)):
            expected = f"one number, unit '{' or '.join(units)}'" if kind.unit else f"none for '{self.kind}'"
            raise EntryError(f"size {size}", key=("size",), expected=expected)
        if size is not None:
            least, most = kind.sizes
            if not least <= size.number <= most or (kind.is_whole and size.number % 1.0):
                expected = f"{'a whole number of ' if kind.is_whole else ''}{least:g} to {most:g}"
                raise EntryError(f"size {size.number:g} {size.unit}", key=("size",), expected=expected)
        return self


@dataclass(frozen=True)
class PlacedFault:
    """A fault of a joint, with the ticks, channel and random numbers that its kind needs."""

    kind: FaultKind  # what it changes
    size: float  # NaN: it has none
    ticks: tuple[int, int]  # first tick, and the tick after the last, within a cycle
    field: str  # attribute of ``Scans`` that holds the channel; empty: none
    index: tuple[int, ...]  # of the channel in one scan
    light_sources: int  # number of light sources that a diode can see
    random: RandomStream  # random numbers by tick

    def change(
        self, published: SimulatedScans, which: IntArray, ticks: IntArray, first: int, sound: SoundScans
    ) -> SimulatedScans:
        """Return scans at ticks of which some have the fault, which begins at the tick ``first``."""
        values = self.kind.values(FaultyScans(self, published, which, ticks[which], first, sound))
        arrays: dict[str, Any] = {}
        for name, value in values.items():
            arrays[name] = _field(published, name).copy()
            arrays[name][(which, *self.index) if name == self.field else which] = value
        own = {name: arrays.pop(name) for name in ("statuses", "sent", "latencies_ns") if name in arrays}
        return replace(published, scans=published.scans.with_fields(arrays), **own)


class FaultyScans(NamedTuple):
    """The scans that have a fault, as they are without it."""

    fault: PlacedFault
    published: SimulatedScans
    which: IntArray
    ticks: IntArray
    first: int  # tick at which the fault begins
    sound: SoundScans

    def now(self, name: str) -> Any:
        """Return the values of a field; of the field of the fault's channel, only those of the channel."""
        index = self.fault.index if name == self.fault.field else ()
        return _field(self.published, name)[(self.which, *index)]

    def begin(self, *names: str) -> dict[str, Any]:
        """Return the values of fields, or of the channel, in the scan where the fault begins."""
        first = self.sound.scans_at(np.array([self.first]))
        return {name: _field(first, name)[(0, *self.fault.index)] for name in names}

    def at(self, ticks: IntArray, *names: str) -> dict[str, Any]:
        """Return the values of fields at other ticks, one for each scan."""
        other = self.sound.scans_at(ticks)
        return {name: _field(other, name) for name in names}

    def channel(self, values: object) -> dict[str, Any]:
        """Return values of the fault's channel; without ``contact``, a diode has four."""
        return {self.fault.field: values}

    @property
    def size(self) -> int:
        """The size, a whole number."""
        return round(self.fault.size)

    @property
    def size_ns(self) -> int:
        """The size, a time [ns]."""
        return round(self.fault.size * NS)


def _field(published: SimulatedScans, name: str) -> Any:
    return getattr(published if hasattr(published, name) else published.scans, name)


def _garbage(scans: FaultyScans) -> dict[str, Any]:
    fault, now = scans.fault, scans.now(scans.fault.field)
    lowest = 0.0 if fault.field == DIODE_FIELD else -fault.size
    numbers = scans.now("numbers").tolist()
    drawn = [fault.random.generator(number).uniform(lowest, fault.size, now.shape[1:]) for number in numbers]
    return scans.channel(np.reshape(drawn, now.shape))


def _slip(scans: FaultyScans) -> dict[str, Any]:
    lit, count = scans.now("lit_sources"), scans.fault.light_sources
    return {"lit_sources": np.where(lit < count, (lit + scans.size) % count, lit)}


def _gain(scans: FaultyScans) -> dict[str, Any]:
    fields = ("gap_voltages", "ring_voltages", "reference_voltages")
    return {name: scans.now(name) * (1.0 + scans.fault.size) for name in fields}


def _multiplexed(scans: FaultyScans, statement: str) -> dict[str, Any]:
    changes = scans.sound.exposure_changes(scans.ticks, scans.fault.size)
    offsets_s = scans.sound.exposure_offsets(scans.fault.size)
    return {name: scans.now(name) + change for name, change in changes.items()} | stated_exposures(
        offsets_s, len(scans.ticks), statement
    )


def _arrival(scans: FaultyScans) -> dict[str, Any]:
    drawn = [scans.fault.random.generator(tick).normal() for tick in scans.ticks.tolist()]
    shifts_ns = np.round(scans.size_ns * np.array(drawn)).astype(np.int64)
    return {"stamps_ns": scans.now("stamps_ns") + shifts_ns, **NOT_STATED}


def _burst(scans: FaultyScans) -> dict[str, Any]:
    since = np.mod(scans.ticks, scans.size)
    arrived = scans.at(scans.ticks + scans.size - 1 - since, "stamps_ns")["stamps_ns"]
    return {"stamps_ns": arrived + since * BURST_STEP_NS, **NOT_STATED}


def _late_scan(scans: FaultyScans) -> dict[str, Any]:
    since = scans.ticks - scans.first
    published = np.where(since < scans.size, scans.ticks + 1, scans.first)
    is_exchanged = since <= scans.size
    values = {}
    for name, other in scans.at(published, *CONTENT, "numbers", "stamps_ns").items():
        values[name] = scans.now(name).copy()
        values[name][is_exchanged] = other[is_exchanged]
    return values


def _restart(scans: FaultyScans) -> dict[str, Any]:
    return {"numbers": scans.ticks - scans.first, "stamps_ns": scans.now("stamps_ns") + scans.size_ns}


def _aged(scans: FaultyScans) -> dict[str, Any]:
    period_s = float(np.diff(scans.at(scans.first + np.arange(2), "stamps_ns")["stamps_ns"])[0]) / NS
    return scans.at(scans.ticks - round(scans.fault.size / period_s), *CONTENT)


class FaultKind(NamedTuple):
    """What a kind of fault does."""

    values: Callable[[FaultyScans], Mapping[str, Any]]  # returns what is published instead, by field
    unit: str = ""  # of the size; empty: it has no size
    sizes: tuple[float, float] = (-1e6, 1e6)  # least and greatest size
    is_whole: bool = False  # whether the size is a whole number
    of_channel: bool = False  # whether it concerns one channel
    whole_diode: bool = False  # whether a diode without ``contact`` is all of its contacts
    states_exposures: bool = False  # whether scans with the fault have offsets, so that those without it have zeros


KINDS: dict[str, FaultKind] = {
    "off": FaultKind(lambda _: {"sent": False}),
    "late": FaultKind(lambda scans: {"latencies_ns": scans.now("latencies_ns") + scans.size_ns}, "s", (0.0, 3600.0)),
    "stuck": FaultKind(lambda scans: scans.begin(scans.fault.field), of_channel=True, whole_diode=True),
    "frozen": FaultKind(lambda scans: scans.begin(*READING_FIELDS)),
    "frozen_diodes": FaultKind(lambda scans: scans.begin(DIODE_FIELD, "lit_sources")),
    "garbage": FaultKind(_garbage, READING, (0.0, 1e3), of_channel=True, whole_diode=True),
    "nan": FaultKind(lambda scans: scans.channel(np.nan), of_channel=True, whole_diode=True),
    "offset": FaultKind(
        lambda scans: scans.channel(scans.now(scans.fault.field) + scans.fault.size), READING, of_channel=True
    ),
    "value": FaultKind(lambda scans: scans.channel(scans.fault.size), READING, of_channel=True),
    "dark": FaultKind(lambda scans: scans.channel(0.0), of_channel=True, whole_diode=True),
    "slip": FaultKind(_slip, "1", is_whole=True),
    "supply": FaultKind(lambda scans: {"supply_voltages": scans.fault.size}, "V", (0.0, 1e3)),
    "temperature": FaultKind(lambda scans: {"temperatures": scans.fault.size}, "K", (0.0, 1e3)),
    "ambient": FaultKind(lambda scans: {DIODE_FIELD: scans.now(DIODE_FIELD) + scans.fault.size}, "A"),
    "gain": FaultKind(_gain, "1", (-1.0, 10.0)),
    "status": FaultKind(
        lambda scans: {"statuses": scans.now("statuses") | scans.size}, "1", (0.0, 2**32 - 1), is_whole=True
    ),
    "home": FaultKind(lambda scans: {"statuses": scans.now("statuses") | HOME_BUMP, "at_home": 1}),
    "clock": FaultKind(lambda scans: {"stamps_ns": scans.now("stamps_ns") + scans.size_ns}, "s", (-1e8, 1e8)),
    "arrival": FaultKind(_arrival, "s", (0.0, 10.0)),
    "burst": FaultKind(_burst, "1", (1.0, 1e3), is_whole=True),
    "late_scan": FaultKind(_late_scan, "1", (1.0, 1e3), is_whole=True),
    "restart": FaultKind(_restart, "s", (-1e6, 1e6)),
    "aged": FaultKind(_aged, "s", (0.0, 3600.0)),
    "multiplexed": FaultKind(lambda scans: _multiplexed(scans, "stated"), "s", (0.0, 0.1), states_exposures=True),
    "multiplexed_unknown": FaultKind(
        lambda scans: _multiplexed(scans, "unknown"), "s", (0.0, 0.1), states_exposures=True
    ),
    "multiplexed_unstated": FaultKind(lambda scans: _multiplexed(scans, "unstated"), "s", (0.0, 0.1)),
    "number": FaultKind(
        lambda scans: {"numbers": scans.now("numbers").astype(np.int64) + scans.size}, "1", (-1e9, 1e9), is_whole=True
    ),
    "repeat": FaultKind(lambda scans: scans.begin(*CONTENT, "numbers", "stamps_ns")),
}
"""All kinds: what is published instead of the scan."""


class JointFaults:
    """The faults of one joint, in the order of the scenario file."""

    def __init__(
        self,
        faults: list[tuple[str, SimulatedFault]],
        calibration: Calibration,
        *,
        seed: int,
        rate: int,
        cycle_ticks: int,
    ) -> None:
        """Place the faults; each comes with the place where it stands in the scenario file.

        Raises:
            CalibrationError: A fault names a channel that the joint does not have, or light sources where it has none.

        """
        diodes = [sensor for sensor in calibration.sensors if isinstance(sensor, DiodesCalibration)]
        sources = len(diodes[0].light_sources) if diodes else 0
        self._placed, self._cycle_ticks = list[PlacedFault](), cycle_ticks
        for where, fault in faults:
            kind, field, index = KINDS[fault.kind], "", tuple[int, ...]()
            if fault.kind == "slip" and not sources:
                what = f"joint '{fault.joint}' has no light sources"
                raise CalibrationError(what, where=where, expected="a joint with diodes")
            if fault.channel is not None:
                field, index = find_channel(calibration, fault, where, whole_diode=kind.whole_diode)
            if fault.kind == "dark" and field != DIODE_FIELD:
                raise CalibrationError(f"channel '{fault.channel}' is a probe", where=where, expected="a diode")
            unit = "A" if field == DIODE_FIELD else "V"
            if fault.size is not None and kind.unit == READING and fault.size.unit != unit:
                raise CalibrationError(f"unit '{fault.size.unit}'", where=f"{where}.size", expected=f"'{unit}'")
            size = np.nan if fault.size is None else fault.size.number
            ticks = round(fault.begin.number * rate), round(fault.end.number * rate)
            random = RandomStream(seed, "faults", fault.joint, fault.kind)
            self._placed.append(PlacedFault(kind, size, ticks, field, index, sources, random))

    def change(self, published: SimulatedScans, ticks: IntArray, sound: SoundScans) -> SimulatedScans:
        """Return the scans at ticks (n,) with the faults; ``sound`` are the scans without them."""
        cycles, in_cycle = np.divmod(ticks, self._cycle_ticks)
        if any(placed.kind.states_exposures for placed in self._placed) and not published.scans.exposure_offsets.size:
            simultaneous = np.tile(sound.exposure_offsets(0.0), (len(ticks), 1))
            published = replace(published, scans=published.scans.with_fields({"exposure_offsets": simultaneous}))
        for placed in self._placed:
            begin, end = placed.ticks
            is_faulty = (in_cycle >= begin) & (in_cycle < end)
            for cycle in np.unique(cycles[is_faulty]).tolist():
                which = np.flatnonzero(is_faulty & (cycles == cycle))
                published = placed.change(published, which, ticks, cycle * self._cycle_ticks + begin, sound)
        return published

    def delay_ns(self, tick: int) -> int:
        """Return by how much the scan of a tick is later than without faults [ns]."""
        late, in_cycle = (each for each in self._placed if each.kind is KINDS["late"]), tick % self._cycle_ticks
        return sum(round(each.size * NS) for each in late if each.ticks[0] <= in_cycle < each.ticks[1])
