"""A start for the estimator when nothing is known yet: the pose in closed form, short of the rays' small detours.

Three or more gaps give the plane as R sees it; two spots give the direction from one source to the other. One rotation
takes the target's own plane and direction there (the TRIAD construction). Exact where rays are short or square to the
diode; the iteration removes the rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor_estimator.core.kernels.solve import GAP, SPOT_X

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray


def _frame(normal: FloatArray, along: FloatArray) -> FloatArray:
    """Return the rotation whose Z is along ``normal`` and whose X is the part of ``along`` square to it."""
    z = normal / np.linalg.norm(normal)
    x = along - z * (z @ along)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def start_pose(kinds: IntArray, rows: FloatArray, values: FloatArray) -> pin.SE3 | None:
    """Return a start for ``T_R_T`` from three or more gaps and two spots; None where there are not as many."""
    gaps = rows[kinds == GAP]
    spots = np.flatnonzero(kinds == SPOT_X)
    if len(gaps) < 3 or len(spots) < 2:  # noqa: PLR2004
        return None
    hits = gaps[:, 0:3] + values[kinds == GAP, None] * gaps[:, 3:6]
    centre = hits.mean(axis=0)
    normal = np.linalg.svd(hits - centre)[2][2]
    if normal @ gaps[:, 3:6].sum(axis=0) > 0.0:
        normal = -normal
    geometry = rows[spots]
    seen = geometry[:, 0:3] + values[spots, None] * geometry[:, 3:6] + values[spots + 1, None] * geometry[:, 6:9]
    sources = geometry[:, 9:12]
    rotation = _frame(normal, seen[1] - seen[0]) @ _frame(gaps[0, 9:12], sources[1] - sources[0]).T
    # The plane's distance fixes the translation along the normal, the spots fix it across.
    across = np.mean(seen - sources @ rotation.T, axis=0)
    along = normal @ (centre - across - rotation @ gaps[0, 6:9])
    return pin.SE3(rotation, across + along * normal)
