# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Endpoints predicted between the scans of simulated arms, compared with the independent truth. No ROS.

Each arm is drawn within the uncertainties of its files. Its encoders are read at 1 kHz, with steps and behind backlash;
every fifth tick has a scan, whose transforms arrive 3 ms later. Estimators, chain and prediction know only the files.
"""

from __future__ import annotations

from time import perf_counter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.bags.recording import unpack_poses
from posor.chain.arm_file import chain_parameters, load_arm_file
from posor.chain.endpoint_predictor import EndpointPredictor
from posor.errors import ParameterError
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor.node_parameters import EncodersParameters
from posor.numerics.stamps import NS, tick_stamp_ns
from posor_drivers.simulator.arm_truth import true_cycle
from posor_drivers.simulator.nominal_arm import NominalArm
from posor_drivers.simulator.scenario import load_scenario

from posor_lab.accuracy.consistency import normalised_squares
from posor_lab.arm_study.filter_runs import DRAWN, FALSE_ALARM, estimate_run, noisy_scans, spread_evenly, stack_joints
from posor_lab.arm_study.recorded_prediction import PredictedEndpoints, RecordedTransforms, predict_recorded
from posor_lab.harness.random_poses import errors_in_parent
from posor_lab.independent.true_arm import TrueArm

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from posor.chain.forward_kinematics import Endpoints
    from posor.model.scan import Scans
    from posor.numerics.array_types import BoolArray, FloatArray
    from posor_drivers.simulator.pose_array import ArmTruth, PoseArray

RATE, TICKS_PER_SCAN, LATENCY_TICKS = 1000, 5, 3  # readings per second; readings per scan; until a transform arrives
LEAD_S = 0.01
GAP_S, GAP_PERIOD_S = 0.05, 0.25  # of one joint after the other
REST_S, REST_POSES = 0.3, 6
SETTLED_S = 0.1  # after the first reading, from which the errors count
READINGS = 5000  # whose time is measured
IN_MOTION = DRAWN.model_copy(update={"inertia": True})
SCANS, BETWEEN, AHEAD, GAPS = "at scans", "between scans", "10 ms ahead", "one joint missing for 50 ms"


class Sample(NamedTuple):
    """Errors of the endpoint of one drawn arm."""

    errors: FloatArray  # of the position [m], (n, 3), axes of the base
    squares: FloatArray  # normalised errors squared of the pose with the published covariance, (n,)


class SimulatedRun(NamedTuple):
    """One motion of a drawn arm."""

    angles: FloatArray  # readings of the encoders at all ticks [rad], (n, j)
    transforms: RecordedTransforms
    scans: Endpoints  # published at the scans
    truth: PoseArray  # endpoint at all ticks


class PredictionTruth:
    """Draws arms with the files of an arm; a seed determines an arm."""

    def __init__(self, path: Path, seconds: float = 0.0) -> None:
        """Read the files of an arm; ``seconds``: part of the scenario that is run; 0: all of it.

        Raises PosorError: a file is invalid, or the arm has no scenario.
        """
        self._arm = load_arm_file(path)
        if self._arm.scenario is None:
            raise ParameterError("has no scenario", where=str(path), expected="a simulated arm")
        self._scenario, self._chain = load_scenario(self._arm.scenario).at_rate(RATE), self._arm.chain()
        self._truth, self._source = TrueArm(self._arm.path), str(self._arm.scenario)
        self._nominal = NominalArm(self._chain, self._truth)
        self._posors = {
            name: Posor(self._arm.calibration(name), false_alarm=FALSE_ALARM) for name in self._nominal.joints
        }
        self._terms = [tuple(posor.calibration.shared) for posor in self._posors.values()]
        self._most_terms = max(map(len, self._terms))
        self._commanded = self._scenario.commanded_angles(self._nominal, self._source)
        self._ticks = round(seconds * RATE) or len(self._commanded)
        self._window = float(chain_parameters(self._arm).get("acceleration_window", 0.0))  # type: ignore[arg-type]
        joints = [self._scenario.joints[name] for name in self._nominal.joints]
        self.parameters = EncodersParameters(
            topic="encoders",
            sigma=tuple(each.encoder.resolution.number / 12.0**0.5 for each in joints if each.encoder is not None),
            backlash=tuple(each.gear.backlash.number for each in joints if each.gear is not None),
            slope=0.0,
            lead_time=LEAD_S,
        )

    def runs(self, seed: int, *, at_rest: bool) -> list[SimulatedRun]:
        """Return the runs of a drawn arm: its scenario, or one at each of several poses of it."""
        commanded, ticks = self._commanded, self._ticks
        if at_rest:
            ticks = round(REST_S * RATE)
            commanded = np.repeat(commanded[spread_evenly(REST_POSES, len(commanded))], ticks, axis=0)
        imperfections = DRAWN if at_rest else IN_MOTION
        scenario, random = self._scenario.model_copy(update={"seed": seed}), np.random.default_rng([seed, at_rest])
        truth = true_cycle(scenario, self._chain, self._nominal, commanded, imperfections, self._truth)
        truth = truth.select(np.arange(len(commanded) if at_rest else ticks))
        at_scans = np.arange(0, len(truth.encoder), TICKS_PER_SCAN)
        stamps_ns, seen = tick_stamp_ns(at_scans, RATE) + NS, truth.select(at_scans)
        readings = {
            name: noisy_scans(posor, seen.T_parent_child[name], stamps_ns, random)
            for name, posor in self._posors.items()
        }
        parts = [slice(n, n + ticks // TICKS_PER_SCAN) for n in range(0, len(at_scans), ticks // TICKS_PER_SCAN)]
        return [self._run(seen, readings, truth, part) for part in parts]

    def _run(self, seen: ArmTruth, readings: Mapping[str, Scans], truth: ArmTruth, part: slice) -> SimulatedRun:
        """Estimate a part of the scans, and of the readings of the encoders at all ticks."""
        found = []
        for name, posor in self._posors.items():
            first = seen.T_parent_child[name].rotations[part.start]
            found.append(estimate_run(posor, readings[name].select(part), first))
        poses, random, systematic = stack_joints(found)
        shared = np.stack([each.shared_effects for each in found], axis=1)[:, :, : self._most_terms]
        usable = np.stack([each.states == State.OK for each in found], axis=1)
        stamps_ns = found[0].stamps_ns
        arrivals_ns = stamps_ns + LATENCY_TICKS * NS // RATE
        transforms = RecordedTransforms(stamps_ns, arrivals_ns, poses, random, systematic, shared, usable)
        estimator = self._chain.estimator(self._window)
        estimator.use_terms(self._terms)
        scans = estimator.estimate_all(poses, random, systematic, stamps_ns, shared_effects=shared)
        ticks = np.arange(TICKS_PER_SCAN * part.start, min(TICKS_PER_SCAN * part.stop, len(truth.encoder)))
        return SimulatedRun(truth.encoder[ticks], transforms, scans, truth.endpoint.select(ticks))

    def predict(self, run: SimulatedRun, *, with_gaps: bool = False) -> PredictedEndpoints:
        """Return the predicted endpoints of a run; ``with_gaps``: one joint after the other is missing for a while."""
        transforms = run.transforms
        if with_gaps:
            transforms = transforms._replace(usable=transforms.usable & ~missing_transforms(transforms))
        first_ns = int(transforms.stamps_ns[0])
        stamps_ns = first_ns + np.arange(len(run.angles)) * (NS // RATE)
        return predict_recorded(
            self._chain, self.parameters, stamps_ns, run.angles, transforms, self._terms, self._window
        )

    def samples(self, seed: int) -> dict[tuple[str, bool], Sample]:
        """Return the errors of a drawn arm by case, and by whether it is at rest."""
        found: dict[tuple[str, bool], Sample] = {}
        for at_rest in (False, True):
            parts: dict[str, list[Sample]] = {}
            for run in self.runs(seed, at_rest=at_rest):
                for case, sample in self._of_run(run).items():
                    parts.setdefault(case, []).append(sample)
            for case, each in parts.items():
                found[case, at_rest] = Sample(*map(np.concatenate, zip(*each, strict=True)))
        return found

    def _of_run(self, run: SimulatedRun) -> dict[str, Sample]:
        ticks = np.arange(len(run.angles))
        settled, lead = ticks >= SETTLED_S * RATE, round(LEAD_S * RATE)
        is_scan = ticks % TICKS_PER_SCAN == 0
        plain, gaps = (self.predict(run, with_gaps=with_gaps) for with_gaps in (False, True))
        missing = np.any(missing_transforms(run.transforms)[ticks // TICKS_PER_SCAN], axis=1)
        at_scans = np.flatnonzero(settled & is_scan)
        scans = run.scans.poses[at_scans // TICKS_PER_SCAN], run.scans.covariances()[at_scans // TICKS_PER_SCAN]
        between, ahead, held = (
            np.flatnonzero(settled & which) for which in (~is_scan, ticks < len(ticks) - lead, missing)
        )
        return {
            SCANS: _sample(*scans, run.truth.select(at_scans)),
            BETWEEN: _sample(plain.poses[between], plain.covariances[between], run.truth.select(between)),
            AHEAD: _sample(plain.ahead[ahead], plain.ahead_covariances[ahead], run.truth.select(ahead + lead)),
            GAPS: _sample(gaps.poses[held], gaps.covariances[held], run.truth.select(held)),
        }

    def reading_cost(self) -> float:
        """Return the median time of a reading of all encoders with both predictions [s]."""
        run = self.runs(0, at_rest=True)[0]
        predictor, times = EndpointPredictor(self._chain, self.parameters), np.empty(READINGS)
        transforms = run.transforms
        for n in range(READINGS):
            stamp_ns = int(transforms.stamps_ns[0]) + n * NS // RATE
            if n % TICKS_PER_SCAN == 1:
                predictor.measurements.poses[0] = transforms.poses[0]
                predictor.measurements.covariances_random[0] = transforms.covariances_random[0]
                predictor.measurements.covariances_systematic[0] = transforms.covariances_systematic[0]
                for joint in range(len(predictor.joints)):
                    predictor.use_transform(joint, stamp_ns - NS // RATE)
            begin = perf_counter()
            usable = predictor.read(stamp_ns, run.angles[0])
            times[n] = perf_counter() - begin
        if not usable:
            raise ParameterError("is not predicted", where="the endpoint of an arm at rest", expected="a pose")
        return float(np.median(times))


def missing_transforms(transforms: RecordedTransforms) -> BoolArray:
    """Return which transforms are left out, (n, j): one joint after the other for ``GAP_S`` in ``GAP_PERIOD_S``."""
    seconds = (transforms.stamps_ns - transforms.stamps_ns[0]) / NS
    number, since = np.divmod(seconds, GAP_PERIOD_S)
    joints = transforms.usable.shape[1]
    in_gap = (since >= GAP_PERIOD_S - GAP_S)[:, None]
    missing: BoolArray = in_gap & (number[:, None] % joints == np.arange(joints))
    return missing


def _sample(poses: FloatArray, covariances: FloatArray, true: PoseArray) -> Sample:
    """Return the errors of poses (n, 7); where there is none they are infinite."""
    known = np.isfinite(poses[:, 0])
    errors, squares = np.full((len(poses), 3), np.inf), np.full(len(poses), np.inf)
    own = true.select(known)
    found = errors_in_parent(*unpack_poses(poses[known]), own.rotations, own.translations)
    errors[known], squares[known] = found[:, :3], normalised_squares(found, covariances[known])
    return Sample(errors, squares)
