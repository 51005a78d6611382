# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses of an arm for its calibration: means of recorded transforms, or any angles; and which poses determine most."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.chain.beam_temperatures import PERIOD_NS
from posor.errors import BagError, ParameterError
from posor.estimation.posor import Posor
from posor.model.fault import USABLE_STATES
from posor.numerics.stamps import NS
from posor.uncertainty.budget_poses import estimates_at, require_poses
from scipy.linalg import solve_triangular

from posor_calibration.arm.arm_model import ArmPoses

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.calibration.calibration_file import Calibration
    from posor.chain.kinematic_chain import Chain
    from posor.messages.estimate_arrays import ArmEstimates
    from posor.numerics.array_types import FloatArray, IntArray

    from posor_calibration.arm.arm_fit import ArmProblem

STILL = 20e-6  # root mean square of a joint's shifts [m] and turns [rad] during a reading of the reference


def recorded_poses(
    arm: ArmEstimates, chain: Chain, stamps_ns: IntArray, rows: IntArray, window_s: float, where: str
) -> ArmPoses:
    """Return the means of the transforms within ``window_s`` [s] about each of n stamps.

    ``rows``: number of the row of each stamp in its table; ``where``: the bag, in errors. Raises BagError: a joint has
    no usable scan there, or moves, the thermometer of a beam cannot be used there, or the bag holds a recording twice.
    """
    arm.check_one_run(where)
    _check_windows(stamps_ns, rows, window_s, where)
    names = [joint.name for joint in chain.path_joints]
    shape = len(stamps_ns), len(names)
    transforms, random, systematic = np.empty((*shape, 7)), np.empty((*shape, 6, 6)), np.empty((*shape, 6, 6))
    angles = np.empty(shape)
    for j, name in enumerate(names):
        estimates = arm.joints[name]
        usable = np.isin(estimates.states, USABLE_STATES)
        for n, stamp_ns in enumerate(stamps_ns):
            near = np.flatnonzero(usable & (np.abs(estimates.stamps_ns - stamp_ns) <= round(window_s * NS)))
            if not near.size:
                what = f"joint '{name}' has no usable scan within {window_s:g} s of row {rows[n]}"
                expected = "scans at the times of the table: do both clocks agree?"
                raise BagError(what, where=where, expected=expected)
            first = pin.XYZQUATToSE3(estimates.poses[near[0]])
            shifts = np.array([pin.log6(first.actInv(pin.XYZQUATToSE3(estimates.poses[k]))).vector for k in near])
            motion = float(np.sqrt(np.mean(np.square(shifts - shifts.mean(axis=0)).sum(axis=1))))
            if motion > STILL:
                what = f"joint '{name}' moves by {motion:.3g} m or rad at row {rows[n]}"
                raise BagError(what, where=where, expected=f"an arm at rest within {STILL:g} about each row")
            mean = first * pin.exp6(shifts.mean(axis=0))
            transforms[n, j] = pin.SE3ToXYZQUAT(mean)
            random[n, j] = estimates.covariances_random[near].mean(axis=0) / near.size
            systematic[n, j] = estimates.covariances_systematic[near].mean(axis=0)
            nominal = chain.nominal_joint(name, 0.0).rotation.T @ mean.rotation
            angles[n, j] = np.arctan2(nominal[1, 0] - nominal[0, 1], nominal[0, 0] + nominal[1, 1])
    kelvins = np.array(
        [_beam_temperatures(arm, chain, int(ns), int(row), where) for ns, row in zip(stamps_ns, rows, strict=True)]
    )
    return ArmPoses(tuple(f"row {row}" for row in rows), angles, transforms, random, systematic, kelvins)


def _beam_temperatures(arm: ArmEstimates, chain: Chain, stamp_ns: int, row: int, where: str) -> list[float]:
    """Return the temperature of each beam [K] at a stamp; NaN: it has no thermometer."""
    present, found = arm.temperatures.get(stamp_ns // PERIOD_NS, {}), []
    for beam in chain.beams:
        thermometer = beam.entry.thermometer
        if thermometer is not None and thermometer.name not in present:
            what = f"the thermometer '{thermometer.name}' of beam '{beam.name}' cannot be used at row {row}"
            raise BagError(what, where=where, expected="its sound readings, recorded with the scans")
        found.append(math.nan if thermometer is None else present[thermometer.name])
    return found


def _check_windows(stamps_ns: IntArray, rows: IntArray, window_s: float, where: str) -> None:
    """Raise BagError: two rows would use the same scans, whose noise would count as that of different ones."""
    order = np.argsort(stamps_ns)
    apart_s = np.diff(stamps_ns[order]) / NS
    if apart_s.size and apart_s.min() < 2.0 * window_s:
        first = int(apart_s.argmin())
        one, other = sorted(rows[order[first : first + 2]].tolist())
        what = f"rows {one} and {other} are {apart_s[first]:.3g} s apart and use the same scans"
        raise BagError(what, where=where, expected=f"one row for each dwell, more than {2.0 * window_s:g} s apart")


def poses_at(chain: Chain, calibrations: Mapping[str, Calibration], angles: FloatArray) -> ArmPoses:
    """Return nominal poses at angles of the joints [rad], (n, j), with the covariances of one scan.

    Raises ChainError: a POSOR has no pose at an angle.
    """
    names = [joint.name for joint in chain.path_joints]
    estimates = [
        estimates_at(Posor(calibrations[name]), chain, name, own) for name, own in zip(names, angles.T, strict=True)
    ]
    for name, own, found in zip(names, angles.T, estimates, strict=True):
        require_poses(found, name, own)
    transforms = [
        [pin.SE3ToXYZQUAT(chain.nominal_joint(*each)) for each in zip(names, row, strict=True)] for row in angles
    ]
    random, systematic = (
        np.stack([getattr(each, f"covariances_{kind}") for each in estimates], axis=1)
        for kind in ("random", "systematic")
    )
    names_of_rows = tuple(f"pose {n + 1}" for n in range(len(angles)))
    kelvins = np.full((len(angles), len(chain.beams)), math.nan)
    return ArmPoses(names_of_rows, angles, np.array(transforms), random, systematic, kelvins)


def select_poses(problem: ArmProblem, count: int) -> list[int]:
    """Return the poses that leave the least volume of uncertainty of all parameters (D-optimality), the best first.

    One after the other is added (Fedorov 1972, sequential design). Raises ParameterError: there are fewer candidates.
    """
    jacobians = problem.whitened_by_pose()
    if count > len(jacobians):
        what = f"{count} of {len(jacobians)} candidates"
        raise ParameterError(what, where="calibrate-arm, --select", expected=f"1 to {len(jacobians)}")
    covariance = problem.prior.copy()
    chosen: list[int] = []
    for _ in range(count):
        gains = {
            pose: float(np.linalg.slogdet(np.eye(len(rows)) + rows @ covariance @ rows.T)[1])
            for pose, rows in jacobians.items()
            if pose not in chosen
        }
        chosen.append(max(gains, key=gains.__getitem__))
        rows = jacobians[chosen[-1]]
        root = np.linalg.cholesky(np.eye(len(rows)) + rows @ covariance @ rows.T)
        gain = solve_triangular(root, rows @ covariance, lower=True)
        covariance -= gain.T @ gain
    return chosen
