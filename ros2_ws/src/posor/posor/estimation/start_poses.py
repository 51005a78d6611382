# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Start poses in closed form, when no previous pose is known.

Three or more gaps give the plane in R; two light spots give the direction from one source to the other. One rotation
takes the target's own plane and direction there (the TRIAD construction). Exact where rays are short or perpendicular
to the diode; the solver removes the rest. Without spots theta is unknown: the caller gives guesses.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posor.model.gap import plane_normal
from posor.model.reading_rows import GAP, SPOT_X

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pinocchio as pin
    from numpy.typing import NDArray

    from posor.numerics.array_types import FloatArray


def start_poses(rows: NDArray[np.void], values: FloatArray, thetas: Sequence[float]) -> list[pin.SE3]:
    """Return starts for ``T_R_T``.

    ``rows``: reading rows, shape (m,), dtype ROW; ``values``: linearised readings [m], shape (m,); ``thetas``: guesses
    of theta [rad], for readings that do not tell theta. Return one pose where gaps and spots determine it, else one for
    each guess, perpendicular to the probes where fewer than three gaps determine the lean.
    """
    import pinocchio as pin  # noqa: PLC0415  50 MB that a node does not need before its first scan

    is_gap = rows["kind"] == GAP
    gaps = rows[is_gap]
    if len(gaps) < 3:  # noqa: PLR2004  a plane
        return [pin.SE3(pin.utils.rotate("z", theta), np.zeros(3)) for theta in thetas]
    hits = gaps["tip"] + values[is_gap, None] * gaps["axis"]
    centre = hits.mean(axis=0)
    normal = np.linalg.svd(hits - centre)[2][2]
    if normal @ gaps["axis"].sum(axis=0) > 0.0:
        normal = -normal
    tilt_x, tilt_y = gaps["tilt"][0]
    normal_T = np.array(plane_normal(tilt_x, tilt_y, gaps["turn"][0]))
    point = gaps["plane_point"][0]
    spots = np.flatnonzero(rows["kind"] == SPOT_X)
    if len(spots) < 2:  # noqa: PLR2004  a direction
        return [_leaning(theta, normal_T, normal, centre, point) for theta in thetas]
    diodes = rows[spots]
    seen = diodes["diode_origin"] + values[spots, None] * diodes["x_axis"] + values[spots + 1, None] * diodes["y_axis"]
    sources = diodes["source_origin"]
    rotation = _frame(normal, seen[1] - seen[0]) @ _frame(normal_T, sources[1] - sources[0]).T
    # The plane's distance fixes the translation along the normal, the spots fix it across.
    across = np.mean(seen - sources @ rotation.T, axis=0)
    return [_on_plane(pin.SE3(rotation, across), normal, centre, point)]


def _frame(normal: FloatArray, along: FloatArray) -> FloatArray:
    """Return the rotation whose Z is along ``normal`` and whose X is the part of ``along`` perpendicular to it."""
    z = normal / np.linalg.norm(normal)
    x = along - z * (z @ along)
    with np.errstate(invalid="ignore"):  # spots in one place give NaN, from which the solver does not converge
        x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _on_plane(pose: pin.SE3, normal: FloatArray, centre: FloatArray, point: FloatArray) -> pin.SE3:
    """Move a pose along the normal until the target's plane goes through ``centre``."""
    pose.translation += normal @ (centre - pose.translation - pose.rotation @ point) * normal
    return pose


def _leaning(theta: float, normal_T: FloatArray, normal: FloatArray, centre: FloatArray, point: FloatArray) -> pin.SE3:
    """Return the pose at a guessed theta whose plane is the one that the gaps show."""
    import pinocchio as pin  # noqa: PLC0415  50 MB that a node does not need before its first scan

    turned = pin.utils.rotate("z", theta)
    before = turned @ normal_T
    axis = np.cross(before, normal)
    sine = float(np.linalg.norm(axis))
    lean = pin.exp3(axis / sine * math.atan2(sine, float(before @ normal))) if sine > 0.0 else np.eye(3)
    return _on_plane(pin.SE3(lean @ turned, np.zeros(3)), normal, centre, point)
