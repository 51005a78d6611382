# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A simulated robot that carries the POSORs of an arm and follows any joint angles, with errors of its own. No ROS.

Its links, joint zeros, gears, bearings and bending are not those that its controller knows. Plates, beams, sag and
readings of the POSORs are those of the independent truth; the product's estimators know only the files.
"""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from posor.errors import ParameterError
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor_drivers.simulator.arm_truth import true_cycle
from posor_drivers.simulator.electronics import JointElectronics
from posor_drivers.simulator.imperfections import Imperfections, RandomStream
from posor_drivers.simulator.mechanics import quantise_encoder
from posor_drivers.simulator.nominal_arm import NominalArm
from posor_drivers.simulator.scenario import load_scenario

from posor_lab.arm_study.filter_runs import FALSE_ALARM, estimate_run, stack_joints
from posor_lab.independent.true_arm import TrueArm

if TYPE_CHECKING:
    from posor.chain.arm_file import ArmFile
    from posor.estimation.estimate import Estimates
    from posor.numerics.array_types import FloatArray, IntArray
    from posor_drivers.simulator.pose_array import PoseArray

LINK_SIGMA, ZERO_SIGMA = 1e-4, 2e-4  # standard deviations of lengths of links [m] and of joint zeros [rad]
MEASURED = Imperfections.only("noise", "quantisation", "calibration_errors", "beam_errors", "sag")


class Motion(NamedTuple):
    """What n ticks of a motion were."""

    true: FloatArray  # position of the endpoint in the base [m], (n, 3)
    poses: FloatArray  # endpoint by the POSORs, (n, 7); NaN: a POSOR had no pose
    encoders: FloatArray  # angles by the encoders of the motors [rad], (n, j)


class SimulatedRobot:
    """One drawn robot.

    Attributes:
        chain: The arm as its files describe it.
        rate: Scans and commands in a second.
        planned: Angles of the scenario's motion [rad], (n, j).
        targets: Endpoint that they mean by the nominal robot [m], (n, 3).

    """

    def __init__(self, arm: ArmFile, rate: int, seed: int) -> None:
        """Draw the robot of a seed. Raises PosorError: a file is invalid, or the arm is not simulated."""
        if arm.scenario is None:
            raise ParameterError("has no scenario", where=str(arm.path), expected="a simulated arm")
        self.rate, self._source = rate, str(arm.scenario)
        scenario = load_scenario(arm.scenario).at_rate(rate).model_copy(update={"seed": seed})
        self._gears = [scenario.joints[name] for name in scenario.joints]
        self.chain, self._truth = arm.chain(), TrueArm(arm.path)
        nominal = NominalArm(self.chain, self._truth)
        self.planned = scenario.commanded_angles(nominal, self._source)
        self.targets = nominal.endpoint(self.planned).translations
        self._gears = [scenario.joints[name] for name in nominal.joints]
        self._backlash = np.array([0.0 if each.gear is None else each.gear.backlash.number for each in self._gears])
        # ``move`` has its own gears, whose state lasts from motion to motion.
        joints = {name: joint.model_copy(update={"gear": None}) for name, joint in scenario.joints.items()}
        self._scenario = scenario.model_copy(update={"joints": joints})
        random = RandomStream(seed, "robot").generator()
        self._zeros = ZERO_SIGMA * random.normal(size=len(nominal.joints))
        self._robot = copy(nominal)
        self._robot.links = tuple(
            pin.SE3(link.rotation, link.translation * (1.0 + LINK_SIGMA * random.normal() / _length(link)))
            for link in nominal.links
        )
        self._posors = {name: Posor(arm.calibration(name), false_alarm=FALSE_ALARM) for name in nominal.joints}
        self._electronics = {
            name: JointElectronics(self._scenario, name, posor.calibration, MEASURED, self._source, self._truth)
            for name, posor in self._posors.items()
        }
        self.restart()

    def restart(self) -> None:
        """Go to the begin of the planned motion; the gears are in the middle of their backlash."""
        self._output = self.planned[0].copy()
        self._tick = 0

    def move(self, commanded: FloatArray) -> Motion:
        """Follow commanded angles at the next ticks, (n, j) [rad]."""
        ticks = np.arange(self._tick, self._tick + len(commanded))
        self._tick += len(commanded)
        output, half = np.empty_like(commanded), 0.5 * self._backlash
        for n, motors in enumerate(commanded):  # a joint stands still until its motor has crossed the backlash
            self._output = np.clip(self._output, motors - half, motors + half)
            output[n] = self._output
        truth = true_cycle(self._scenario, self.chain, self._robot, output + self._zeros, MEASURED, self._truth)
        found = [self._estimate(name, ticks, seen) for name, seen in truth.T_parent_child.items()]
        known = np.all([each.states != State.LOST for each in found], axis=0)
        poses = np.full((len(commanded), 7), np.nan)
        measured, random, systematic = (each[known] for each in stack_joints(found))
        poses[known] = self.chain.estimate_all(measured, random, systematic).poses
        return Motion(truth.endpoint.translations, poses, self._read_encoders(commanded))

    def _read_encoders(self, commanded: FloatArray) -> FloatArray:
        columns = zip(self._gears, commanded.T, strict=True)
        return np.column_stack(
            [each if j.encoder is None else quantise_encoder(each, j.encoder.resolution.number) for j, each in columns]
        )

    def _estimate(self, joint: str, ticks: IntArray, seen: PoseArray) -> Estimates:
        posor, scans = self._posors[joint], self._electronics[joint].scans(ticks, lambda _: seen).scans
        return estimate_run(posor, scans, seen.rotations[0]) if ticks[0] == 0 else posor.estimate_all(scans)


def _length(link: pin.SE3) -> float:
    return max(float(np.linalg.norm(link.translation)), 1e-3)
