# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Detection of faults in simulated runs: flagged in the first scan, false alarms, smallest detectable shift."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

import numpy as np
import pinocchio as pin
from posor.calibration.designs import DesignName, design
from posor.estimation.posor import Posor
from posor.estimation.scan_checks import NOISE_ALLOWANCE
from posor.model.fault import State
from posor.model.native_coordinates import rotation_from_native
from posor.model.scan import STATED_HOME
from posor.uncertainty.reading_sensitivity import sensitivity_at

from posor_lab.harness.random_poses import TICK_NS
from posor_lab.true_scans import TruePosor

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor.calibration.calibration_file import Motion
    from posor.model.scan import Scan, Scans
    from posor.numerics.array_types import FloatArray
    from posor.sensors.bumpy_ring import BumpyRing

    Corruption = Callable[[Scan, np.random.Generator], Scan]

SPOT_SHIFT = 50e-6  # [m]
ZERO_SHIFT = 0.1  # [V]
LOST_SCANS = 100
SPEED = 2.0  # of theta in the runs with a ring [rad/s]
SETTLED = 20  # scans before a fault
FALSE_ALARM = 0.1  # a mean rate of 1e-3 over all calibrations


@dataclass(frozen=True)
class Detection:
    """Share of faults flagged in their first scan, and share of sound scans that were flagged."""

    detected_fraction: float
    false_alarm_fraction: float


def _sound_scans(posor: Posor, speed: float, count: int, random: np.random.Generator) -> Scans:
    """Return scans at 1 kHz without a fault: theta turns steadily, runout and inclination vary slowly with it."""
    start = random.uniform(-0.02, 0.02)
    thetas = start + speed * (np.arange(count) * TICK_NS * 1e-9)
    rotations = np.array([rotation_from_native(2e-5 * math.sin(t), 2e-5 * math.cos(t), t) for t in thetas])
    runout = 5e-6 * np.column_stack([np.cos(thetas), np.sin(thetas), np.sin(2.0 * thetas)])
    stamps = np.arange(1, count + 1, dtype=np.int64) * TICK_NS
    places = np.array([0.0, 0.0, 0.7e-3]) + runout
    scans = TruePosor(posor.calibration).scans_at(posor.stack, rotations, places, stamps, noise=random)
    at_home = np.zeros(count, dtype=np.int64)
    at_home[0] = STATED_HOME  # the ring is counted from the first scan on
    return scans.with_fields({"at_home": at_home})


def _dirty_diode(scan: Scan, random: np.random.Generator) -> Scan:
    """Shift one spot by 50 um in a random direction, a ratio of about 1 / 120 in the middle of the map."""
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
    """Switch one source off: a thousandth of the current is left."""
    currents = scan.diode_currents.copy()
    currents[random.integers(len(currents))] *= 1e-3
    return replace(scan, diode_currents=currents)


def _two_lit(scan: Scan, random: np.random.Generator) -> Scan:
    """Light one diode by a second source: the currents add up, its spot is elsewhere."""
    currents = scan.diode_currents.copy()
    diode = random.integers(len(currents))
    total = currents[diode, 0] + currents[diode, 2]
    ratio = random.uniform(-0.8, 0.8, 2)
    currents[diode, :2] += 0.5 * total * (1.0 + ratio)
    currents[diode, 2:] += 0.5 * total * (1.0 - ratio)
    return replace(scan, diode_currents=currents)


def _unchanged(scan: Scan, random: np.random.Generator) -> Scan:  # noqa: ARG001  signature of a Corruption
    """Return the scan: the fault is the loss of the scans before it."""
    return scan


FAULTS: dict[str, tuple[DesignName, float, int, Corruption]] = {
    "contaminated_diode": ("triad_diodes", 0.5, 0, _dirty_diode),
    "bumped_probe": ("triad_diodes", 0.5, 0, _bumped_probe),
    "missed_bump": ("triad_bumpy_ring", SPEED, LOST_SCANS, _unchanged),
    "unlit_source": ("triad_light_ring", 0.5, 0, _unlit),
    "two_sources": ("triad_light_ring", 0.5, 0, _two_lit),
}
"""By fault: design, speed of theta [rad/s], scans lost before it, corruption of the scan."""


def detection(fault: str, runs: int, seed: int) -> Detection:
    """Return the detection of a fault over a number of simulated runs."""
    stack, speed, lost, corrupt = FAULTS[fault]
    random = np.random.default_rng(seed)
    detected = alarms = 0
    posor = Posor(design(stack, motion=True), false_alarm=FALSE_ALARM)
    for _ in range(runs):
        posor.reset()
        scans = _sound_scans(posor, speed, SETTLED + lost + 1, random)
        alarms += int(np.sum(posor.estimate_all(scans.part(0, SETTLED)).states != State.OK))
        detected += posor.estimate(corrupt(scans[SETTLED + lost], random)).state is not State.OK
    return Detection(detected / runs, alarms / (runs * SETTLED))


def ring_observability(probes: int) -> FloatArray:
    """Return ``BumpyRing.observability`` of the design with a number of ring probes, over one bump."""
    ring = Posor(design("triad_bumpy_ring", ring_probes=probes)).stack.sensors[1]
    return cast("BumpyRing", ring).observability(np.linspace(0.0, 2.0 * math.pi, 721))


@dataclass(frozen=True)
class DetectableShift:
    """Smallest shift of one linearised reading that is flagged at once, by test."""

    reading: str  # name of the reading
    by_motion_m: float  # smallest shift [m] that moves the pose further than the target can move in one scan
    by_residual_m: float  # smallest shift [m] that the chi-square test flags; infinite if no redundant reading responds

    @property
    def smallest_m(self) -> float:
        """Smallest shift that the better of the two tests flags [m]."""
        return min(self.by_motion_m, self.by_residual_m)


def detectable_shifts(stack: DesignName) -> list[DetectableShift]:
    """Return the smallest shift of each reading that is flagged within one scan, at 1 kHz, in mid-range."""
    posor = Posor(design(stack, motion=True), false_alarm=FALSE_ALARM)
    scans = _sound_scans(posor, 0.0, 1, np.random.default_rng(0))
    centre = posor.estimate_each(scans, np.zeros(1))
    spread = np.sqrt(2.0 * np.diagonal(centre.covariances_random[0]))
    motion = cast("Motion", posor.calibration.motion)
    rates = np.array([motion.translation.number] * 3 + [motion.lean.number] * 2 + [motion.theta.number])
    allowed = rates * TICK_NS * 1e-9 + NOISE_ALLOWANCE * spread
    sensitivity = sensitivity_at(posor, scans[0], pin.SE3(centre.rotations[0], centre.translations[0]))
    limit = posor.residual_limit
    return [
        DetectableShift(
            name,
            float(np.min(allowed / np.maximum(np.abs(move), 1e-300))),
            math.sqrt(limit / misfit) if misfit > 1e-6 * float(np.max(sensitivity.chi_square)) else math.inf,
        )
        for name, move, misfit in zip(
            posor.stack.reading_names, sensitivity.gain.T, sensitivity.chi_square, strict=True
        )
    ]
