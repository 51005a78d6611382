# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Error and coverage of the endpoint of arms whose beams are warm, with and without thermometers. No ROS.

Each arm is drawn within the uncertainties of its files: temperatures, gradients and errors of thermometers too. Its
warm beams, its sag and its readings are those of the independent truth (``independent.true_arm``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from posor.calibration.quantity import Quantity
from posor.chain.arm_file import load_arm_file
from posor.chain.beam_temperatures import CELSIUS, PERIOD_NS, BeamTemperatures
from posor_drivers.simulator.imperfections import Imperfections
from posor_drivers.simulator.scenario import BeamTemperature

from posor_lab.arm_study.arm_coverage import ArmSampler, share_inside
from posor_lab.reports.process_pool import draw_batches

if TYPE_CHECKING:
    from pathlib import Path

    from posor.chain.endpoint_estimator import EndpointEstimator
    from posor.numerics.array_types import FloatArray

    from posor_lab.accuracy.consistency import MeanEstimate
    from posor_lab.arm_study.arm_coverage import MeasuredArm

IN_THE_SHOP = Imperfections.only("noise", "quantisation", "calibration_errors", "beam_errors", "sag", "temperature")
WITH, WITHOUT, WRONG_SIGN = "with thermometers", "without thermometers", "with the wrong sign"
SIGNS = {WITH: 1.0, WITHOUT: None, WRONG_SIGN: -1.0}
"""Cases, and by what the compensated temperature is multiplied; None: no thermometer is read."""
SWING_K, LAG_RAD = 10.0, 0.1
"""Sine of the temperature of all beams during a shift, and its lag from beam to beam."""
BATCH = 25  # arms per task of a worker
BEGIN = 100  # period of the first pose


@dataclass(frozen=True)
class CaseSample:
    """Errors of a arms at p poses in one case; NaN where a POSOR has no pose."""

    errors: FloatArray  # ROS order, axes of the base, (a, p, 6)
    normalised: FloatArray  # squares of the errors normalised by the published covariance, (a, p)

    @property
    def rms_m(self) -> float:
        """Root mean square of the position error [m]."""
        return float(np.sqrt(np.nanmean(np.sum(np.square(self.errors[..., :3]), axis=-1))))

    @property
    def inside(self) -> MeanEstimate:
        """Share of the poses inside their 95 % region; a lost pose is outside."""
        return share_inside(self.normalised)


def read_thermometers(
    sampler: ArmSampler, estimator: EndpointEstimator, arm: MeasuredArm, pose: int, sign: float
) -> BeamTemperatures:
    """Bring the beams of an estimator to the readings at a pose, with deviations from the reference times a sign."""
    temperatures = BeamTemperatures(sampler.chain.beams, estimator)
    for beam in sampler.chain.beams:
        if beam.entry.thermometer is not None:
            kelvin = beam.entry.thermometer.reference.number + sign * float(arm.heats[beam.name].readings[pose])
            temperatures.add(beam.entry.thermometer.name, (BEGIN - 1) * PERIOD_NS, kelvin - CELSIUS)
    temperatures.update(BEGIN * PERIOD_NS)
    return temperatures


class ShopSampler:
    """Draws arms; a seed determines an arm."""

    def __init__(self, path: Path, poses: int, *, swing: bool = False) -> None:
        """Read the files of an arm made by ``write_shop_arm``.

        ``swing``: the temperature of the shop changes from pose to pose as in a shift; else it is drawn as the beams
        file states, constant for an arm. Raises PosorError: a file is invalid.
        """
        self._arms = ArmSampler(load_arm_file(path), poses)
        self._poses = poses
        amplitude = Quantity(value=SWING_K, unit="K")
        shift = {
            name: BeamTemperature(amplitude=amplitude, phase=Quantity(value=LAG_RAD * n, unit="rad"))
            for n, name in enumerate(self._arms.scenario.temperatures)
        }
        self._scenario = self._arms.scenario.model_copy(update={"temperatures": shift if swing else {}})

    def draw(self, seeds: range) -> dict[str, CaseSample]:
        """Return the errors of the arms with these seeds, by case."""
        shape = len(seeds), self._poses
        samples = {case: CaseSample(np.full((*shape, 6), np.nan), np.full(shape, np.nan)) for case in SIGNS}
        for n, seed in enumerate(seeds):
            arm = self._arms.measure(self._scenario.model_copy(update={"seed": seed}), IN_THE_SHOP)
            for k, pose in enumerate(np.flatnonzero(arm.known).tolist()):
                for case, sign in SIGNS.items():
                    estimator = self._arms.estimator()
                    if sign is not None:
                        read_thermometers(self._arms, estimator, arm, pose, sign)
                    errors, normalised = arm.judge(estimator, slice(k, k + 1))
                    samples[case].errors[n, pose], samples[case].normalised[n, pose] = errors[0], normalised[0]
        return samples


def sample_shop(path: Path, arms: int, poses: int, seed: int, *, swing: bool = False) -> dict[str, CaseSample]:
    """Draw many arms, see ``ShopSampler``."""
    sampler = partial(ShopSampler, path, poses, swing=swing)
    parts = draw_batches(sampler, ShopSampler.draw, range(seed, seed + arms), BATCH)
    return {
        case: CaseSample(
            *(np.concatenate([getattr(part[case], name) for part in parts]) for name in ("errors", "normalised"))
        )
        for case in SIGNS
    }
