"""Joint transforms as bytes: what they are, told without reading them for the chain."""

from __future__ import annotations

import struct
from functools import lru_cache

from posor_msgs.msg import JointTransform

from posor_estimator.bulk.layout import LEAD, TableLayout
from posor_estimator.core.chain_records import JointColumns
from posor_estimator.core.kernels.stamps import time_ns
from posor_estimator.ros.cdr import STAMP, Schema
from posor_estimator.ros.cdr_walk import LITTLE_ENDIAN

JOINT_TRANSFORM = Schema.of(JointTransform)

_STAMP = struct.Struct("<iI")
_FAULTS = struct.Struct("<I")
_THETA = 5
"""Which of the native coordinates it is."""


@lru_cache(maxsize=16)
def stamp_ns_of(stamp: bytes) -> int:
    """Return a stamp as it stands in a message, ``data[STAMP]``, in nanoseconds; 0 where it is no time.

    Remembers some: the joints' messages of one scan have the same.
    """
    return time_ns(*_STAMP.unpack(stamp))


def columns_of(layout: TableLayout) -> JointColumns:
    """Return where rows of transforms have what the chain takes."""
    return JointColumns(
        pose=LEAD + layout.offset("pose.position.x"),
        theta=LEAD + layout.offset("native") + 8 * _THETA,
        covariance=LEAD + layout.offset("covariance"),
        state=LEAD + layout.offset("state"),
        size=LEAD + layout.size,
    )


class TransformKind:
    """Transforms between two plates.

    Attributes:
        size: Of such a message [bytes]; surplus bytes at its end mean nothing.
        columns: Where its row has what.

    """

    def __init__(self, parent: str, child: str) -> None:
        """Tell transforms from the plate ``parent`` to the plate ``child`` from others."""
        message = JointTransform(child_frame_id=child)
        message.header.frame_id = parent
        example = JOINT_TRANSFORM.serialize(message)
        layout = JOINT_TRANSFORM.layout(example)
        self.columns = columns_of(TableLayout.of(example, JOINT_TRANSFORM))
        self.size = layout.size
        self._usual = example[STAMP.stop : layout["scan"].offset]
        self._unpack = layout.unpacker(("header.frame_id", "child_frame_id")).unpack_from
        self._told = self._unpack(example)
        self._state, self._faults = layout["state"].offset, layout["faults"].offset

    def takes(self, data: bytes) -> bool:
        """Return whether a message is such a transform."""
        if len(data) < self.size:
            return False
        if data.startswith(self._usual, STAMP.stop) and data.startswith(LITTLE_ENDIAN):
            return True
        return bool(self._unpack(data) == self._told)  # what fills the gaps after the names may be anything

    def verdict(self, data: bytes) -> tuple[int, int]:
        """Return ``State`` and ``Fault`` of one, plain numbers."""
        return data[self._state], int(_FAULTS.unpack_from(data, self._faults)[0])
