# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Coverage of the published uncertainty, and effect of the sag, over many simulated arms. No ROS.

Each arm is drawn within the uncertainties of the files: all parameters of POSORs and measuring beams, sag, bearings,
and the noise of every reading. Its geometry, sag and readings are those of the independent truth. At several poses of
the scenario its raw scans go through estimators and chain as in the nodes, which know only the files.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from posor.chain.arm_file import ArmFile, load_arm_file
from posor.chain.beams_file import load_beams
from posor.chain.kinematic_chain import Chain
from posor.errors import ParameterError
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor.numerics.vector import thetas_of
from posor_design.arm_allotment import beams_with
from posor_drivers.simulator.arm_truth import true_cycle
from posor_drivers.simulator.beam_heat import beam_heats
from posor_drivers.simulator.electronics import JointElectronics
from posor_drivers.simulator.imperfections import Imperfections
from posor_drivers.simulator.nominal_arm import NominalArm
from posor_drivers.simulator.pose_array import PoseArray
from posor_drivers.simulator.scenario import load_scenario

from posor_lab.accuracy.consistency import REGION_LIMIT, MeanEstimate, normalised_squares
from posor_lab.arm_study.arm_record import pose_array, pose_errors, rms
from posor_lab.arm_study.filter_runs import FALSE_ALARM, spread_evenly, stack_joints
from posor_lab.independent.true_arm import TrueArm
from posor_lab.reports.process_pool import draw_batches

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from posor.chain.beams_file import BeamsFile
    from posor.chain.endpoint_estimator import EndpointEstimator
    from posor.estimation.estimate import Estimates
    from posor.numerics.array_types import BoolArray, FloatArray
    from posor_drivers.simulator.beam_heat import BeamHeat
    from posor_drivers.simulator.scenario import Scenario

ARMS = 1000
POSES = 6
BATCH = 25  # arms per task of a worker
IN_THE_BUDGET = Imperfections.only("noise", "quantisation", "calibration_errors", "beam_errors", "sag")
"""Imperfections that the published covariance includes: noise, quantisation, calibration, beams and their sag."""


@dataclass(frozen=True)
class ArmSample:
    """Errors of a arms at p poses each."""

    normalised: FloatArray  # normalised error squared of the endpoint with its published covariance, (a, p)
    errors: FloatArray  # errors, (a, p, 6), ROS order, axes of the base
    without_sag: FloatArray  # errors without the correction of the sag, (a, p, 6)
    lost: int  # number of poses that a POSOR did not give; NaN above
    # ``normalised`` with shared terms taken as independent in each joint and beam, (a, p); None: no file states terms
    independent: FloatArray | None = None


@dataclass(frozen=True)
class Coverage:
    """Figures of many arms."""

    arms: int  # number of arms
    poses: int  # poses of each arm
    lost: int  # number of poses that a POSOR did not give; they count as outside
    inside: MeanEstimate  # share of the poses inside the published 95 % region
    nees: MeanEstimate  # mean normalised error squared; 6 if the covariance is right
    normalised: FloatArray  # all normalised errors squared, (a p,)
    rms_m: float  # root mean square of the endpoint's position error [m]
    rms_without_sag_m: float  # the same without the correction of the sag
    shift_found_m: FloatArray  # mean displacement that the uncorrected sag leaves, (p, 3), axes of the base
    shift_predicted_m: FloatArray  # prediction of the beams file
    shift_ratio: MeanEstimate  # found over predicted, along the predicted displacement
    inside_independent: MeanEstimate | None = None  # ``inside`` with shared terms taken as independent; None: no terms


def arm_coverage(arm: ArmFile, arms: int, *, on_drawn: Callable[[int], None] = lambda _: None) -> Coverage:
    """Return how published uncertainty and predicted sag hold for many arms with the files of ``arm``.

    The seeds of the arms follow the seed of the scenario, which is that of the live run; the poses are evenly spread
    over the scenario. ``on_drawn`` is called with the number of newly drawn arms; its exception ends the run.

    Raises PosorError: the arm has no scenario or no beams file, or a file is invalid.
    """
    predicted = ArmSampler(arm, POSES).predicted_shift()[:, :3]
    seed = 0 if arm.scenario is None else load_scenario(arm.scenario).seed + 1
    return coverage_figures(sample_arms(arm, arms, POSES, seed, on_drawn=on_drawn), predicted)


def coverage_figures(sample: ArmSample, predicted: FloatArray) -> Coverage:
    """Return the figures of a sample; ``predicted``: displacement by the uncorrected sag [m], (p, 3), axes of base."""
    arms, poses = sample.normalised.shape
    known = np.isfinite(sample.normalised)
    shifts = np.where(known[..., None], sample.without_sag[..., :3], 0.0)
    along = np.einsum("apk,pk->a", shifts, predicted)
    scale = np.einsum("ap,pk,pk->a", known, predicted, predicted)
    seen = scale > 0.0
    return Coverage(
        arms=arms,
        poses=poses,
        lost=sample.lost,
        inside=share_inside(sample.normalised),
        nees=MeanEstimate.of(np.array([np.nanmean(of_arm) for of_arm in sample.normalised[known.any(axis=1)]])),
        normalised=sample.normalised[known],
        rms_m=rms(sample.errors[..., :3].reshape(-1, 3)),
        rms_without_sag_m=rms(sample.without_sag[..., :3].reshape(-1, 3)),
        shift_found_m=shifts.sum(axis=0) / np.maximum(known.sum(axis=0), 1)[:, None],
        shift_predicted_m=predicted,
        shift_ratio=MeanEstimate.of(along[seen] / scale[seen]),
        inside_independent=None if sample.independent is None else share_inside(sample.independent),
    )


def share_inside(normalised: FloatArray) -> MeanEstimate:
    """Return the share of poses inside their 95 % region, of (a, p); NaN, a lost pose, is outside."""
    return MeanEstimate.of(np.mean(np.where(np.isfinite(normalised), normalised, np.inf) <= REGION_LIMIT, axis=1))


class MeasuredArm(NamedTuple):
    """A drawn arm of j joints at p poses, of which n have been measured."""

    known: BoolArray  # which poses, (p,)
    true: PoseArray  # endpoint, n
    poses: FloatArray  # measured, (n, j, 7)
    random: FloatArray  # covariances, (n, j, 6, 6)
    systematic: FloatArray  # (n, j, 6, 6)
    effects: FloatArray  # of shared terms, (n, j, T, 6)
    heats: Mapping[str, BeamHeat]  # of beams at the p poses

    def judge(self, estimator: EndpointEstimator, which: slice = slice(None)) -> tuple[FloatArray, FloatArray]:
        """Return the errors of the endpoint (n, 6) and their normalised squares (n,), of some of the n poses."""
        parts = self.poses[which], self.random[which], self.systematic[which]
        endpoints = estimator.estimate_all(*parts, shared_effects=self.effects[which])
        true = PoseArray(self.true.rotations[which], self.true.translations[which])
        errors = pose_errors(_to_pose_array(endpoints.poses), true)
        return errors, normalised_squares(errors, endpoints.covariances())


class ArmSampler:
    """Draws arms with the files of an arm; a seed determines an arm.

    Attributes:
        scenario: Of the arm.
        ticks: Of the poses, (p,).

    """

    def __init__(self, arm: ArmFile, poses: int) -> None:
        """Read the files and select a number of poses, evenly spread over the scenario.

        Raises PosorError: the arm has no scenario or no beams file, or a file is invalid.
        """
        if arm.scenario is None or arm.beams is None:
            what = "has no scenario or no beams file"
            raise ParameterError(what, where=str(arm.path), expected="a simulated arm with beams")
        self.scenario = load_scenario(arm.scenario)
        self._source = str(arm.scenario)
        self.chain = arm.chain()
        beams = load_beams(arm.beams)
        straight = beams.model_copy(update={"beams": tuple(b.model_copy(update={"sag": None}) for b in beams.beams)})
        urdf = arm.urdf.read_text(encoding="utf-8")
        self.straight = Chain(urdf, arm.endpoint_frame, straight)
        self._independent = Chain(urdf, arm.endpoint_frame, _independent_beams(beams, self.chain))
        self._truth = TrueArm(arm.path)
        self._nominal = NominalArm(self.chain, self._truth)
        self._posors = {joint: Posor(arm.calibration(joint), false_alarm=FALSE_ALARM) for joint in self._nominal.joints}
        self._terms = [tuple(posor.calibration.shared) for posor in self._posors.values()]
        self.ticks = spread_evenly(poses, self.scenario.cycle_ticks)
        self._commanded = self.scenario.commanded_angles(self._nominal, self._source)[self.ticks]

    def draw(self, seeds: range) -> ArmSample:
        """Return the errors of the arms with these seeds."""
        arms, poses = len(seeds), len(self.ticks)
        normalised = np.full((arms, poses), np.nan)
        errors, without_sag = np.full((2, arms, poses, 6), np.nan)
        has_terms = bool(self.chain.shared or any(self._terms))
        independent = np.full((arms, poses), np.nan)
        for n, seed in enumerate(seeds):
            arm = self.measure(self.scenario.model_copy(update={"seed": seed}))
            known = arm.known
            if not known.any():
                continue
            straight = self.straight.estimate_all(arm.poses, arm.random, arm.systematic)
            errors[n, known], normalised[n, known] = arm.judge(self.estimator())
            without_sag[n, known] = pose_errors(_to_pose_array(straight.poses), arm.true)
            if has_terms:
                covariances = self._independent.estimate_all(arm.poses, arm.random, arm.systematic).covariances()
                independent[n, known] = normalised_squares(errors[n, known], covariances)
        lost = int(np.isnan(normalised).sum())
        return ArmSample(normalised, errors, without_sag, lost, independent if has_terms else None)

    def measure(self, scenario: Scenario, imperfections: Imperfections = IN_THE_BUDGET) -> MeasuredArm:
        """Draw the arm of a scenario's seed, and measure its joints at all poses."""
        shares = self.ticks / scenario.cycle_ticks
        heats = beam_heats(scenario, self.chain, shares, imperfections, self._source)
        truth = true_cycle(scenario, self.chain, self._nominal, self._commanded, imperfections, self._truth, heats)
        found = {joint: self._estimate_joint(joint, scenario, seen) for joint, seen in truth.T_parent_child.items()}
        known = np.all([estimates.states != State.LOST for estimates in found.values()], axis=0)
        measured, random, systematic = (each[known] for each in stack_joints(found.values()))
        effects = np.stack([each.shared_effects for each in found.values()], axis=1)[known]
        effects = effects[:, :, : max(map(len, self._terms))]
        return MeasuredArm(known, truth.endpoint.select(known), measured, random, systematic, effects, heats)

    def estimator(self) -> EndpointEstimator:
        """Return a new estimator of the endpoint, with the shared terms of the joints."""
        estimator = self.chain.estimator()
        estimator.use_terms(self._terms)
        return estimator

    def predicted_shift(self) -> FloatArray:
        """Return the endpoint errors by uncorrected sag, (p, 6), that follow from the beams file alone."""
        joints, nominal = [joint.name for joint in self.chain.joints], self.chain.nominal_joint
        rows = [zip(joints, map(float, angles), strict=True) for angles in self._commanded]
        poses = np.array([[pin.SE3ToXYZQUAT(nominal(joint, angle)) for joint, angle in row] for row in rows])
        exact = np.zeros((*poses.shape[:2], 6, 6))
        straight, sagging = (
            _to_pose_array(chain.estimate_all(poses, exact, exact).poses) for chain in (self.straight, self.chain)
        )
        return pose_errors(straight, sagging)

    def _estimate_joint(self, joint: str, scenario: Scenario, seen: PoseArray) -> Estimates:
        """Return the estimates of a joint's noisy scans at true poses; theta is taken from the counting ring."""
        posor = self._posors[joint]
        electronics = JointElectronics(scenario, joint, posor.calibration, IN_THE_BUDGET, self._source, self._truth)
        thetas = thetas_of(seen.rotations)
        return posor.estimate_each(electronics.scans(self.ticks, lambda _: seen).scans, thetas)


def _independent_beams(beams: BeamsFile, chain: Chain) -> BeamsFile:
    """Return the beams with their parts of shared terms as uncertainties of their own."""
    variances = {
        beam.name: np.diagonal(beam.covariance) + sum(np.square(each) for each in beam.shared_effects.values())
        for beam in chain.beams
    }
    return beams_with(beams, variances).model_copy(update={"shared": {}})


def _to_pose_array(poses: FloatArray) -> PoseArray:
    """Return poses x, y, z and quaternion x, y, z, w, (n, 7), as rotations and translations."""
    return pose_array([pin.XYZQUATToSE3(pose) for pose in poses])


def _sampler(path: Path, poses: int) -> ArmSampler:
    return ArmSampler(load_arm_file(path), poses)


def sample_arms(
    arm: ArmFile,
    arms: int,
    poses: int,
    seed: int,
    *,
    workers: int = 0,
    on_drawn: Callable[[int], None] = lambda _: None,
) -> ArmSample:
    """Draw many arms, with seeds from ``seed`` on, in several processes; the result does not depend on their number.

    ``workers`` of 0: one for each processor; ``on_drawn`` as in ``arm_coverage``.
    """
    sampler, seeds = partial(_sampler, arm.path, poses), range(seed, seed + arms)
    parts = draw_batches(sampler, ArmSampler.draw, seeds, BATCH, workers, lambda part: on_drawn(len(part.normalised)))

    def join(name: str) -> FloatArray:
        return np.concatenate([getattr(part, name) for part in parts])

    independent = None if parts[0].independent is None else join("independent")
    lost = sum(part.lost for part in parts)
    return ArmSample(join("normalised"), join("errors"), join("without_sag"), lost, independent)
