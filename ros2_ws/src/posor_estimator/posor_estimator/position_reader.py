# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Positions of named joints from serialised ``sensor_msgs/JointState``, whatever the order of their names."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from posor.errors import TopicError
from posor.messages.cdr_schema import STAMP
from posor_ros.message_classes import schema_of_class
from sensor_msgs.msg import JointState

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import FloatArray


class PositionReader:
    """Reads the positions of joints from serialised JointState messages."""

    def __init__(self, names: Sequence[str]) -> None:
        """Read joints of these names."""
        self._names, self._schema, self._known = tuple(names), schema_of_class(JointState), b""
        self._end = self._offset = self._count = self._size = 0
        self._columns, self._rows = np.zeros((2, 0), dtype=np.int64)

    def read(self, data: bytes) -> tuple[bytes, FloatArray]:
        """Return the eight bytes of the stamp, and the angles of the joints [rad]; NaN: not in this message.

        Raises TopicError: invalid bytes, names without positions or repeated, no finite angle, none of the joints.
        """
        if not self._known or data[STAMP.stop : self._end] != self._known or len(data) < self._size:
            data = self._schema.normal(data)
            self._learn(data)
        angles = np.full(len(self._names), np.nan)
        angles[self._columns] = np.frombuffer(data, "<f8", self._count, self._offset)[self._rows]
        if not np.isfinite(angles[self._columns]).all():
            wrong = [self._names[j] for j in self._columns if not math.isfinite(angles[j])]
            raise TopicError(f"the position of {', '.join(wrong)} is not a number", expected="an angle [rad]")
        return data[STAMP], angles

    def _learn(self, data: bytes) -> None:
        """Learn the names of a message and where its positions are."""
        names, layout = list(self._schema.values(data)["name"]), self._schema.layout(data)
        found = [(j, names.index(name)) for j, name in enumerate(self._names) if name in names]
        if repeated := [name for name in self._names if names.count(name) > 1]:
            raise TopicError(f"names {', '.join(repeated)} more than once", expected="each joint once")
        if not found:
            raise TopicError(f"names {', '.join(names) or 'are empty'}", expected=f"{', '.join(self._names)}")
        count = layout["position"].length
        if count != len(names):
            raise TopicError(f"{count} positions of {len(names)} names", expected="a position of each name")
        self._columns, self._rows = np.array(found).T
        self._offset, self._count = layout["position"].offset, count
        self._end, self._size = layout.lengths["position"] + 4, layout.size
        self._known = bytes(data[STAMP.stop : self._end])
