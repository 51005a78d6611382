"""What comes between a motor's angle and what its encoder and its joint show of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray


def after_backlash(motor: FloatArray, backlash: float) -> FloatArray:
    """Return the joint's angle behind a gear with play [rad], (n,), for a motor's angle over one cycle, (n,).

    The play operator: the joint stands still until the motor has gone through the play and then follows it, half the
    backlash behind. What it does depends on the past; here the past is the same cycle, over and over.
    """
    half = 0.5 * backlash
    joint = np.empty(len(motor))
    last = float(motor[0])
    for _ in range(2):  # after one cycle the past is told by the cycle alone
        for n, angle in enumerate(motor.tolist()):
            last = min(max(last, angle - half), angle + half)
            joint[n] = last
    return joint


def encoder_reading(motor: FloatArray, resolution: float) -> FloatArray:
    """Return the motor's angle to the nearest step of the encoder [rad]."""
    return np.asarray(resolution * np.round(motor / resolution))
