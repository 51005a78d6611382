"""The six native coordinates of a POSOR: (x, y, gap, alpha, beta, theta).

``x, y, gap`` are the origin of T in R [m]. The rotation is ``R_R_T = Ry(beta) Rx(alpha) Rz(theta)``: theta is the large
rotation about the target's own Z, alpha and beta lean that axis about X and Y of R. In this order a pure alpha or beta
is read by the gap probes as a slope without a cross term of second order, whatever theta is (thesis 5.3.1).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray


def rotation_from_native(alpha: float, beta: float, theta: float) -> FloatArray:
    """Return ``Ry(beta) Rx(alpha) Rz(theta)``, shape (3, 3); angles [rad]."""
    sa, ca = math.sin(alpha), math.cos(alpha)
    sb, cb = math.sin(beta), math.cos(beta)
    st, ct = math.sin(theta), math.cos(theta)
    return np.array(
        [
            [cb * ct + sb * sa * st, -cb * st + sb * sa * ct, sb * ca],
            [ca * st, ca * ct, -sa],
            [-sb * ct + cb * sa * st, sb * st + cb * sa * ct, cb * ca],
        ]
    )


def native_from_rotation(rotation: FloatArray) -> tuple[float, float, float]:
    """Return (alpha, beta, theta) [rad] of ``R_R_T``; theta in (-pi, pi], alpha in [-pi/2, pi/2]."""
    alpha = math.atan2(-rotation[1, 2], math.hypot(rotation[1, 0], rotation[1, 1]))
    beta = math.atan2(rotation[0, 2], rotation[2, 2])
    theta = math.atan2(rotation[1, 0], rotation[1, 1])
    return alpha, beta, theta
