# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Endpoints of vibrating arms by the static and the dynamic chain, compared with the independent truth. No ROS.

Each arm is drawn within the uncertainties of its files. One link oscillates across; direction and phase are drawn. The
beams follow by finite elements, at all their modes. Estimators and chain know only files and readings.
"""

from __future__ import annotations

from functools import cache, partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.bags.recording import unpack_poses
from posor.calibration.quantity import Quantity
from posor.chain.arm_file import load_arm_file
from posor.chain.beam_vibration import BeamVibrations
from posor.chain.beams_file import load_beams
from posor.chain.kinematic_chain import Chain
from posor.errors import ParameterError
from posor.estimation.posor import Posor
from posor.numerics.stamps import NS, tick_stamp_ns
from posor_drivers.simulator.arm_truth import true_cycle
from posor_drivers.simulator.imperfections import Imperfections
from posor_drivers.simulator.link_vibration import BeamAccelerometers
from posor_drivers.simulator.nominal_arm import NominalArm
from posor_drivers.simulator.scenario import LinkVibration, load_scenario

from posor_lab.accuracy.consistency import REGION_LIMIT, normalised_squares
from posor_lab.arm_study.filter_runs import FALSE_ALARM, estimate_run, noisy_scans, stack_joints
from posor_lab.harness.random_poses import errors_in_parent
from posor_lab.independent.true_arm import TrueArm
from posor_lab.reports.process_pool import ordered_map

if TYPE_CHECKING:
    from pathlib import Path

    from posor.numerics.array_types import FloatArray
    from posor_drivers.simulator.pose_array import ArmTruth

RATE, SECONDS = 2000, 0.6  # readings of the accelerometers per second; length of a run, whole periods of 5/3 Hz
TICKS_PER_SCAN, SCANS = 4, 40  # the last scans of a run are judged
AMPLITUDE_M = 250e-6  # of the end of the link
JOINT = "shoulder"  # before the link that oscillates: the longest beam
DRAWN = Imperfections.only("beam_errors", "sag", "vibration")
STATIC, DYNAMIC = "static chain", "dynamic chain"


class Case(NamedTuple):
    """Figures of one chain on many arms at one frequency."""

    rms_m: float  # of the position error [m]
    stated_m: float  # root mean trace of the published covariance of the position [m]
    inside: float  # share of the poses in the published 95 % region
    bounded: float  # share of the poses whose protection level is bounded


class VibrationStudy:
    """Draws arms with the files of an arm; a seed determines an arm."""

    def __init__(self, path: Path) -> None:
        """Read the files of an arm made by ``write_vibrating_arm``. Raises PosorError: a file is invalid."""
        arm = load_arm_file(path)
        if arm.scenario is None or arm.beams is None:
            raise ParameterError("has no beams file or no scenario", where=str(path), expected="a simulated arm")
        self._scenario, self._source = load_scenario(arm.scenario).at_rate(RATE), str(arm.scenario)
        beams = load_beams(arm.beams)
        still = beams.model_copy(update={"beams": [b.model_copy(update={"vibration": None}) for b in beams.beams]})
        self.chain, self._static = arm.chain(), Chain(arm.urdf.read_text("utf-8"), arm.endpoint_frame, still)
        self._truth = TrueArm(path)
        self._nominal = NominalArm(self.chain, self._truth)
        # The limits of motion in the calibrations are those of a quiet shop.
        calibrations = {n: arm.calibration(n).model_copy(update={"motion": None}) for n in self._nominal.joints}
        self._posors = {name: Posor(each, false_alarm=FALSE_ALARM) for name, each in calibrations.items()}
        self._commanded = self._scenario.commanded_angles(self._nominal, self._source)

    @property
    def limit_hz(self) -> float:
        """Lowest limit of a beam."""
        stated = [beam.entry.vibration for beam in self.chain.beams]
        return min(entry.limit.number * entry.frequency.number for entry in stated if entry is not None)

    def _truth_of(self, seed: int, frequency: float) -> ArmTruth:
        random = np.random.default_rng([seed, round(frequency)])
        vibration = LinkVibration(
            frequency=Quantity(value=frequency, unit="Hz"),
            amplitude=Quantity(value=AMPLITUDE_M, unit="m"),
            direction=Quantity(value=random.normal(size=3).tolist(), unit="1"),
            phase=Quantity(value=float(random.uniform(0.0, 2.0 * np.pi)), unit="rad"),
        )
        scenario = self._scenario.model_copy(update={"seed": seed, "vibrations": {JOINT: vibration}})
        commanded = np.tile(self._commanded[random.integers(len(self._commanded))], (round(SECONDS * RATE), 1))
        return true_cycle(scenario, self.chain, self._nominal, commanded, DRAWN, self._truth)

    def errors(self, seed: int, frequency: float, chain: Chain) -> dict[str, tuple[FloatArray, ...]]:
        """Return errors (n, 6), covariances (n, 6, 6) and whether levels are bounded (n,) of a drawn arm, by chain.

        ``chain``: that estimates, as this one or with wrong natural frequencies.
        """
        truth, random = self._truth_of(seed, frequency), np.random.default_rng([seed, 1])
        count = len(truth.commanded)
        ticks = np.arange(count - SCANS * TICKS_PER_SCAN, count, TICKS_PER_SCAN)
        seen, stamps_ns = truth.select(ticks), tick_stamp_ns(ticks, RATE) + NS
        found = []
        for name, posor in self._posors.items():
            plates = seen.T_parent_child[name]
            found.append(estimate_run(posor, noisy_scans(posor, plates, stamps_ns, random), plates.rotations[0]))
        parts = stack_joints(found)
        static = self._static.estimate_all(*parts)
        estimator = chain.estimator()
        vibrations = BeamVibrations(chain.beams, estimator)
        sensors = BeamAccelerometers(self.chain.beams, truth.specific_forces, seed)
        poses, covariances, bounded, next_tick = np.empty((SCANS, 7)), np.empty((SCANS, 6, 6)), np.empty(SCANS), 0
        for n, tick in enumerate(ticks.tolist()):
            for each in range(next_tick, tick + 1):
                for name, reading in sensors.readings(each).items():
                    vibrations.add(name, int(tick_stamp_ns(each, RATE)) + NS, (reading[0], reading[1], reading[2]))
            next_tick = tick + 1
            vibrations.update(int(stamps_ns[n]))
            estimator.poses[:], estimator.covariances_random[:] = parts[0][n], parts[1][n]
            estimator.covariances_systematic[:] = parts[2][n]
            if not estimator.estimate(int(stamps_ns[n])) or "accelerometer" in vibrations.reason:
                what = estimator.fault_text() or vibrations.reason
                raise ParameterError(what, where=f"drawn arm {seed} at {frequency:g} Hz", expected="a pose")
            poses[n], covariances[n] = estimator.pose, estimator.covariance()
            bounded[n] = estimator.vibrations["bounded"].all()
        true = seen.endpoint
        return {
            name: (errors_in_parent(*unpack_poses(own), true.rotations, true.translations), stated, known)
            for name, own, stated, known in (
                (STATIC, static.poses, static.covariances(), np.ones(SCANS)),
                (DYNAMIC, poses, covariances, bounded),
            )
        }


_study = cache(VibrationStudy)  # each worker reads the files once


def _errors(path: Path, frequency: float, chain: Path, seed: int) -> dict[str, tuple[FloatArray, ...]]:
    return _study(path).errors(seed, frequency, _study(chain).chain)


def sample_vibration(
    path: Path, frequency: float, arms: int, seed: int, *, chain: Path | None = None, workers: int = 0
) -> dict[str, Case]:
    """Return the figures of each chain on drawn arms.

    ``chain``: arm file of the chain that estimates; None: the same; ``workers``: number of processes, 0: one for each
    processor.
    """
    parts = ordered_map(partial(_errors, path, frequency, chain or path), range(seed, seed + arms), workers)
    found = {}
    for name in (STATIC, DYNAMIC):
        errors, covariances, bounded = (np.concatenate(each) for each in zip(*(p[name] for p in parts), strict=True))
        found[name] = Case(
            rms_m=float(np.sqrt(np.mean(np.sum(np.square(errors[:, :3]), axis=1)))),
            stated_m=float(np.sqrt(np.mean(np.trace(covariances[:, :3, :3], axis1=1, axis2=2)))),
            inside=float(np.mean(normalised_squares(errors, covariances) <= REGION_LIMIT)),
            bounded=float(np.mean(bounded)),
        )
    return found
