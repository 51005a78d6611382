"""Starts for the estimator when nothing is known yet: poses in closed form.

Three or more gaps give the plane as R sees it; two spots give the direction from one source to the other. One rotation
takes the target's own plane and direction there (the TRIAD construction). Exact where rays are short or square to the
diode; the iteration removes the rest. Where there are no spots, theta is unknown: the caller gives guesses.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor_estimator.core.kernels.gap import plane_normal
from posor_estimator.core.kernels.rows import GAP, SPOT_X

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.types import FloatArray, IntArray


def _frame(normal: FloatArray, along: FloatArray) -> FloatArray:
    """Return the rotation whose Z is along ``normal`` and whose X is the part of ``along`` square to it."""
    z = normal / np.linalg.norm(normal)
    x = along - z * (z @ along)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def start_poses(kinds: IntArray, rows: FloatArray, values: FloatArray, thetas: Sequence[float]) -> list[pin.SE3]:
    """Return starts for ``T_R_T``.

    Args:
        kinds: Kind of each row, shape (m,).
        rows: Parameters of each row, shape (m, width).
        values: Linearised readings [m], shape (m,).
        thetas: Guesses of theta [rad], for readings that do not tell it.

    Returns:
        One pose where gaps and spots tell it, else one for each guess: square to the probes where fewer than three gaps
        tell the lean.

    """
    gaps = rows[kinds == GAP]
    if len(gaps) < 3:  # noqa: PLR2004  a plane
        return [pin.SE3(pin.utils.rotate("z", theta), np.zeros(3)) for theta in thetas]
    hits = gaps[:, 0:3] + values[kinds == GAP, None] * gaps[:, 3:6]
    centre = hits.mean(axis=0)
    normal = np.linalg.svd(hits - centre)[2][2]
    if normal @ gaps[:, 3:6].sum(axis=0) > 0.0:
        normal = -normal
    normal_T = np.array(plane_normal(*gaps[0, 9:12]))
    spots = np.flatnonzero(kinds == SPOT_X)
    if len(spots) < 2:  # noqa: PLR2004  a direction
        return [_leaning(theta, normal_T, normal, centre, gaps[0, 6:9]) for theta in thetas]
    geometry = rows[spots]
    seen = geometry[:, 0:3] + values[spots, None] * geometry[:, 3:6] + values[spots + 1, None] * geometry[:, 6:9]
    sources = geometry[:, 9:12]
    rotation = _frame(normal, seen[1] - seen[0]) @ _frame(normal_T, sources[1] - sources[0]).T
    # The plane's distance fixes the translation along the normal, the spots fix it across.
    across = np.mean(seen - sources @ rotation.T, axis=0)
    return [_on_plane(rotation, across, normal, centre, gaps[0, 6:9])]


def _on_plane(
    rotation: FloatArray, translation: FloatArray, normal: FloatArray, centre: FloatArray, point: FloatArray
) -> pin.SE3:
    """Return the pose moved along the normal until the target's plane goes through ``centre``."""
    along = normal @ (centre - translation - rotation @ point)
    return pin.SE3(rotation, translation + along * normal)


def _leaning(theta: float, normal_T: FloatArray, normal: FloatArray, centre: FloatArray, point: FloatArray) -> pin.SE3:
    """Return the pose at a guessed theta whose plane is the one that the gaps show."""
    turned = pin.utils.rotate("z", theta)
    before = turned @ normal_T
    axis = np.cross(before, normal)
    sine = float(np.linalg.norm(axis))
    lean = pin.exp3(axis / sine * math.atan2(sine, float(before @ normal))) if sine > 0.0 else np.eye(3)
    return _on_plane(lean @ turned, np.zeros(3), normal, centre, point)
