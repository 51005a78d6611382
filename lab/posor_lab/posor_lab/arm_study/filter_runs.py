# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Runs of simulated arms at rest and in slow motion, for filters of the endpoint. No ROS.

Each arm is drawn within the uncertainties of its files: the parameters and the environment of its POSORs, its measuring
beams and their sag. Every scan has new noise. Estimators and chain know only the files.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.errors import ParameterError
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor.numerics.stamps import tick_stamp_ns
from posor.numerics.vector import thetas_of
from posor_drivers.simulator.arm_truth import true_cycle
from posor_drivers.simulator.imperfections import Imperfections
from posor_drivers.simulator.nominal_arm import NominalArm
from posor_drivers.simulator.scenario import load_scenario

from posor_lab.accuracy.consistency import DrawnPosors
from posor_lab.independent.true_arm import TrueArm

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from posor.chain.arm_file import ArmFile
    from posor.chain.forward_kinematics import Endpoints
    from posor.estimation.estimate import Estimates
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray, IntArray
    from posor_drivers.simulator.pose_array import PoseArray

RATE = 200  # scans per second
JOINT_RATE = 0.01  # of every joint in motion [rad/s]; neighbours turn against each other
LEAD_S = 1.0  # motion before the first scan of a run, which takes up the backlash of the gears
THETA_SIGMA = 1e-5  # of the reference that counts each ring before a run [rad]
FALSE_ALARM = 1e-9  # of the chi-square test, so that noise is not taken for a fault: that would trim the errors
DRAWN = Imperfections.only("beam_errors", "sag")


@dataclass(frozen=True)
class FilterRun:
    """Consecutive scans of one drawn arm."""

    in_motion: bool  # every joint turns at JOINT_RATE; otherwise the arm is at rest
    times_s: FloatArray  # of the scans, (n,)
    endpoints: Endpoints  # of the scans, by the product
    truth: FloatArray  # position of the endpoint in the base [m], (n, 3)


def filter_runs(arm: ArmFile, arms: int, poses: int, scans: int) -> Iterator[FilterRun]:
    """Yield the runs of ``arms`` drawn arms: at each of ``poses`` poses of the scenario one at rest, one in motion.

    ``scans``: of each run; the seeds of the arms count from 0. Raises ParameterError: the arm has no scenario, or a
    POSOR cannot measure a pose.
    """
    if arm.scenario is None:
        raise ParameterError("has no scenario", where=str(arm.path), expected="a simulated arm")
    scenario, chain = load_scenario(arm.scenario), arm.chain()
    geometry = TrueArm(arm.path)
    nominal = NominalArm(chain, geometry)
    posors = {joint: Posor(arm.calibration(joint), false_alarm=FALSE_ALARM) for joint in nominal.joints}
    cycle = scenario.commanded_angles(nominal, str(arm.scenario))
    starts = cycle[spread_evenly(poses, len(cycle))]
    times_s, signs = np.arange(scans) / RATE, np.resize([1.0, -1.0], len(nominal.joints))
    turned = JOINT_RATE * (times_s[:, None] + LEAD_S) * signs
    commanded = np.concatenate([start + moves * turned for start in starts for moves in (0.0, 1.0)])
    stamps_ns = tick_stamp_ns(np.arange(len(commanded)), RATE)
    for own_seed in range(arms):
        drawn, random = scenario.model_copy(update={"seed": own_seed}), np.random.default_rng(own_seed)
        truth = true_cycle(drawn, chain, nominal, commanded, DRAWN, geometry)
        readings = {
            joint: noisy_scans(posor, truth.T_parent_child[joint], stamps_ns, random) for joint, posor in posors.items()
        }
        for n in range(2 * poses):
            part = slice(n * scans, (n + 1) * scans)
            found = []
            for joint, posor in posors.items():
                first = truth.T_parent_child[joint].rotations[part.start]
                found.append(estimate_run(posor, readings[joint].select(part), first))
                if (found[-1].states != State.OK).any():
                    raise ParameterError("a scan is not OK", where=f"{joint} of drawn arm {own_seed}", expected="OK")
            endpoints = chain.estimate_all(*stack_joints(found))
            yield FilterRun(n % 2 == 1, times_s, endpoints, truth.endpoint.translations[part])


def spread_evenly(count: int, total: int) -> IntArray:
    """Return ``count`` indices below ``total`` in equal distances, half a distance from both ends."""
    return (np.arange(count) * total) // count + total // (2 * count)


def noisy_scans(posor: Posor, seen: PoseArray, stamps_ns: IntArray, random: np.random.Generator) -> Scans:
    """Return scans of a POSOR drawn within its calibration, at poses of its target plate."""
    rotations, translations = np.ascontiguousarray(seen.rotations), np.ascontiguousarray(seen.translations)
    scans = DrawnPosors(posor, random).scans(rotations, translations, random)
    return scans.with_fields({"stamps_ns": stamps_ns})


def estimate_run(posor: Posor, scans: Scans, rotation: FloatArray, sigma: float = THETA_SIGMA) -> Estimates:
    """Return the estimates of consecutive scans; the true ``rotation`` (3, 3) of the first counts the ring."""
    posor.reset()
    posor.confirm_theta(float(thetas_of(rotation[None])[0]), sigma)
    return posor.estimate_all(scans)


def stack_joints(found: Collection[Estimates]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return poses (n, j, 7), random and systematic covariances (n, j, 6, 6) of the estimates of an arm's j joints."""
    fields = ("poses", "covariances_random", "covariances_systematic")
    poses, random, systematic = (np.stack([getattr(each, name) for each in found], axis=1) for name in fields)
    return poses, random, systematic
