# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Position of one joint in a sensor_msgs/JointState."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor.errors import TopicError

if TYPE_CHECKING:
    from collections.abc import Sequence


def joint_position(names: Sequence[str], positions: Sequence[float], joint: str) -> float:
    """Return the position of a joint [rad], without a name that of the only one.

    Raises TopicError: the message does not hold the position, or not clearly.
    """
    if joint and joint not in names:
        raise TopicError(f"no joint '{joint}' among {', '.join(names)}")
    if names.count(joint) > 1:
        raise TopicError(f"names {joint} more than once", expected="each joint once")
    if not joint and len(positions) != 1:
        raise TopicError(f"{len(positions)} positions", expected="one, or the parameter 'encoder.joint'")
    if joint and len(positions) != len(names):
        raise TopicError(f"{len(positions)} positions of {len(names)} names", expected="a position of each name")
    return float(positions[names.index(joint) if joint else 0])
