# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Propose further poses that would determine parameters that a bundle fit leaves open."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.estimation.forward import scans_at
from posor.model.native_coordinates import native_from_rotation, rotation_from_native
from posor.sensors.base import RowSensor

from posor_calibration.bundle_problem import POSE_SIZE, BundleData, BundleProblem, PoseReference
from posor_calibration.procedure import Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.estimation.sensor_stack import Stack
    from posor.numerics.array_types import FloatArray

    from posor_calibration.calibration_parameters import FreeParameters
    from posor_calibration.least_squares import WeakDirection

CANDIDATES = 400
SPAN_FACTOR = 1.5  # candidates are drawn from the span of the recorded poses, widened by this factor
LEAST_SPAN = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-2])  # least span of x, y, gap [m], alpha, beta, theta [rad]
PER_DIRECTION, MAX_PROPOSALS = 2, 6
REPETITIONS = 10.0  # measurements of a proposed pose
WORTHWHILE = 0.9  # a pose is proposed if it leaves less than this share of the present uncertainty


def propose_poses(
    weak: Sequence[WeakDirection],
    stack: Stack,
    free: FreeParameters,
    values: FloatArray,
    data: BundleData,
    random: np.random.Generator,
) -> Table:
    """Return a table of poses that would best determine weak directions, each measured ``REPETITIONS`` times.

    ``stack`` are the sensors before the fit; ``values`` (q,) the fitted free parameters, then those of the mounting.
    """
    rows: list[tuple[float | int | str, ...]] = []
    if weak and all(isinstance(sensor, RowSensor) for sensor in stack.sensors):
        rows = _rank_candidates(weak, stack, free, values, data, random)
    rows.sort(key=lambda row: float(row[-1]) / float(row[-2]))
    return Table(
        "poses that would determine more",
        ("combination", "x", "y", "gap", "alpha", "beta", "theta", "remaining now", "then"),
        ("", "m", "m", "m", "rad", "rad", "rad", "of the prior uncertainty", ""),
        tuple(rows[:MAX_PROPOSALS]),
    )


def _rank_candidates(
    weak: Sequence[WeakDirection],
    stack: Stack,
    free: FreeParameters,
    values: FloatArray,
    data: BundleData,
    random: np.random.Generator,
) -> list[tuple[float | int | str, ...]]:
    present = stack.with_parameter_values(free.parameter_vector(values[: len(free)]))
    natives = _draw_candidates(data.poses, random)
    rotations = np.array([rotation_from_native(*native[3:]) for native in natives])
    scans = scans_at(present, rotations, natives[:, :3], np.arange(len(natives), dtype=np.int64))
    with np.errstate(invalid="ignore"):
        valid = np.flatnonzero(present.linearise(scans).valid)
    if not valid.size:
        return []
    poses = [pin.SE3(rotations[i], natives[i, :3]) for i in valid]
    reference = None
    if data.reference is not None:
        sigmas = np.tile(np.median(data.reference.sigmas, axis=0), (len(poses), 1))
        reference = PoseReference(poses, sigmas, data.reference.mounting_sigmas)
    counts = np.full(len(poses), np.median(data.counts))
    problem = BundleProblem(stack, free, BundleData(scans.select(valid), counts, poses, reference))
    scaled = (problem.jacobian(values) * problem.scales).reshape(len(poses), problem.per_scan, -1)
    rows: list[tuple[float | int | str, ...]] = []
    for direction in weak:
        gains = information_gains(direction, scaled)
        for best in np.argsort(-gains, kind="stable")[:PER_DIRECTION]:
            remaining = direction.remaining_with_prior(REPETITIONS * float(gains[best]))
            if remaining < WORTHWHILE * direction.remaining_with_prior():
                pose = natives[valid[best]].tolist()
                rows.append((" and ".join(direction.names), *pose, direction.remaining_with_prior(), remaining))
    return rows


def information_gains(direction: WeakDirection, scaled_jacobians: FloatArray) -> FloatArray:
    """Return the information that a scan at each candidate pose adds to a direction, (n,).

    ``scaled_jacobians``: d(normalised residual)/d(parameter over its prior standard uncertainty) at each, (n, m, p).
    """
    return np.asarray(np.sum(np.square(scaled_jacobians @ direction.shares), axis=1))


def _draw_candidates(poses: Sequence[pin.SE3], random: np.random.Generator) -> FloatArray:
    """Return native coordinates (n, 6) within and somewhat beyond the span of poses."""
    known = np.array([[*pose.translation, *native_from_rotation(pose.rotation)] for pose in poses])
    mean = np.angle(np.mean(np.exp(1j * known[:, 5])))
    known[:, 5] = mean + np.angle(np.exp(1j * (known[:, 5] - mean)))  # within half a turn of their mean direction
    middle = 0.5 * (known.min(axis=0) + known.max(axis=0))
    half = SPAN_FACTOR * 0.5 * np.maximum(np.ptp(known, axis=0), LEAST_SPAN)
    return np.asarray(middle + half * random.uniform(-1.0, 1.0, (CANDIDATES, POSE_SIZE)))
