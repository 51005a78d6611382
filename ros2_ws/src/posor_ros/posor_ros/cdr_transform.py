"""Serialised joint transforms: checks, stamp and state, without deserialising the messages."""

from __future__ import annotations

import struct
from functools import lru_cache

from posor.chain.joint_measurements import JointRowLayout
from posor.messages.cdr_schema import LITTLE_ENDIAN, STAMP
from posor.messages.message_table import LEAD, TableLayout
from posor.numerics.stamps import time_ns
from posor_msgs.msg import JointTransform

from posor_ros.message_classes import schema_of_class

JOINT_TRANSFORM = schema_of_class(JointTransform)

_STAMP = struct.Struct("<iI")
_FAULTS = struct.Struct("<I")


@lru_cache(maxsize=16)
def stamp_ns_of(stamp: bytes) -> int:
    """Return a serialised stamp, ``data[STAMP]``, in nanoseconds; 0 for an invalid stamp.

    Cached, because the messages of all joints for one scan have the same stamp.
    """
    return time_ns(*_STAMP.unpack(stamp))


def row_layout_of(layout: TableLayout) -> JointRowLayout:
    """Return the offsets of the fields that the chain reads from rows of transforms."""
    return JointRowLayout(
        pose=LEAD + layout.offset("pose.position.x"),
        native=LEAD + layout.offset("native"),
        covariance=LEAD + layout.offset("covariance"),
        state=LEAD + layout.offset("state"),
        size=LEAD + layout.size,
    )


class JointTransformFormat:
    """Format of serialised transforms between two plates.

    Attributes:
        size: Of a message [bytes]; surplus bytes at its end are ignored.
        row_layout: Offsets of the fields in a row with the message.

    """

    def __init__(self, parent: str, child: str) -> None:
        """Prepare for transforms from the plate ``parent`` to the plate ``child``."""
        message = JointTransform(child_frame_id=child)
        message.header.frame_id = parent
        example = JOINT_TRANSFORM.serialize(message)
        layout = JOINT_TRANSFORM.layout(example)
        self.row_layout = row_layout_of(TableLayout.of(example, JOINT_TRANSFORM))
        self.size = layout.size
        self._frames = example[STAMP.stop : layout["scan"].offset]
        self._unpack = layout.unpacker(("header.frame_id", "child_frame_id")).unpack_from
        self._unpacked_frames = self._unpack(example)
        self._state, self._faults = layout["state"].offset, layout["faults"].offset

    def matches(self, data: bytes) -> bool:
        """Return whether a message is a transform between these plates."""
        if len(data) < self.size:
            return False
        if data.startswith(self._frames, STAMP.stop) and data.startswith(LITTLE_ENDIAN):
            return True
        return bool(self._unpack(data) == self._unpacked_frames)  # the padding after the names is arbitrary

    def read_state(self, data: bytes) -> tuple[int, int]:
        """Return ``State`` and ``Fault`` of a message as plain numbers."""
        return data[self._state], int(_FAULTS.unpack_from(data, self._faults)[0])
