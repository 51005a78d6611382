"""Which further poses would tell what the data at hand leave open."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor_estimator.core.calibrate.bundle_problem import POSE, BundleProblem, PoseReference
from posor_estimator.core.calibrate.directions import Direction, telling
from posor_estimator.core.calibrate.procedure import Table
from posor_estimator.core.forward import scans_at
from posor_estimator.core.native import native_from_rotation, rotation_from_native
from posor_estimator.core.sensors.base import RowSensor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.calibrate.bundle_data import BundleData
    from posor_estimator.core.calibrate.unknowns import Unknowns
    from posor_estimator.core.stack import Stack
    from posor_estimator.core.types import FloatArray

CANDIDATES = 400
BEYOND = 1.5
"""Candidates are drawn from the span of the recorded poses, widened by this factor."""
LEAST_SPAN = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-2])
"""Of x, y, gap [m], alpha, beta, theta [rad], where the recorded poses have less."""
EACH, MOST = 2, 6
"""Proposals for each combination, and in all."""
EACH_POSE = 10.0
"""A proposed pose would be measured so many times."""
WORTH = 0.9
"""A pose is proposed if it would leave less than this part of the present uncertainty."""


def telling_poses(
    weak: Sequence[Direction],
    stack: Stack,
    unknowns: Unknowns,
    found: FloatArray,
    data: BundleData,
    random: np.random.Generator,
) -> Table:
    """Return a table of poses that would tell best what the data leave open, each measured ``EACH_POSE`` times.

    Args:
        weak: What the data tell badly, the worst first.
        stack: The sensors as they were before the fit.
        unknowns: Those of the fit.
        found: Their values, and those of the mounting, (q,).
        data: What was recorded.
        random: Where to draw candidates from.

    """
    columns = ("combination", "x", "y", "gap", "alpha", "beta", "theta", "remaining now", "then")
    title = "poses that would tell more"
    units = ("", "m", "m", "m", "rad", "rad", "rad", "of the uncertainty before", "")
    if not weak or not all(isinstance(sensor, RowSensor) for sensor in stack.sensors):
        return Table(title, columns, units, ())
    now = stack.with_parameter_values(unknowns.values(found[: len(unknowns)]))
    natives = _candidates(data.poses, random)
    rotations = np.array([rotation_from_native(*native[3:]) for native in natives])
    scans = scans_at(now, rotations, natives[:, :3], np.arange(len(natives), dtype=np.int64))
    with np.errstate(invalid="ignore"):
        fit = np.flatnonzero(~now.linearise(scans)[0].any(axis=1))
    if not fit.size:
        return Table(title, columns, units, ())
    poses = [pin.SE3(rotations[i], natives[i, :3]) for i in fit]
    reference = None
    if data.reference is not None:
        sigmas = np.tile(np.median(data.reference.sigmas, axis=0), (len(poses), 1))
        reference = PoseReference(poses, sigmas, data.reference.mounting_sigmas)
    counts = np.full(len(poses), np.median(data.counts))
    problem = BundleProblem(stack, unknowns, scans.chosen(fit), counts, poses, reference)
    scaled = (problem.jacobian(found) * problem.scales).reshape(len(poses), problem.per_scan, -1)
    rows: list[tuple[float | int | str, ...]] = []
    for direction in weak:
        for best in telling(direction, scaled)[:EACH]:
            left = direction.left(EACH_POSE * float(np.sum(np.square(scaled[best] @ direction.shares))))
            if left < WORTH * direction.left():
                names = " and ".join(direction.names)
                rows.append((names, *(float(x) for x in natives[fit[best]]), direction.left(), left))
    rows.sort(key=lambda row: float(row[-1]) / float(row[-2]))
    return Table(title, columns, units, tuple(rows[:MOST]))


def _candidates(poses: Sequence[pin.SE3], random: np.random.Generator) -> FloatArray:
    """Return native coordinates (n, 6) in and somewhat beyond the span of poses."""
    seen = np.array([[*pose.translation, *native_from_rotation(pose.rotation)] for pose in poses])
    seen[:, 5] = _from_their_middle(seen[:, 5])
    middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    half = BEYOND * 0.5 * np.maximum(np.ptp(seen, axis=0), LEAST_SPAN)
    return np.asarray(middle + half * random.uniform(-1.0, 1.0, (CANDIDATES, POSE)))


def _from_their_middle(angles: FloatArray) -> FloatArray:
    """Return angles [rad] within half a turn of their mean direction."""
    middle = np.angle(np.mean(np.exp(1j * angles)))
    return np.asarray(middle + np.angle(np.exp(1j * (angles - middle))))
