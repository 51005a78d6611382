# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Temperatures of the beams of an arm from their thermometers, checked; a beam without a usable one has the spread.

The thermometers of the plates are checked with them. Their readings are not used here: each joint compensates its own
scans (``estimation.linearise``).

Temperatures change at whole seconds of the stamps of scans, from readings that are at least ``DELAY_S`` older. So
chain_node and ``reprocess`` use the same readings for the same scan, whatever their messages' times of arrival.

What no check can find is a wrong reading that stays plausible, moves slowly and agrees with its neighbour, and two
exchanged thermometers whose readings differ by less than neighbours may. Protection levels contain their effect
(``MeasuringBeam.expansion``).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.chain.beam_entries import DELAY_S, PERIOD_S
from posor.numerics.stamps import NS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.chain.beam_entries import PlateThermometerFile, ThermometerFile
    from posor.chain.endpoint_estimator import EndpointEstimator
    from posor.chain.measuring_beam import MeasuringBeam

PERIOD_NS, DELAY_NS = round(PERIOD_S * NS), round(DELAY_S * NS)
CELSIUS = 273.15  # zero of the Celsius scale [K]
MOST_WAITING = 4096  # readings of a thermometer that wait for scans; then the oldest are dropped
NOISE_FACTOR = 6.0  # standard uncertainties by which two sound readings of one temperature differ at most
FROZEN_FACTOR = 5.0
"""A sound reading changes before another one has changed by this times the sum of both standard uncertainties."""


class Reading(NamedTuple):
    """One reading of a thermometer."""

    stamp_ns: int
    kelvin: float
    fault: str = ""  # that its message shows


@dataclass
class _Thermometer:
    """A thermometer and its readings."""

    index: int | None  # of its beam; None: of a plate
    place: str  # "beam 'NAME'"
    entry: ThermometerFile
    waiting: deque[Reading] = field(default_factory=lambda: deque(maxlen=MOST_WAITING))
    last: Reading | None = None  # the newest that was accepted
    began: Reading | None = None  # the first of those that are identical to it
    others: Mapping[str, float] = field(default_factory=dict)  # readings of the other thermometers at that time [K]
    refusal: str = ""  # why the newest reading was refused
    is_frozen: bool = False

    def forget(self, stamp_ns: int) -> None:
        """Forget all readings but those that wait and are not later than a time."""
        self.last = self.began = None
        self.refusal, self.is_frozen = "", False
        self.waiting = deque((each for each in self.waiting if each.stamp_ns <= stamp_ns), MOST_WAITING)

    def accept_until(self, stamp_ns: int) -> None:
        """Check the readings up to a time, in the order of their stamps."""
        due = sorted(each for each in self.waiting if each.stamp_ns <= stamp_ns)
        if due:
            self.waiting = deque((each for each in self.waiting if each.stamp_ns > stamp_ns), MOST_WAITING)
        for reading in due:
            if self.last is not None and reading.stamp_ns == self.last.stamp_ns and reading.kelvin != self.last.kelvin:
                self.refusal = "has two readings of one stamp; expected one publisher, and a clock that runs"
            elif self.last is None or reading.stamp_ns > self.last.stamp_ns:
                self.refusal = self._refusal(reading)
                if not self.refusal:
                    if self.last is None or reading.kelvin != self.last.kelvin:
                        self.began, self.others, self.is_frozen = reading, {}, False
                    self.last = reading

    def _refusal(self, reading: Reading) -> str:
        entry, last = self.entry, self.began if self.is_frozen else self.last
        least, most = entry.range.array
        if reading.fault:
            return reading.fault
        if not math.isfinite(reading.kelvin):
            return "does not read a number"
        if not least <= reading.kelvin <= most:
            celsius = reading.kelvin - CELSIUS
            units = {"kelvin": celsius, "degrees Fahrenheit": (celsius - 32.0) / 1.8 + CELSIUS}
            fitting = " or ".join(unit for unit, kelvin in units.items() if least <= kelvin <= most)
            return f"reads a temperature outside {least:g} to {most:g} K" + (f" (in {fitting}?)" if fitting else "")
        if last is None:
            return ""
        elapsed_s = (reading.stamp_ns - last.stamp_ns) / NS
        if self.refusal:  # waiting does not widen what is accepted
            elapsed_s = min(elapsed_s, entry.age.number)
        allowed = entry.rate.number * elapsed_s + NOISE_FACTOR * entry.uncertainty.number
        return "" if abs(reading.kelvin - last.kelvin) <= allowed else f"changes faster than {entry.rate.number:g} K/s"

    def fault(self, stamp_ns: int) -> str:
        """Return why the thermometer alone cannot be used during the period that begins with a stamp; else empty."""
        if self.refusal:
            return self.refusal
        oldest_ns = stamp_ns + PERIOD_NS - round(self.entry.age.number * NS)
        if self.last is None or self.last.stamp_ns < oldest_ns:
            return f"has no reading whose stamp is at most {self.entry.age.number:g} s old"
        return ""


class BeamTemperatures:
    """Keeps the beams of an estimator at the temperatures of their thermometers, and checks those of the plates.

    Attributes:
        names: Of all thermometers.
        faults: What is wrong with thermometers: clauses that follow ``thermometer 'NAME' of beam 'BEAM'``, or ``of
            the plate of 'JOINT'``, by name.
        kelvins: Temperatures in use, by name [K].
        reason: All faults, as a sentence; empty: every thermometer is used.

    """

    def __init__(
        self, beams: Sequence[MeasuringBeam], estimator: EndpointEstimator, plates: Sequence[PlateThermometerFile] = ()
    ) -> None:
        """Take the beams of a chain, all at the temperature of the URDF, an estimator of this chain, and its plates."""
        self._beams, self._estimator = beams, estimator
        found: list[tuple[int | None, str, ThermometerFile | None]] = [
            (n, f"beam '{beam.name}'", beam.entry.thermometer) for n, beam in enumerate(beams)
        ]
        found += [(None, f"the plate of '{plate.joint}'", plate.thermometer) for plate in plates]
        self._all = {entry.name: _Thermometer(n, place, entry) for n, place, entry in found if entry is not None}
        self.names = tuple(self._all)
        self._pairs: dict[frozenset[str], float] = {}
        for name, each in self._all.items():
            if (neighbour := each.entry.neighbour) is not None:
                pair, limit = frozenset((name, neighbour.name)), neighbour.difference.number
                self._pairs[pair] = min(limit, self._pairs.get(pair, limit))
        self._period: int | None = None
        self.faults: dict[str, str] = {}
        self.kelvins: dict[str, float] = {}
        self.reason = ""

    def add(self, name: str, stamp_ns: int, celsius: float, frame: str = "", publishers: int = 1) -> None:
        """Add a reading [degree Celsius] of a thermometer; ``frame``: of its message; ``publishers``: of its topic.

        A reading whose frame is the name of another thermometer, or that may be of another publisher, is not used.
        """
        fault = f"receives the readings of '{frame}'" if frame != name and frame in self._all else ""
        if publishers > 1:
            fault = f"has {publishers} publishers on its topic; expected one"
        self._all[name].waiting.append(Reading(stamp_ns, celsius + CELSIUS, fault))

    def restart(self) -> None:
        """Forget all readings, those also that a refusal rests on."""
        self._period = None
        for each in self._all.values():
            each.waiting.clear()
            each.forget(0)

    def update(self, stamp_ns: int) -> None:
        """Bring the beams of the estimator to their temperatures at the stamp of a scan [ns], if a period has begun."""
        period = stamp_ns // PERIOD_NS
        if not self._all or period == self._period:
            return
        begin_ns = period * PERIOD_NS
        if self._period is not None and period < self._period:  # a replay has started again
            for each in self._all.values():
                each.forget(stamp_ns)
        self._period = period
        for each in self._all.values():
            each.accept_until(begin_ns - DELAY_NS)
        self.faults = {name: fault for name, each in self._all.items() if (fault := each.fault(begin_ns))}
        self._find_frozen()
        self._compare_neighbours()
        self._use_sound()

    def _sound(self) -> dict[str, float]:
        """Return the readings of the thermometers without a fault so far, by name [K]."""
        return {n: each.last.kelvin for n, each in self._all.items() if each.last is not None and n not in self.faults}

    def _find_frozen(self) -> None:
        """Find thermometers that still read the same after another one has changed."""
        present = self._sound()
        for name in present:
            own = self._all[name]
            own.others = {**present, **own.others}  # of the time when the own reading began, or they came
            for other, before in own.others.items():
                limit = FROZEN_FACTOR * (own.entry.uncertainty.number + self._all[other].entry.uncertainty.number)
                if other != name and abs(present.get(other, before) - before) > limit:
                    own.is_frozen = True
                    self.faults[name] = f"still reads the same after '{other}' has changed by more than {limit:g} K"
                    break

    def _compare_neighbours(self) -> None:
        """Find thermometers that differ from their neighbours; exchanged ones if that explains all differences."""
        present = self._sound()
        pairs = {pair: limit for pair, limit in self._pairs.items() if pair <= present.keys()}

        def differing(readings: Mapping[str, float]) -> list[frozenset[str]]:
            return [pair for pair, limit in pairs.items() if np.ptp([readings[name] for name in pair]) > limit]

        if not (wrong := differing(present)):
            return
        involved = frozenset().union(*wrong)
        for one, two in combinations(present, 2):
            swapped = {**present, one: present[two], two: present[one]}
            if {one, two} <= involved and not differing(swapped):
                for name, other in ((one, two), (two, one)):
                    fits = f"agrees with the neighbours if exchanged with '{other}'"
                    self.faults[name] = f"{self.faults[name]}; {fits}" if name in self.faults else fits
        for pair in wrong:
            if pair & self.faults.keys():
                continue
            alone = [n for n in pair if not any(n in each for each in pairs.keys() - set(wrong))]
            for name in alone if len(alone) == 1 else pair:
                (other,) = pair - {name}
                self.faults[name] = f"differs from '{other}' by more than {pairs[pair]:g} K"

    def _use_sound(self) -> None:
        before, self.kelvins = self.kelvins, self._sound()
        for name, each in self._all.items():
            if (kelvin := self.kelvins.get(name)) != before.get(name) and each.index is not None:
                self._estimator.use_beam(each.index, self._beams[each.index].at_temperature(kelvin))
        named = [(f"thermometer '{n}' of {each.place}", self.faults.get(n)) for n, each in self._all.items()]
        self.reason = "; ".join(f"{name} {fault}" for name, fault in named if fault)
