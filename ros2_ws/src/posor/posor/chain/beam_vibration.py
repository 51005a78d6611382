# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""How measuring beams follow the vibration of their links: first modes driven by measured accelerations.

Two accelerometers at the gimbals of a beam measure the specific force f that drives it. The sag follows as an
oscillator with the first natural frequency w of the beam and its damping z: in place of f acts

    u'' + 2 z w u' + w^2 u = w^2 f

solved exactly for readings that are connected by straight lines. The sag is the static one under u, of which the mean
and the increase along the beam act apart (``MeasuringBeam.start_gain``, ``start_tilt_gain``). Well below w, u - f is
about r^2 u, with r the frequency of the vibration over w. The standard uncertainty of the force is

    sqrt(s^2 + (u - f)^2 ((2 d / (1 - r^2))^2 + e^2) + (w_v^2 h^2 u / 12)^2 + (u' t)^2)

s: of the accelerometers, whose noise the resonance enlarges, d: of w over w, e: ``uncertainty`` of the beams file,
w_v = r w, h: time between two readings, t: ``delay`` of the beams file, of the time of a reading. Beyond ``limit`` r
the whole of u - f counts as uncertain, and the protection level of the endpoint is not bounded. r^2 is
w^2 (u - f)^2 / u'^2, both of the largest amounts of the last ``MEMORY_S``.

Source: Meirovitch, Elements of Vibration Analysis (1975), first mode of a beam with moving supports; exact solution of
the oscillator under a linear force. The independent judge is ``posor_lab/vibration``.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.chain.beam_entries import STANDARD_GRAVITY
from posor.numerics.compiled import bind, in_place
from posor.numerics.stamps import NS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.chain.beam_entries import VibrationFile
    from posor.chain.endpoint_estimator import EndpointEstimator
    from posor.chain.joint_measurements import RecordArray
    from posor.chain.measuring_beam import MeasuringBeam
    from posor.numerics.array_types import FloatArray, IntArray

MEMORY_S = 0.1  # time constant with which the largest amounts are forgotten
NOISE_FACTOR = 6.0  # standard uncertainties of the accelerometers up to which u - f is noise
SETTLED = 5.0  # time constants of the decay after which an oscillator has forgotten how it began
FROZEN_S = 0.1  # a sound accelerometer does not read the same to the last bit for so long, nor the same as another
OTHER_CLOCK_S = 1.0  # stamps that differ more from those of the scans come from another clock
GRAVITY_S = 1.0  # time constant of the mean that has to be gravity
GRAVITY_TOLERANCE = 0.1  # of standard gravity
RIPPLE = 0.02  # share of vibration from 15 Hz on that may be left in the mean
MOST_WAITING = 4096  # readings of an accelerometer that wait for scans; then the oldest are dropped

OSCILLATOR = np.dtype([(name, float) for name in ("angular", "decay", "excess", "speed", "step_s")])
"""Of an accelerometer: w [rad/s]; z w [1/s]; largest (u - f)^2 [m^2/s^4] and u'^2 [m^2/s^6]; time between readings
[s]."""
BEAM_FIELD = np.dtype(
    [(name, float) for name in ("far_share", "stretch", "reading", "delay_s", "frequency", "model", "limit", "angular")]
)
"""Of a beam: share of the second accelerometer in the field at its centre; its length over the distance of the gimbals;
standard uncertainties of a reading [m/s^2], of its time [s], of w and of u - f, both relative; ``limit``; w [rad/s]."""


class Oscillators(NamedTuple):
    """Oscillators of n accelerometers, two for each of n / 2 beams, in the axes of the beams' starts."""

    numbers: RecordArray  # (n,) of ``OSCILLATOR``
    stamps_ns: IntArray  # of the last readings, (n,); zero: there is none
    forces: FloatArray  # f, minus the readings [m/s^2], (n, 3)
    slopes: FloatArray  # f' between the last two readings [m/s^3], (n, 3)
    filtered: FloatArray  # u [m/s^2], (n, 3)
    rates: FloatArray  # u' [m/s^3], (n, 3)
    present: FloatArray  # scratch: u at the stamp of a scan, (2, 3)
    fields: RecordArray  # (n / 2,) of ``BEAM_FIELD``

    @classmethod
    def allocate(cls, beams: int) -> Oscillators:
        """Return zeros for a number of beams."""
        numbers, fields = np.zeros(2 * beams, dtype=OSCILLATOR), np.zeros(beams, dtype=BEAM_FIELD)
        forces, slopes, filtered, rates = np.zeros((4, 2 * beams, 3))
        stamps_ns = np.zeros(2 * beams, dtype=np.int64)
        return cls(numbers, stamps_ns, forces, slopes, filtered, rates, np.zeros((2, 3)), fields)


@in_place
def _swing(oscillators: Oscillators, n: int, k: int, seconds: float, slope: float) -> tuple[float, float]:
    """Return u and u' along axis k after a time in which f has a slope [m/s^3]."""
    own = oscillators.numbers[n]
    angular, decay = own["angular"], own["decay"]
    damped = math.sqrt(angular * angular - decay * decay)
    fading = math.exp(-decay * seconds)
    sine, cosine = fading * math.sin(damped * seconds) / damped, fading * math.cos(damped * seconds)
    lag = 2.0 * decay * slope / (angular * angular)  # of the solution that follows the straight line
    start, rate = oscillators.filtered[n, k] - (oscillators.forces[n, k] - lag), oscillators.rates[n, k] - slope
    u = (cosine + decay * sine) * start + sine * rate
    change = -angular * angular * sine * start + (cosine - decay * sine) * rate
    return oscillators.forces[n, k] + slope * seconds - lag + u, slope + change


@in_place
def follow_reading(oscillators: Oscillators, reading: FloatArray, n: int, stamp_ns: int) -> None:
    """Advance oscillator n to a reading (3,) [m/s^2] of its accelerometer."""
    own, first = oscillators.numbers[n], oscillators.stamps_ns[n] == 0
    seconds = (stamp_ns - oscillators.stamps_ns[n]) * 1e-9
    excess = speed = 0.0
    for k in range(3):
        force = -reading[k]
        if first:
            oscillators.filtered[n, k], oscillators.rates[n, k], oscillators.slopes[n, k] = force, 0.0, 0.0
        else:
            slope = (force - oscillators.forces[n, k]) / seconds
            u, rate = _swing(oscillators, n, k, seconds, slope)
            oscillators.filtered[n, k], oscillators.rates[n, k], oscillators.slopes[n, k] = u, rate, slope
            excess += (u - force) * (u - force)
            speed += rate * rate
        oscillators.forces[n, k] = force
    oscillators.stamps_ns[n] = stamp_ns
    if first:
        own["excess"] = own["speed"] = own["step_s"] = 0.0
    else:
        kept = math.exp(-seconds / MEMORY_S)
        own["excess"], own["speed"] = max(kept * own["excess"], excess), max(kept * own["speed"], speed)
        own["step_s"] = seconds


@in_place
def write_vibration(oscillators: Oscillators, vibrations: RecordArray, b: int, stamp_ns: int) -> None:
    """Write the specific force that bends beam b at the stamp of a scan into ``vibrations`` (1, b) of ``VIBRATION``."""
    vibration, own, numbers = vibrations[0, b], oscillators.fields[b], oscillators.numbers
    near, far, late_s = 2 * b, 2 * b + 1, 0.0
    for i in range(2):
        n = near + i
        seconds = (stamp_ns - oscillators.stamps_ns[n]) * 1e-9
        late_s = max(late_s, seconds)
        for k in range(3):
            oscillators.present[i, k], _ = _swing(oscillators, n, k, seconds, oscillators.slopes[n, k])
    mean, difference, share = vibration["mean"], vibration["difference"], own["far_share"]
    for k in range(3):
        first, second = oscillators.present[0, k], oscillators.present[1, k]
        mean[k] = (1.0 - share) * first + share * second
        difference[k] = own["stretch"] * (second - first)
    step_s = max(numbers[near]["step_s"], numbers[far]["step_s"])
    # White noise of a reading passes enlarged by the resonance, whose width is 2 decay.
    enlarged = 0.25 * own["angular"] * own["angular"] / numbers[near]["decay"] * step_s
    noise = own["reading"] * own["reading"] * (1.0 + enlarged)
    excess, speed = numbers[near]["excess"] + numbers[far]["excess"], numbers[near]["speed"] + numbers[far]["speed"]
    unknown = 0.0  # share of u - f, squared
    vibration["bounded"] = 1
    if excess > NOISE_FACTOR * NOISE_FACTOR * noise:
        square = own["angular"] * own["angular"] * excess / speed  # r^2
        unknown = 1.0
        if square > own["limit"] * own["limit"]:
            vibration["bounded"] = 0
        else:
            relative = 2.0 * own["frequency"] / (1.0 - square)
            unknown = relative * relative + own["model"] * own["model"]
        between = own["angular"] * own["angular"] * max(step_s * step_s, 6.0 * late_s * late_s) / 12.0
        unknown += between * between  # of w_v^2 h^2 u / 12, where u is (u - f) / r^2
    # The largest amounts are amplitudes, whose squares are twice the mean squares.
    both = 0.5 * (math.sqrt(numbers[near]["excess"]) + math.sqrt(numbers[far]["excess"]))
    fastest = 0.5 * (math.sqrt(numbers[near]["speed"]) + math.sqrt(numbers[far]["speed"]))
    mean_weight = (1.0 - share) * (1.0 - share) + share * share
    stretch, late = own["stretch"] * own["stretch"], own["delay_s"] * own["delay_s"]
    vibration["sigma_mean"] = math.sqrt(noise * mean_weight + 0.5 * (unknown * both * both + late * fastest * fastest))
    vibration["sigma_difference"] = math.sqrt(stretch * (2.0 * noise + 0.5 * (unknown * excess + late * speed)))


@dataclass
class _Accelerometer:
    """An accelerometer and its readings."""

    index: int  # of its oscillator
    beam: MeasuringBeam
    entry: VibrationFile
    waiting: deque[tuple[int, tuple[float, ...], str]] = field(default_factory=lambda: deque(maxlen=MOST_WAITING))
    refusal: str = ""  # why the newest reading was refused
    began_ns: int = 0  # since when readings have followed each other; zero: there is none
    gap_s: float = 0.0  # before that, if there were readings [s]
    last_ns: int = 0  # of the last reading in use
    last: tuple[float, ...] = ()
    same_ns: list[int] = field(default_factory=lambda: [0, 0, 0])  # since when it reads the same along each axis
    twin: str | None = None  # another accelerometer that reads the same; empty: there is none; None: not yet compared
    twin_ns: int = 0  # since when
    clock: str = ""  # how the stamp of the newest reading contradicts those of the scans
    mean: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # of readings plus computed gravity [m/s^2]
    weight: float = 0.0  # of what has been read in the mean, else zero
    mean_ns: int = 0
    largest: float = 0.0  # amount of a reading plus computed gravity [m/s^2], which is forgotten as the mean is

    def forget(self) -> None:
        """Forget what has been read; readings that wait stay."""
        self.refusal, self.began_ns, self.gap_s, self.last_ns, self.last, self.twin = "", 0, 0.0, 0, (), None
        self.mean, self.weight, self.mean_ns, self.largest = [0.0, 0.0, 0.0], 0.0, 0, 0.0

    def refusal_of(self, values: tuple[float, ...], other: str) -> str:
        """Return why a reading cannot be used; else empty. ``other``: another accelerometer that its message names."""
        largest = self.entry.accelerometers.range.number
        if other:
            return f"receives the readings of '{other}'"
        if not all(map(math.isfinite, values)):
            return "does not read numbers"
        if max(map(abs, values)) > largest:
            return f"reads more than {largest:g} m/s^2"
        return ""

    def fault(self, stamp_ns: int) -> str:
        """Return why the accelerometer cannot be used for the scan of a stamp; else empty."""
        if self.refusal:
            return self.refusal
        age = self.entry.accelerometers.age.number
        if not self.last_ns or stamp_ns - self.last_ns > round(age * NS):
            return f"has no reading whose stamp is at most {age:g} s old{self.clock}"
        if repeated := self._repetition(stamp_ns):
            return repeated
        if math.hypot(*self.mean) > GRAVITY_TOLERANCE * STANDARD_GRAVITY * self.weight + RIPPLE * self.largest:
            return "does not read gravity as the arm stands: check its unit, its axes, and whether it is exchanged"
        if (self.last_ns - self.began_ns) / NS < self.settling_s:
            apart = f"has readings {self.gap_s:g} s apart, more than {age:g} s" if self.gap_s else "has begun to read"
            return f"{apart}; the beam is not yet followed"
        return ""

    def _repetition(self, stamp_ns: int) -> str:
        """Return what the accelerometer has read for too long; else empty."""
        for axis, same_ns in zip("XYZ", self.same_ns, strict=True):
            if self.last_ns - same_ns >= FROZEN_S * NS:
                return f"has read the same along {axis} for {FROZEN_S:g} s"
        if self.twin and stamp_ns - self.twin_ns >= FROZEN_S * NS:
            return f"has read the same as '{self.twin}' for {FROZEN_S:g} s"
        return ""

    @property
    def settling_s(self) -> float:
        """Time after which the oscillator does not depend on how it began, and the readings have been checked [s]."""
        return max(SETTLED / (2.0 * math.pi * self.entry.frequency.number * self.entry.damping.number), FROZEN_S)


class BeamVibrations:
    """Follows the vibration of the beams of an estimator by their accelerometers.

    While an accelerometer cannot be used, its beam is taken as at rest, with the stated ``spread`` of the acceleration.

    Attributes:
        names: Of all accelerometers.
        reason: What is wrong with accelerometers, and which beams vibrate too fast, as a sentence; empty: nothing.

    """

    def __init__(self, beams: Sequence[MeasuringBeam], estimator: EndpointEstimator) -> None:
        """Take the beams of a chain, and an estimator of this chain."""
        self._estimator, self._beams = estimator, [(b, beam) for b, beam in enumerate(beams) if beam.entry.vibration]
        self._oscillators = Oscillators.allocate(len(beams))
        numbers, fields = self._oscillators.numbers, self._oscillators.fields
        self._all: dict[str, _Accelerometer] = {}
        for b, beam in self._beams:
            entry, sag = beam.entry.vibration, beam.entry.sag
            if entry is None or sag is None:
                continue
            (near, far), length = sag.gimbals.array, float(np.linalg.norm(beam.T_start_end.translation))
            angular = 2.0 * math.pi * entry.frequency.number
            numbers["angular"][2 * b : 2 * b + 2] = angular
            numbers["decay"][2 * b : 2 * b + 2] = angular * entry.damping.number
            relative = float(entry.frequency.sigmas) / entry.frequency.number
            shares = (0.5 * length - near) / (far - near), length / (far - near)
            own = entry.accelerometers
            stated = own.uncertainty.number, own.delay.number, relative, entry.uncertainty.number, entry.limit.number
            fields[b] = (*shares, *stated, angular)
            for i, name in enumerate(entry.accelerometers.names):
                self._all[name] = _Accelerometer(2 * b + i, beam, entry)
        self.names = tuple(self._all)
        self._scan_ns = 0  # stamp of the last scan
        self._reading = np.zeros(3)
        self._follow = bind(follow_reading, (self._oscillators, self._reading))
        self.reason = ""

    def add(self, name: str, stamp_ns: int, reading: tuple[float, float, float], frame: str = "") -> None:
        """Add a reading [m/s^2] of an accelerometer, (3,), which is upward at rest; ``frame``: of its message."""
        own, other = self._all[name], frame if frame != name and frame in self._all else ""
        while own.waiting and own.waiting[-1][0] >= stamp_ns:  # a wrong stamp would hold up the readings that follow
            own.waiting.pop()
        own.waiting.append((stamp_ns, reading, other))
        own.clock = ""
        if self._scan_ns and abs(stamp_ns - self._scan_ns) > OTHER_CLOCK_S * NS:
            side = "ahead of" if stamp_ns > self._scan_ns else "behind"
            own.clock = f": its stamps are more than {OTHER_CLOCK_S:g} s {side} those of the scans"

    def refuse(self, name: str, reason: str) -> None:
        """Note why a message of an accelerometer cannot be used: its beam is at rest until the next that can be.

        ``reason``: clause that follows the name of the accelerometer.
        """
        self._all[name].refusal = reason

    def restart(self) -> None:
        """Forget all readings."""
        self._scan_ns = 0
        for each in self._all.values():
            each.waiting.clear()
            self._forget(each)

    def _forget(self, own: _Accelerometer) -> None:
        own.forget()
        self._oscillators.stamps_ns[own.index] = 0

    def update(self, stamp_ns: int) -> None:
        """Write the specific forces that bend the beams at the stamp of a scan [ns], from the readings up to then."""
        for each in self._all.values():
            self._read_until(each, stamp_ns)
        self._scan_ns = stamp_ns
        self._find_twins(stamp_ns)
        vibrations, clauses = self._estimator.vibrations, []
        for b, beam in self._beams:
            faults = {
                n: fault for n, each in self._all.items() if each.beam is beam and (fault := each.fault(stamp_ns))
            }
            if faults:
                self._estimator.reset_vibration(b)
                clauses += [f"accelerometer '{name}' of beam '{beam.name}' {fault}" for name, fault in faults.items()]
                continue
            write_vibration(self._oscillators, vibrations, b, stamp_ns)
            if not vibrations[0, b]["bounded"] and beam.entry.vibration is not None:
                limit, natural = beam.entry.vibration.limit.number, beam.entry.vibration.frequency.number
                most = f"{limit * natural:.4g} Hz, {limit:g} of its first natural frequency"
                clauses.append(f"beam '{beam.name}' vibrates faster than {most}: the protection level is not bounded")
        self.reason = "; ".join(clauses)

    def _read_until(self, own: _Accelerometer, stamp_ns: int) -> None:
        """Use the readings up to the stamp of a scan, in the order of their arrival."""
        if own.last_ns > stamp_ns:  # a replay has started again
            self._forget(own)
        while own.waiting and own.waiting[0][0] <= stamp_ns:
            at_ns, reading, other = own.waiting.popleft()
            own.refusal = own.refusal_of(reading, other)
            if own.refusal or at_ns <= own.last_ns:
                continue
            gap_ns = at_ns - own.last_ns if own.last_ns else 0
            if gap_ns > round(own.entry.accelerometers.age.number * NS):
                self._forget(own)
                own.gap_s = gap_ns / NS
            own.began_ns = own.began_ns or at_ns
            before = own.last or (math.nan,) * 3
            own.same_ns = [
                since if new == old else at_ns for since, new, old in zip(own.same_ns, reading, before, strict=True)
            ]
            own.last = reading
            self._reading[:] = reading
            self._follow(own.index, at_ns)
            self._compare_with_gravity(own, at_ns)
            own.last_ns = at_ns

    def _find_twins(self, stamp_ns: int) -> None:
        """Find accelerometers that read the same, as one sensor with the topics of two does."""
        owners: dict[tuple[float, ...], list[str]] = {}
        for name, own in self._all.items():
            if own.last:
                owners.setdefault(own.last, []).append(name)
        for name, own in self._all.items():
            twin = next((each for each in owners.get(own.last, ()) if each != name), "")
            since_ns = own.began_ns if own.twin is None else stamp_ns
            if own.last and twin != own.twin:
                own.twin, own.twin_ns = twin, since_ns

    def _compare_with_gravity(self, own: _Accelerometer, at_ns: int) -> None:
        """Keep the mean of what is left of a reading without gravity in the axes of the beam in the last scan."""
        gravity = self._estimator.static_forces[own.index // 2]
        if not math.isnan(gravity[0]):
            own.mean_ns = own.mean_ns or at_ns
            share = min((at_ns - max(own.last_ns, own.mean_ns)) / NS / GRAVITY_S, 1.0)
            left = [reading + g for reading, g in zip(own.last, gravity.tolist(), strict=True)]
            own.weight += share * (1.0 - own.weight)
            own.mean = [mean + share * (each - mean) for mean, each in zip(own.mean, left, strict=True)]
            own.largest = max((1.0 - share) * own.largest, math.hypot(*left))
