# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Linear accelerations from serialised ``sensor_msgs/Imu``; orientation and angular velocity are not read."""

from __future__ import annotations

import struct

from posor.errors import TopicError
from posor.messages.cdr_schema import STAMP
from posor.messages.joint_transform import stamp_ns_of
from posor.numerics.stamps import NO_TIME
from posor_ros.message_classes import schema_of_class
from sensor_msgs.msg import Imu

_ACCELERATION = struct.Struct("<4d")  # three numbers, then the first of their covariance
MISSING = -1.0  # first number of a covariance without measurement (sensor_msgs/Imu)


class AccelerationReader:
    """Reads the accelerations of one accelerometer."""

    def __init__(self) -> None:
        self._schema, self._known, self._frame = schema_of_class(Imu), b"", ""
        self._end = self._offset = self._size = 0

    def read(self, data: bytes) -> tuple[int, tuple[float, float, float], str]:
        """Return stamp [ns], acceleration [m/s^2] and frame of a message.

        Raises TopicError: invalid bytes, a stamp of zero, or no acceleration in the message.
        """
        if not self._known or data[STAMP.stop : self._end] != self._known or len(data) < self._size:
            data = self._schema.normal(data)
            layout = self._schema.layout(data)
            self._frame = str(self._schema.values(data)["header.frame_id"])
            frame = layout["header.frame_id"].part
            self._offset, self._size, self._end = layout["linear_acceleration.x"].offset, layout.size, frame.stop
            self._known = bytes(data[STAMP.stop : self._end])
        x, y, z, variance = _ACCELERATION.unpack_from(data, self._offset)
        if variance == MISSING:
            raise TopicError("has no linear acceleration", expected="linear_acceleration, whose covariance is not -1")
        stamp_ns = stamp_ns_of(data[STAMP])
        if not stamp_ns:
            raise TopicError(f"its stamp {NO_TIME}", expected="the time of the reading")
        return stamp_ns, (x, y, z), self._frame
