"""Joint transforms as bytes, read for the chain."""

from __future__ import annotations

import struct
from typing import NamedTuple

from posor_msgs.msg import JointTransform

from posor_estimator.ros.cdr import NS, Schema
from posor_estimator.ros.cdr_walk import LITTLE_ENDIAN

JOINT_TRANSFORM = Schema.of(JointTransform)
POSE = 7
COVARIANCE = 36

_NUMBER = struct.Struct("<Q")
_VERDICT = struct.Struct("<dBB2xII")
"""Residual, redundancy, state, faults and the scan's status, which follow one another."""
_THETA = 10
"""Where the last of the native coordinates stands among what is unpacked."""


class Reading(NamedTuple):
    """What the chain needs of one transform."""

    data: bytes
    pose: slice
    """Where in the bytes the pose lies: x, y, z [m], unit quaternion x, y, z, w."""
    covariance: slice
    """Where the covariance lies, row by row."""
    stamp_ns: int
    theta: float
    """The large rotation, counted [rad]."""
    state: int
    faults: int


class TransformReader:
    """Reads joint transforms between two plates.

    Attributes:
        frames: Names of the plates, parent and child.

    """

    def __init__(self, example: bytes) -> None:
        """Read transforms like an example, in plain CDR.

        Raises:
            TopicError: The example is no joint transform.

        """
        layout = JOINT_TRANSFORM.layout(example)
        values = JOINT_TRANSFORM.values(example, layout)
        self.frames = (str(values["header.frame_id"]), str(values["child_frame_id"]))
        paths = ("header.stamp.sec", "header.stamp.nanosec", "header.frame_id", "child_frame_id", "native")
        self._unpack = layout.unpacker((*paths, "state", "faults")).unpack_from
        self._named = self._unpack(example)[3:5]
        self._size = layout.size
        begin = layout["pose.position.x"].offset
        self._parts = slice(begin, begin + 8 * POSE), layout["covariance"].part

    def read(self, data: bytes) -> Reading | None:
        """Return what a transform says, None where it is not between the same plates or is none at all."""
        if len(data) < self._size:
            return None
        said = self._unpack(data)
        if said[0] != LITTLE_ENDIAN or said[3:5] != self._named:
            return None
        pose, covariance = self._parts
        return Reading(data, pose, covariance, said[1] * NS + said[2], said[_THETA], said[11], said[12])
