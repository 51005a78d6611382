"""Faults of a simulated joint, switched on and off at given times: the section ``faults`` of a scenario file.

The kinds cover the failure types of PX4's fault injection (off, stuck, garbage, wrong, slow) and faults of the clock.
A fault changes what the driver publishes, never the truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, Self

import numpy as np
from posor.calibration.file_model import EntryError, FrozenModel
from posor.calibration.quantity import Quantity, measured
from posor.errors import CalibrationError
from posor.model.scan import HOME_BUMP
from posor.numerics.stamps import NS
from posor.sensors.diodes import DiodesCalibration
from pydantic import Field, model_validator

from posor_drivers.quantity_limits import NOT_NEGATIVE, POSITIVE
from posor_drivers.simulator.random_stream import RandomStream
from posor_drivers.simulator.simulated_scans import DIODE_FIELD, find_channel

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import IntArray

    from posor_drivers.simulator.simulated_scans import SimulatedScans

FaultKind = Literal[
    "off",
    "late",
    "stuck",
    "frozen",
    "frozen_diodes",
    "garbage",
    "nan",
    "offset",
    "value",
    "dark",
    "slip",
    "supply",
    "temperature",
    "status",
    "home",
    "clock",
    "number",
    "repeat",
]
READING_FIELDS = ("gap_voltages", "ring_voltages", DIODE_FIELD, "lit_sources")


class SimulatedFault(FrozenModel):
    """One fault of one joint during a part of each cycle, between two scenario times.

    ``channel`` is the name of a probe or diode in the joint's calibration, ``contact`` a contact of a diode. ``size``
    has the unit of ``KINDS``; the unit of a reading is V for a probe and A for a contact.
    """

    joint: str
    kind: FaultKind
    begin: Annotated[Quantity, measured("s"), NOT_NEGATIVE] = Field(alias="from")
    end: Annotated[Quantity, measured("s"), POSITIVE] = Field(alias="until")
    channel: str | None = None
    contact: Literal["A", "B", "C", "D"] | None = None
    size: Quantity | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.begin.number < self.end.number:
            expected = f"more than {self.begin.number:g} s, where it begins"
            raise EntryError(f"until {self.end.number:g} s", key=("until", "value"), expected=expected)
        kind = KINDS[self.kind]
        if kind.of_channel != (self.channel is not None):
            expected = "the name of a probe or diode" if kind.of_channel else f"none for '{self.kind}'"
            raise EntryError(f"channel {self.channel}", key=("channel",), expected=expected)
        if self.contact is not None and self.channel is None:
            raise EntryError(f"contact {self.contact}", key=("contact",), expected="a channel that is a diode")
        units = (kind.unit,) if kind.unit else ("V", "A")
        size = self.size
        if kind.sized != (size is not None) or (size is not None and (size.unit not in units or size.array.shape)):
            expected = f"one number, unit '{' or '.join(units)}'" if kind.sized else f"none for '{self.kind}'"
            raise EntryError(f"size {size}", key=("size",), expected=expected)
        return self


@dataclass(frozen=True)
class PlacedFault:
    """A fault of a joint, with the ticks, channel and random numbers that its kind needs.

    Attributes:
        fault: Entry of the scenario file.
        ticks: First tick, and the tick after the last, within a cycle.
        field: Attribute of ``Scans`` that holds the channel; empty: none.
        index: Of the channel in one scan.
        light_sources: Number of light sources that a diode can see.
        random: Random numbers by tick.

    """

    fault: SimulatedFault
    ticks: tuple[int, int]
    field: str
    index: tuple[int, ...]
    light_sources: int
    random: RandomStream

    @property
    def size(self) -> float:
        """Size of the fault; NaN: it has none."""
        return float("nan") if self.fault.size is None else self.fault.size.number


def _with_fields(published: SimulatedScans, which: IntArray, **values: object) -> SimulatedScans:
    """Return scans in which some have other values."""
    fields = {}
    for name, value in values.items():
        fields[name] = getattr(published.scans, name).copy()
        fields[name][which] = value
    return replace(published, scans=published.scans.with_fields(fields))


def _with_channel(published: SimulatedScans, which: IntArray, placed: PlacedFault, values: object) -> SimulatedScans:
    """Return scans in which some have other values of one channel; without ``contact``, a diode has four."""
    readings = getattr(published.scans, placed.field).copy()
    readings[(which, *placed.index)] = values
    return replace(published, scans=published.scans.with_fields({placed.field: readings}))


def _off(published: SimulatedScans, which: IntArray, _placed: PlacedFault, _first: Scans) -> SimulatedScans:
    sent = published.sent.copy()
    sent[which] = False
    return replace(published, sent=sent)


def _late(published: SimulatedScans, which: IntArray, placed: PlacedFault, _first: Scans) -> SimulatedScans:
    latencies = published.latencies_ns.copy()
    latencies[which] += round(placed.size * NS)
    return replace(published, latencies_ns=latencies)


def _stuck(published: SimulatedScans, which: IntArray, placed: PlacedFault, first: Scans) -> SimulatedScans:
    return _with_channel(published, which, placed, getattr(first, placed.field)[(0, *placed.index)])


def _frozen(published: SimulatedScans, which: IntArray, _placed: PlacedFault, first: Scans) -> SimulatedScans:
    return _with_fields(published, which, **{name: getattr(first, name)[0] for name in READING_FIELDS})


def _frozen_diodes(published: SimulatedScans, which: IntArray, _placed: PlacedFault, first: Scans) -> SimulatedScans:
    return _with_fields(published, which, **{name: getattr(first, name)[0] for name in (DIODE_FIELD, "lit_sources")})


def _garbage(published: SimulatedScans, which: IntArray, placed: PlacedFault, _first: Scans) -> SimulatedScans:
    numbers = published.scans.numbers[which].tolist()
    lowest = -placed.size if placed.field != DIODE_FIELD else 0.0
    shape = getattr(published.scans, placed.field)[(0, *placed.index)].shape
    values = [placed.random.generator(number).uniform(lowest, placed.size, shape) for number in numbers]
    return _with_channel(published, which, placed, np.reshape(values, (len(numbers), *shape)))


def _nan(published: SimulatedScans, which: IntArray, placed: PlacedFault, _first: Scans) -> SimulatedScans:
    return _with_channel(published, which, placed, np.nan)


def _offset(published: SimulatedScans, which: IntArray, placed: PlacedFault, _first: Scans) -> SimulatedScans:
    readings = getattr(published.scans, placed.field)[(which, *placed.index)]
    return _with_channel(published, which, placed, readings + placed.size)


def _value(published: SimulatedScans, which: IntArray, placed: PlacedFault, _first: Scans) -> SimulatedScans:
    return _with_channel(published, which, placed, placed.size)


def _dark(published: SimulatedScans, which: IntArray, placed: PlacedFault, _first: Scans) -> SimulatedScans:
    return _with_channel(published, which, placed, 0.0)


def _slip(published: SimulatedScans, which: IntArray, placed: PlacedFault, _first: Scans) -> SimulatedScans:
    lit = published.scans.lit_sources[which]
    slipped = np.where(lit < placed.light_sources, (lit + round(placed.size)) % placed.light_sources, lit)
    return _with_fields(published, which, lit_sources=slipped)


def _supply(published: SimulatedScans, which: IntArray, placed: PlacedFault, _first: Scans) -> SimulatedScans:
    return _with_fields(published, which, supply_voltages=placed.size)


def _temperature(published: SimulatedScans, which: IntArray, placed: PlacedFault, _first: Scans) -> SimulatedScans:
    return _with_fields(published, which, temperatures=placed.size)


def _status(published: SimulatedScans, which: IntArray, placed: PlacedFault, _first: Scans) -> SimulatedScans:
    statuses = published.statuses.copy()
    statuses[which] |= round(placed.size)
    return replace(published, statuses=statuses)


def _home(published: SimulatedScans, which: IntArray, _placed: PlacedFault, _first: Scans) -> SimulatedScans:
    statuses = published.statuses.copy()
    statuses[which] |= HOME_BUMP
    return replace(_with_fields(published, which, at_home=1), statuses=statuses)


def _clock(published: SimulatedScans, which: IntArray, placed: PlacedFault, _first: Scans) -> SimulatedScans:
    return _with_fields(published, which, stamps_ns=published.scans.stamps_ns[which] + round(placed.size * NS))


def _number(published: SimulatedScans, which: IntArray, placed: PlacedFault, _first: Scans) -> SimulatedScans:
    shift = np.int64(round(placed.size))
    return _with_fields(published, which, numbers=published.scans.numbers[which].astype(np.int64) + shift)


def _repeat(published: SimulatedScans, which: IntArray, placed: PlacedFault, first: Scans) -> SimulatedScans:
    repeated = _frozen(published, which, placed, first)
    return _with_fields(repeated, which, numbers=first.numbers[0], stamps_ns=first.stamps_ns[0])


class FaultBehaviour(NamedTuple):
    """What a kind of fault does.

    Attributes:
        change: Returns the changed scans.
        of_channel: Whether it concerns one channel.
        sized: Whether it has a size.
        unit: Of the size; empty: that of the reading.

    """

    change: Callable[[SimulatedScans, IntArray, PlacedFault, Scans], SimulatedScans]
    of_channel: bool
    sized: bool
    unit: str


KINDS: dict[FaultKind, FaultBehaviour] = {
    "off": FaultBehaviour(_off, of_channel=False, sized=False, unit=""),
    "late": FaultBehaviour(_late, of_channel=False, sized=True, unit="s"),
    "stuck": FaultBehaviour(_stuck, of_channel=True, sized=False, unit=""),
    "frozen": FaultBehaviour(_frozen, of_channel=False, sized=False, unit=""),
    "frozen_diodes": FaultBehaviour(_frozen_diodes, of_channel=False, sized=False, unit=""),
    "garbage": FaultBehaviour(_garbage, of_channel=True, sized=True, unit=""),
    "nan": FaultBehaviour(_nan, of_channel=True, sized=False, unit=""),
    "offset": FaultBehaviour(_offset, of_channel=True, sized=True, unit=""),
    "value": FaultBehaviour(_value, of_channel=True, sized=True, unit=""),
    "dark": FaultBehaviour(_dark, of_channel=True, sized=False, unit=""),
    "slip": FaultBehaviour(_slip, of_channel=False, sized=True, unit="1"),
    "supply": FaultBehaviour(_supply, of_channel=False, sized=True, unit="V"),
    "temperature": FaultBehaviour(_temperature, of_channel=False, sized=True, unit="K"),
    "status": FaultBehaviour(_status, of_channel=False, sized=True, unit="1"),
    "home": FaultBehaviour(_home, of_channel=False, sized=False, unit=""),
    "clock": FaultBehaviour(_clock, of_channel=False, sized=True, unit="s"),
    "number": FaultBehaviour(_number, of_channel=False, sized=True, unit="1"),
    "repeat": FaultBehaviour(_repeat, of_channel=False, sized=False, unit=""),
}
"""All kinds: what is published instead of the scan."""


class JointFaults:
    """The faults of one joint, in the order of the scenario file."""

    def __init__(
        self, faults: list[tuple[str, SimulatedFault]], calibration: Calibration, rate: int, seed: int
    ) -> None:
        """Place the faults.

        Args:
            faults: Where each stands in the scenario file, and the fault.
            calibration: Of the joint's POSOR.
            rate: Ticks per second.
            seed: Of the scenario.

        Raises:
            CalibrationError: A fault names a channel that the joint does not have, or light sources where it has none.

        """
        diodes = [sensor for sensor in calibration.sensors if isinstance(sensor, DiodesCalibration)]
        sources = len(diodes[0].light_sources) if diodes else 0
        self._placed = []
        for where, fault in faults:
            if fault.kind == "slip" and not sources:
                what = f"joint '{fault.joint}' has no light sources"
                raise CalibrationError(what, where=where, expected="a joint with diodes")
            field, index = (
                ("", ())
                if fault.channel is None
                else find_channel(
                    calibration, fault, where, whole_diode=fault.kind in {"dark", "garbage", "nan", "stuck"}
                )
            )
            if fault.kind == "dark" and field != DIODE_FIELD:
                raise CalibrationError(f"channel '{fault.channel}' is a probe", where=where, expected="a diode")
            unit = "A" if field == DIODE_FIELD else "V"
            if fault.size is not None and not KINDS[fault.kind].unit and fault.size.unit != unit:
                raise CalibrationError(f"unit '{fault.size.unit}'", where=f"{where}.size", expected=f"'{unit}'")
            ticks = round(fault.begin.number * rate), round(fault.end.number * rate)
            random = RandomStream(seed, "faults", fault.joint, fault.kind)
            self._placed.append(PlacedFault(fault, ticks, field, index, sources, random))

    def change(
        self, published: SimulatedScans, ticks: IntArray, cycle_ticks: int, scan_at: Callable[[int], Scans]
    ) -> SimulatedScans:
        """Return the scans at ticks (n,) with the faults.

        Args:
            published: The scans without faults.
            ticks: Their ticks, (n,).
            cycle_ticks: Number of ticks after which the scenario repeats.
            scan_at: Returns the scan without faults at a tick.

        """
        in_cycle = np.mod(ticks, cycle_ticks)
        for placed in self._placed:
            begin, end = placed.ticks
            which = np.flatnonzero((in_cycle >= begin) & (in_cycle < end))
            if which.size:
                first = int(ticks[which[0]] - in_cycle[which[0]]) + begin
                published = KINDS[placed.fault.kind].change(published, which, placed, scan_at(first))
        return published

    def delay_ns(self, tick: int, cycle_ticks: int) -> int:
        """Return by how much the scan of a tick is later than without faults [ns]."""
        in_cycle = tick % cycle_ticks
        late = (each for each in self._placed if each.fault.kind == "late")
        return sum(round(each.size * NS) for each in late if each.ticks[0] <= in_cycle < each.ticks[1])
