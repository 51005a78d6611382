"""The closed form of the thesis for small angles: a cross-check, and a measure of what the exact model gains.

Probes at (-c, 0), (0, a), (0, -b); everything that makes a real POSOR differ from the drawing (tilts, slanting rays,
spacings, bump profile) is left out. Source: thesis 5.3.1, equations 5.3 and 5.25; theta, equation 5.32.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.kernels.rows import GAP, RING, SPOT_X
from posor_estimator.core.native import rotation_from_native

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray


def closed_form(
    kinds: IntArray, rows: FloatArray, readings: FloatArray, bumps: int, theta_known: float
) -> tuple[FloatArray, FloatArray]:
    """Return R_R_T (3, 3) and the origin of T in R (3,) [m] of one scan by the closed form.

    Args:
        kinds: Kind of each row, shape (m,): three gaps, then two spots or four ring gaps.
        rows: Parameters of each row, shape (m, width).
        readings: Linearised readings [m], shape (m,).
        bumps: Bumps of the ring.
        theta_known: Theta to half a bump [rad]; for rings.

    """
    g1, g2, g3 = readings[kinds == GAP]
    tips = rows[kinds == GAP, 0:3]
    a, b, c = tips[1, 1], -tips[2, 1], -tips[0, 0]
    alpha = math.atan((g2 - g3) / (a + b))
    beta = math.atan((g1 - (b * g2 + a * g3) / (a + b)) / c)
    gap = g3 + b * math.tan(alpha)
    if np.any(kinds == RING):
        x, y, theta = _from_ring(rows[kinds == RING], readings[kinds == RING], bumps, theta_known)
    else:
        x, y, theta = _from_spots(rows, readings, np.flatnonzero(kinds == SPOT_X))
    return rotation_from_native(alpha, beta, theta), np.array([x, y, gap])


def _from_spots(rows: FloatArray, readings: FloatArray, spots: IntArray) -> tuple[float, float, float]:
    seen = rows[spots, 0:2] + np.column_stack([readings[spots], readings[spots + 1]])
    sources = rows[spots, 9:11]
    along, before = seen[0] - seen[1], sources[0] - sources[1]
    theta = math.atan2(along[1], along[0]) - math.atan2(before[1], before[0])
    theta = math.remainder(theta, 2.0 * math.pi)
    turn = np.array([[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]])
    x, y = np.mean(seen - sources @ turn.T, axis=0)
    return float(x), float(y), theta


def _from_ring(rows: FloatArray, gaps: FloatArray, bumps: int, theta_known: float) -> tuple[float, float, float]:
    # Opposite probes in phase, the two pairs in quadrature: sums hold theta, differences the runout.
    middle = math.hypot(rows[0, 0], rows[0, 1]) - rows[0, 6]
    phase = math.atan2(middle - 0.5 * (gaps[1] + gaps[3]), middle - 0.5 * (gaps[0] + gaps[2]))
    theta = theta_known + math.remainder(phase - bumps * theta_known, 2.0 * math.pi) / bumps
    return 0.5 * (gaps[2] - gaps[0]), 0.5 * (gaps[3] - gaps[1]), theta
