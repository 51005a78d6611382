"""Faults put into simulated runs.

Is each flagged within one scan, how often does a sound scan raise an alarm, and from which size on can a shift of a
reading be seen at all?
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor_estimator.accuracy.poses import TICK_NS
from posor_estimator.core.designs import DesignName, design
from posor_estimator.core.fault import State
from posor_estimator.core.forward import scans_at
from posor_estimator.core.kernels.motion import NOISE_ALLOWANCE
from posor_estimator.core.native import rotation_from_native
from posor_estimator.core.posor import Posor
from posor_estimator.core.sensors.bumpy_ring import BumpyRing

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_estimator.core.scan import Scan, Scans
    from posor_estimator.core.types import FloatArray

SPOT_SHIFT = 50e-6
ZERO_SHIFT = 0.1
LOST_SCANS = 100
SPEED = 2.0  # of theta in the runs with a ring [rad/s]
SETTLED = 20  # scans before a fault comes
FALSE_ALARM = 1e-3

if TYPE_CHECKING:
    Spoil = Callable[[Scan, np.random.Generator], Scan]


@dataclass(frozen=True)
class Detection:
    """How often a fault was flagged in its first scan, and how often a sound scan was flagged."""

    detected_fraction: float
    false_alarm_fraction: float

    def as_dict(self) -> dict[str, float]:
        """Return the figures by name."""
        return asdict(self)


def _run(posor: Posor, speed: float, count: int, random: np.random.Generator) -> Scans:
    """Return a sound run of scans at 1 kHz: theta turns at a speed, the runout and the lean wander slowly with it."""
    times = np.arange(count) * TICK_NS * 1e-9
    start = random.uniform(-0.02, 0.02)
    thetas = start + speed * times
    rotations = np.array([rotation_from_native(2e-5 * math.sin(t), 2e-5 * math.cos(t), t) for t in thetas])
    wander = 5e-6 * np.column_stack([np.cos(thetas), np.sin(thetas), np.sin(2.0 * thetas)])
    translations = np.array([0.0, 0.0, 0.7e-3]) + wander
    stamps = np.arange(1, count + 1, dtype=np.int64) * TICK_NS
    scans = scans_at(posor.stack, rotations, translations, stamps, noise=random)
    at_home = np.zeros(count, dtype=np.int64)
    at_home[0] = 1  # the ring's count begins at the first scan
    return replace(scans, at_home=at_home)


def _dirty_diode(scan: Scan, random: np.random.Generator) -> Scan:
    """Shift one spot by 50 um in a random direction: 50 um are a ratio of about 1 / 120 over the middle of the map."""
    currents = scan.diode_currents.copy()
    direction = random.uniform(0.0, 2.0 * math.pi)
    per_metre = 0.9 / (6e-3 * 1.05)
    for axis, part in enumerate((math.cos(direction), math.sin(direction))):
        total = currents[0, axis] + currents[0, axis + 2]
        change = 0.5 * total * SPOT_SHIFT * part * per_metre
        currents[0, axis] += change
        currents[0, axis + 2] -= change
    return replace(scan, diode_currents=currents)


def _bumped_probe(scan: Scan, random: np.random.Generator) -> Scan:
    """Shift the zero of one gap probe by 0.1 V."""
    volts = scan.gap_voltages.copy()
    volts[random.integers(len(volts))] += ZERO_SHIFT * random.choice([-1.0, 1.0])
    return replace(scan, gap_voltages=volts)


def _unlit(scan: Scan, random: np.random.Generator) -> Scan:
    """Let one source not light: a thousandth of the current is left."""
    currents = scan.diode_currents.copy()
    currents[random.integers(len(currents))] *= 1e-3
    return replace(scan, diode_currents=currents)


def _two_lit(scan: Scan, random: np.random.Generator) -> Scan:
    """Let a second source shine on one diode: its currents add, its spot is elsewhere."""
    currents = scan.diode_currents.copy()
    diode = random.integers(len(currents))
    total = currents[diode, 0] + currents[diode, 2]
    ratio = random.uniform(-0.8, 0.8, 2)
    currents[diode, :2] += 0.5 * total * (1.0 + ratio)
    currents[diode, 2:] += 0.5 * total * (1.0 - ratio)
    return replace(scan, diode_currents=currents)


def _sound(scan: Scan, random: np.random.Generator) -> Scan:  # noqa: ARG001  one of the spoils
    """Leave the scan as it is: the fault is that the ones before it were lost."""
    return scan


FAULTS: dict[str, tuple[DesignName, float, int, Spoil]] = {
    "contaminated_diode": ("triad_diodes", 0.5, 0, _dirty_diode),
    "bumped_probe": ("triad_diodes", 0.5, 0, _bumped_probe),
    "missed_bump": ("triad_bumpy_ring", SPEED, LOST_SCANS, _sound),
    "unlit_source": ("triad_light_ring", 0.5, 0, _unlit),
    "two_sources": ("triad_light_ring", 0.5, 0, _two_lit),
}
"""Fault: design, speed of theta [rad/s], scans lost just before it, and what happens to the scan."""


def detection(fault: str, runs: int, seed: int) -> Detection:
    """Return how a fault fares over a number of simulated runs."""
    stack, speed, lost, spoil = FAULTS[fault]
    random = np.random.default_rng(seed)
    detected = alarms = sound = 0
    posor = Posor(design(stack, motion=True), false_alarm=FALSE_ALARM)
    for _ in range(runs):
        posor.reset()
        scans = _run(posor, speed, SETTLED + lost + 1, random)
        before = posor.locate_all(scans.part(0, SETTLED))
        alarms += int(np.sum(before.states != State.OK))
        sound += SETTLED
        detected += posor.locate(spoil(scans[SETTLED + lost], random)).state is not State.OK
    return Detection(detected / runs, alarms / sound)


def ring_observability(probes: int) -> FloatArray:
    """Return ``BumpyRing.observability`` of the design with so many ring probes, over one bump."""
    ring = Posor(design("triad_bumpy_ring", ring_probes=probes)).stack.sensors[1]
    if not isinstance(ring, BumpyRing):
        message = "the second sensor of the design is its ring"
        raise TypeError(message)
    return ring.observability(np.linspace(0.0, 2.0 * math.pi, 721))


@dataclass(frozen=True)
class Visibility:
    """From which size on a shift of one linearised reading is flagged at once, and by which test.

    Attributes:
        reading: Which reading.
        by_motion_m: Smallest shift [m] that moves the pose further than the target can have moved in one scan.
        by_residual_m: Smallest shift [m] that takes chi-square over its limit on average; infinite where no redundant
            reading takes notice.

    """

    reading: str
    by_motion_m: float
    by_residual_m: float

    @property
    def smallest_m(self) -> float:
        """What the better of the two tests sees [m]."""
        return min(self.by_motion_m, self.by_residual_m)


def visibility(stack: DesignName) -> list[Visibility]:
    """Return what a shift of each reading must be to be seen within one scan, at 1 kHz, in the middle of the range."""
    posor = Posor(design(stack, motion=True), false_alarm=FALSE_ALARM)
    scans = _run(posor, 0.0, 1, np.random.default_rng(0))
    thetas = np.zeros(1)
    centre = posor.locate_each(scans, thetas)
    spread = np.sqrt(2.0 * np.diagonal(centre.covariances_random[0]))
    motion = posor.calibration.motion
    if motion is None:
        message = "the design was asked for its motion limits"
        raise AssertionError(message)
    tick = TICK_NS * 1e-9
    rates = np.array([motion.translation.number] * 3 + [motion.lean.number] * 2 + [motion.theta.number])
    allowed = rates * tick + NOISE_ALLOWANCE * spread
    moves, misfits = posor.sensitivity(scans[0], pin.SE3(centre.rotations[0], centre.translations[0]))
    limit = posor.residual_limit
    return [
        Visibility(
            name,
            float(np.min(allowed / np.maximum(np.abs(move), 1e-300))),
            math.sqrt(limit / misfit) if misfit > 1e-6 * float(np.max(misfits)) else math.inf,
        )
        for name, move, misfit in zip(posor.stack.reading_names, moves.T, misfits, strict=True)
    ]
