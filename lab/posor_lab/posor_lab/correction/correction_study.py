# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of a simulated robot on its path: uncorrected, with corrected programs, and in an outer loop. No ROS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from posor.correction.joint_correction import CorrectionLimits, JointCorrection
from posor.correction.joint_path import JointPath
from posor.correction.nominal_robot import LeastSquares, NominalRobot
from posor.correction.program_correction import MeasuredRun, correct_path

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

    from posor_lab.correction.simulated_robot import Motion, SimulatedRobot

REVERSAL_S = 0.05  # time on either side of a reversal that belongs to it
ROUNDING = 1e-12  # of angles [rad]
JUMP_M = 0.01  # of a measured endpoint that is refused for its size
MOVES = 1e-4  # rate at which a joint moves [rad/s]
POSITION_FIRST = LeastSquares(rotation_length=0.01)  # of five joints, which cannot correct six errors
LEAST_LEVER = 0.1  # by which the joints must move the endpoint in every direction, where a correction is judged [m]


class PathErrors(NamedTuple):
    """Errors of the endpoint's position on a path."""

    rms_m: float  # where the joints can move the endpoint in every direction
    peak_m: float  # largest at a reversal of a joint
    whole_rms_m: float  # of the whole path, with the ends where the arm is stretched


def near_reversals(angles: FloatArray, rate: int) -> BoolArray:
    """Return which rows of planned angles (n, j) are near a change of a joint's direction, (n,)."""
    moves: FloatArray = np.asarray(np.gradient(angles, axis=0)) * rate
    found = np.zeros(len(angles), dtype=bool)
    for column in moves.T:
        moving: IntArray = np.flatnonzero(np.abs(column) > MOVES)
        turns = np.flatnonzero(np.diff(np.sign(column[moving])))
        for first, last in zip(moving[turns].tolist(), moving[turns + 1].tolist(), strict=True):
            found[max(0, first - round(REVERSAL_S * rate)) : last + round(REVERSAL_S * rate) + 1] = True
    return found


@dataclass(frozen=True)
class LoopRun:
    """A path in the outer loop."""

    errors: PathErrors
    offsets: FloatArray  # commanded [rad], (n, j)
    stopped: tuple[str, ...]  # why the correction stands still, at each row


class CorrectionStudy:
    """One robot and its nominal model; every run begins at the begin of the path."""

    def __init__(self, robot: SimulatedRobot, rows: int | None = None) -> None:
        """Use the first rows of the robot's planned motion, by default all."""
        self.robot, self.nominal = robot, NominalRobot(robot.chain, POSITION_FIRST)
        self.planned, self._targets = robot.planned[:rows], robot.targets[:rows]
        self.times_s = np.arange(len(self.planned)) / robot.rate
        levers = [np.linalg.svd(self.nominal.jacobian(q)[:3], compute_uv=False)[-1] for q in self.planned]
        self._judged: BoolArray = np.array(levers) >= LEAST_LEVER
        self._reversals = near_reversals(self.planned, robot.rate) & self._judged

    def judge(self, true: FloatArray) -> PathErrors:
        """Return the errors of true positions when the robot executes each planned row [m], (n, 3)."""
        lengths = np.linalg.norm(true - self._targets, axis=1)
        rms, whole = (float(np.sqrt(np.mean(np.square(each)))) for each in (lengths[self._judged], lengths))
        return PathErrors(rms, float(lengths[self._reversals].max(initial=0.0)), whole)

    def run(self, commanded: FloatArray) -> tuple[PathErrors, Motion]:
        """Return the errors on commanded angles (n, j), and the motion."""
        self.robot.restart()
        motion = self.robot.move(commanded)
        return self.judge(motion.true), motion

    def corrected(self, runs: int, limits: CorrectionLimits, smoothing_s: float) -> list[PathErrors]:
        """Return the errors of the planned path and, run after run, of the program that the run before corrects."""
        path = JointPath(self.nominal.joints, self.times_s, self.planned)
        errors, motion = self.run(self.planned)
        found = [errors]
        for _ in range(runs):
            measured = MeasuredRun(self.times_s, motion.encoders, motion.poses)
            errors, motion = self.run(correct_path(path, measured, self.nominal, limits, smoothing_s).angles)
            found.append(errors)
        return found

    def loop(
        self,
        dead_time_s: float,
        limits: CorrectionLimits,
        *,
        assumed_s: float | None = None,
        change: Callable[[int, Motion], Motion] = lambda _, motion: motion,
    ) -> LoopRun:
        """Run the path in the outer loop.

        The robot executes a command ``dead_time_s`` later, and a scan is known one tick after its exposure.
        ``assumed_s``: no encoders are read; the controller takes this dead time for that of the robot. ``change``:
        changes what is measured from a tick on, as a failure does.
        """
        robot, rate, count = self.robot, self.robot.rate, len(self.planned)
        dead, assumed = round(dead_time_s * rate), round((assumed_s or 0.0) * rate)
        law = JointCorrection(self.nominal, limits)
        law.start(0.0)
        robot.restart()
        executed = np.vstack([np.repeat(self.planned[:1], dead, axis=0), self.planned])  # at each tick
        true, stopped = [], [""]
        # A command acts after the dead time, so the motion of a block of this length depends on earlier commands only.
        for begin in range(0, len(executed), dead):
            motion = change(begin, robot.move(executed[begin : begin + dead]))
            for tick, pose, encoders in zip(range(begin, len(executed)), motion.poses, motion.encoders, strict=False):
                if np.isfinite(pose[0]):
                    angles = encoders if assumed_s is None else executed[max(0, tick + dead - assumed)]
                    law.add_endpoint((tick + 1) / rate, angles, pin.XYZQUATToSE3(pose))
                if tick + 1 < count:
                    executed[tick + 1 + dead] += law.step((tick + 1) / rate, 1.0 / rate)
                    stopped.append(law.stopped)
            true.append(motion.true)
        return LoopRun(self.judge(np.vstack(true)[dead:]), executed[dead:] - self.planned, tuple(stopped))


def failures(tick: int) -> dict[str, Callable[[int, Motion], Motion]]:
    """Return what fails from a tick on, for ``CorrectionStudy.loop``."""

    def lose(begin: int, motion: Motion) -> Motion:
        poses = motion.poses.copy()
        poses[max(0, tick - begin) :] = np.nan
        return motion._replace(poses=poses)

    frozen: list[FloatArray] = []

    def freeze(begin: int, motion: Motion) -> Motion:
        encoders = motion.encoders.copy()
        first = max(0, tick - begin)
        if first < len(encoders):
            frozen.append(encoders[first])
            encoders[first:, 0] = frozen[0][0]
        return motion._replace(encoders=encoders)

    def jump(begin: int, motion: Motion) -> Motion:
        poses = motion.poses.copy()
        poses[max(0, tick - begin) :, 1] += JUMP_M
        return motion._replace(poses=poses)

    return {"joint lost or node killed": lose, "encoder frozen": freeze, f"endpoint moved by {JUMP_M:g} m": jump}


def stop_after(run: LoopRun, tick: int, rate: int) -> float:
    """Return the time from a failure to the stop, after which no offset changes [s]; infinite: there is no stop."""
    changes = np.flatnonzero(np.any(np.abs(np.diff(run.offsets, axis=0)) > ROUNDING, axis=1)) + 1
    first = next((n for n, reason in enumerate(run.stopped) if reason), None)
    return np.inf if first is None else (max(first, int(changes[-1])) - tick) / rate
