"""How fast the target can move: a test of each new pose, and a prior where the readings are blind."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import in_place, inlined
from posor_estimator.core.kernels.memory import (
    MOTION_LEAN,
    MOTION_THETA,
    MOTION_TRANSLATION,
    ROTATION,
    TRANSLATION,
    theta_remembered,
    wrapped,
)
from posor_estimator.core.kernels.rows import AFFINE
from posor_estimator.core.kernels.vector import square

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

NOISE_ALLOWANCE = 5.0
"""Standard deviations of noise that may come on top of the largest motion before a jump is a fault."""


@in_place
def prior_rows(
    kinds: IntArray,
    rows: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    first: int,
    settings: FloatArray,
    elapsed: float,
) -> None:
    """Make rows ``first`` to ``first + 6`` say that the pose is at the start, as surely as the target moves slowly."""
    for i in range(6):
        kinds[first + i] = AFFINE
        values[first + i] = 0.0
        for k in range(rows.shape[1]):
            rows[first + i, k] = 0.0
        rows[first + i, 1 + i] = 1.0
        rate = settings[MOTION_TRANSLATION] if i < 3 else settings[MOTION_LEAN]  # noqa: PLR2004  translation first
        if i == 5:  # noqa: PLR2004  about Z
            rate = settings[MOTION_THETA]
        weights[first + i] = 1.0 / square(rate * elapsed)


@inlined
def share_moved(
    settings: FloatArray,
    elapsed: float,
    random: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    theta: float,
    memory: FloatArray,
) -> float:
    """Return how far a pose is from the last one, as a share of what the target can have moved; theta its heading."""
    across = 0.0
    for i in range(3):
        allowed = settings[MOTION_TRANSLATION] * elapsed + NOISE_ALLOWANCE * math.sqrt(2.0 * random[i, i])
        across = max(across, abs(translation[i] - memory[TRANSLATION + i]) / allowed)
    for i in range(2):
        leaned = abs(rotation[i, 2] - memory[ROTATION + 3 * i + 2])
        spread = random[4, 4] if i == 0 else random[3, 3]
        across = max(across, leaned / (settings[MOTION_LEAN] * elapsed + NOISE_ALLOWANCE * math.sqrt(2.0 * spread)))
    turned = abs(wrapped(theta - theta_remembered(memory)))
    allowed = settings[MOTION_THETA] * elapsed + NOISE_ALLOWANCE * math.sqrt(2.0 * random[5, 5])
    share: float = max(across, turned / allowed)
    return share
