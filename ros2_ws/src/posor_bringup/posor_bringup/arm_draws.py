"""Draws many arms that differ from what their files say by as much as the files admit. No ROS.

Each arm is drawn anew: every parameter of its POSORs and of its measuring beams, their sag, its bearings, the noise of
every reading, all as uncertain as the arm's files say. At several poses of the scenario's path its raw scans go through
the estimators and the chain, as they would in the nodes; both know only the files.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor_drivers.simulator.electronics import Electronics
from posor_drivers.simulator.nominal import NominalArm
from posor_drivers.simulator.scenario import load_scenario
from posor_drivers.simulator.structure import true_cycle
from posor_drivers.simulator.switches import Switches
from posor_drivers.simulator.trajectory import commanded_angles
from posor_estimator.accuracy.consistency import normalised_squares
from posor_estimator.accuracy.poses import errors_in_parent
from posor_estimator.core.arm import Arm, load_arm
from posor_estimator.core.beams_file import load_beams
from posor_estimator.core.chain import Chain, MeasuredJoint
from posor_estimator.core.fault import State
from posor_estimator.core.posor import Posor
from posor_estimator.errors import ParameterError

from posor_bringup.arm_record import poses_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import pinocchio as pin
    from posor_drivers.simulator.poses import Poses
    from posor_estimator.core.estimate import Estimates
    from posor_estimator.core.types import FloatArray

BATCH = 25
"""Arms that a worker draws in one go."""
IN_THE_BUDGET = Switches(zero_drift=False, supply_drift=False, contamination=False, dropouts=False, latency=False)
"""What the published covariance accounts for: noise, quantisation, calibration, beams and their sag."""
FALSE_ALARM = 1e-9
"""So that no scan is left out because its noise looks like a fault: that would trim the errors."""


@dataclass(frozen=True)
class Draws:
    """a arms at p poses each.

    Attributes:
        normalised: Endpoint's error squared, normalised with its published covariance, (a, p).
        errors: The error, (a, p, 6), ROS order, axes of the base.
        without_sag: The same where the chain does not correct the sag, (a, p, 6).
        lost: Poses that a POSOR did not give, left out as NaN above.

    """

    normalised: FloatArray
    errors: FloatArray
    without_sag: FloatArray
    lost: int

    @staticmethod
    def joined(parts: list[Draws]) -> Draws:
        """Return the draws of several workers as one."""
        return Draws(
            np.concatenate([part.normalised for part in parts]),
            np.concatenate([part.errors for part in parts]),
            np.concatenate([part.without_sag for part in parts]),
            sum(part.lost for part in parts),
        )


class ArmDrawer:
    """Draws arms of an arm file; the seed tells the arm."""

    def __init__(self, arm: Arm, poses: int) -> None:
        """Read the files and choose the poses.

        Args:
            arm: The arm; it has a scenario.
            poses: How many poses of the path, evenly spread over its duration.

        Raises:
            ParameterError: The arm has no scenario or no beams file.
            PosorError: A file cannot be used.

        """
        if arm.scenario is None or arm.beams is None:
            raise ParameterError(
                "has no scenario or no beams file", where=str(arm.path), expected="a simulated arm with beams"
            )
        self._scenario = load_scenario(arm.scenario)
        self._source = str(arm.scenario)
        self.chain = arm.chain()
        beams = load_beams(arm.beams)
        straight = beams.model_copy(update={"beams": tuple(b.model_copy(update={"sag": None}) for b in beams.beams)})
        self.straight = Chain(arm.urdf.read_text(encoding="utf-8"), arm.endpoint_frame, straight)
        self._nominal = NominalArm(self.chain)
        self._posors = {joint: Posor(arm.calibration(joint), false_alarm=FALSE_ALARM) for joint in self._nominal.joints}
        cycle = self._scenario.cycle_ticks
        self._ticks = (np.arange(poses) * cycle) // poses + cycle // (2 * poses)
        self._commanded = commanded_angles(self._scenario, self._nominal, self._source)[self._ticks]

    def draw(self, seeds: range) -> Draws:
        """Return what becomes of the arms with these seeds."""
        arms, poses = len(seeds), len(self._ticks)
        normalised = np.full((arms, poses), np.nan)
        errors, without_sag = np.full((2, arms, poses, 6), np.nan)
        for n, seed in enumerate(seeds):
            scenario = self._scenario.model_copy(update={"seed": seed})
            truth = true_cycle(
                scenario, self.chain, self._nominal, self._commanded, beam_errors=True, sag=IN_THE_BUDGET.sag
            )
            found = {}
            for joint, seen in zip(self._nominal.joints, truth.T_parent_child, strict=True):
                posor = self._posors[joint]
                electronics = Electronics(scenario, joint, posor.calibration, IN_THE_BUDGET, self._source)
                scans = electronics.scans(self._ticks, seen).scans
                found[joint] = posor.locate_each(scans, _thetas(seen))
            known = np.array(
                [all(estimates.states[i] != State.LOST for estimates in found.values()) for i in range(poses)]
            )
            if not known.any():
                continue
            measured = [_measured(found, i) for i in range(poses) if known[i]]
            sound = [self.chain.endpoint(joints) for joints in measured]
            straight = [self.straight.endpoint(joints) for joints in measured]
            true = truth.endpoint.at(known)
            errors[n, known] = _errors([pose.T_base_endpoint for pose in sound], true)
            without_sag[n, known] = _errors([pose.T_base_endpoint for pose in straight], true)
            covariances = np.array([pose.covariance for pose in sound])
            normalised[n, known] = normalised_squares(errors[n, known], covariances)
        return Draws(normalised, errors, without_sag, int(np.isnan(normalised).sum()))

    def predicted_shift(self) -> FloatArray:
        """Return by how much the endpoint is off if the sag is not corrected, (p, 6), from the beams file alone."""
        joints = [joint.name for joint in self.chain.joints]
        none = np.zeros((6, 6))
        shifts = []
        for angles in self._commanded:
            measured = {
                joint: MeasuredJoint(self.chain.nominal_joint(joint, float(angle)), none)
                for joint, angle in zip(joints, angles, strict=True)
            }
            pair = [chain.endpoint(measured).T_base_endpoint for chain in (self.straight, self.chain)]
            shifts.append(_errors(pair[:1], poses_of(pair[1:]))[0])
        return np.array(shifts)


def _thetas(seen: Poses) -> FloatArray:
    """Return theta [rad] to which a counting ring has counted, (n,)."""
    return np.arctan2(-seen.rotations[:, 0, 1], seen.rotations[:, 1, 1])


def _measured(found: dict[str, Estimates], index: int) -> dict[str, MeasuredJoint]:
    """Return what the POSORs say of one pose, covariance total, as posor_node publishes it."""
    measured = {}
    for joint, estimates in found.items():
        one = estimates.one(index, "")
        measured[joint] = MeasuredJoint(one.T_R_T, one.covariance_random + one.covariance_systematic)
    return measured


def _errors(found: list[pin.SE3], true: Poses) -> FloatArray:
    poses = poses_of(found)
    return errors_in_parent(poses.rotations, poses.translations, true.rotations, true.translations)


_drawer: ArmDrawer | None = None


def _start_worker(path: Path, poses: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the main program ends the workers
    global _drawer  # noqa: PLW0603  a worker reads the files once
    _drawer = ArmDrawer(load_arm(path), poses)


def _work(seeds: range) -> Draws:
    if _drawer is None:
        raise RuntimeError("the worker has not been started")
    return _drawer.draw(seeds)


def draw_arms(
    arm: Arm, arms: int, poses: int, seed: int, *, workers: int = 0, on_drawn: Callable[[int], None] = lambda _: None
) -> Draws:
    """Draw many arms in several processes.

    Args:
        arm: The arm file.
        arms: How many.
        poses: How many poses of each.
        seed: Of the first; the others follow. The result does not depend on the number of processes.
        workers: Processes; 0: as many as there are processors.
        on_drawn: Told how many more have been drawn; what it raises ends the run.

    """
    batches = [range(begin, min(begin + BATCH, seed + arms)) for begin in range(seed, seed + arms, BATCH)]
    parts = []
    pool = ProcessPoolExecutor(
        workers or os.cpu_count(),
        # Not forked: a process that speaks ROS has threads, which a fork would not have.
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_start_worker,
        initargs=(arm.path, poses),
    )
    try:
        for batch, part in zip(batches, pool.map(_work, batches), strict=True):
            parts.append(part)
            on_drawn(len(batch))
    finally:
        pool.shutdown(cancel_futures=True)
    return Draws.joined(parts)
