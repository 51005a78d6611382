"""Joint transforms as bytes: written from the estimator's results, and read for the chain."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from math import nan
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from posor_msgs.msg import JointTransform

from posor_estimator.core.fault import Fault, State
from posor_estimator.ros.cdr import NS, Schema
from posor_estimator.ros.cdr_walk import LITTLE_ENDIAN
from posor_estimator.ros.cdr_writer import MessageWriter
from posor_estimator.ros.messages import COVARIANCE_KINDS

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray
    from posor_estimator.ros.messages import CovarianceKind

JOINT_TRANSFORM = Schema.of(JointTransform)
POSE = 7
COVARIANCE = 36

_NUMBER = struct.Struct("<Q")
_VERDICT = struct.Struct("<dBB2xII")
"""Residual, redundancy, state, faults and the scan's status, which follow one another."""
_THETA = 10
"""Where the last of the native coordinates stands among what is unpacked."""


class Results(Protocol):
    """What is written of a scan; the arrays stay the same from scan to scan. ``core.lane.Lane`` is one."""

    pose: FloatArray
    native: FloatArray
    random: FloatArray
    systematic: FloatArray
    residual: float
    redundancy: int
    state: int
    faults: int


@dataclass
class Lost:
    """Results of scans that never come to an estimate: no number, and a fault."""

    pose: FloatArray = field(default_factory=lambda: np.full(7, nan))
    native: FloatArray = field(default_factory=lambda: np.full(6, nan))
    random: FloatArray = field(default_factory=lambda: np.full((6, 6), nan))
    systematic: FloatArray = field(default_factory=lambda: np.full((6, 6), nan))
    residual: float = nan
    redundancy: int = 0
    state: int = int(State.LOST)
    faults: int = int(Fault.BAD_READING)


class TransformWriter:
    """Writes results as joint transforms."""

    def __init__(self, parent: str, child: str, kind: CovarianceKind, results: Results) -> None:
        """Prepare.

        Args:
            parent: Frame of the receiving plate.
            child: Frame of the target plate.
            kind: Which part of the covariance to write.
            results: What is written, as it is at that time.

        """
        prototype = JointTransform(child_frame_id=child, covariance_kind=COVARIANCE_KINDS[kind])
        prototype.header.frame_id = parent
        arrays = {"pose.position.x": results.pose, "native": results.native}
        if kind != "total":
            arrays["covariance"] = results.random if kind == "random" else results.systematic
        self._writer = MessageWriter(prototype, arrays)
        self._total = self._writer.view("covariance", COVARIANCE).reshape(6, 6) if kind == "total" else None
        self._results = results
        self._number = self._writer.layout["scan"].offset
        self._verdict = self._writer.layout["residual"].offset

    def write(self, stamp: bytes, number: int, scan_status: int) -> bytes:
        """Return the transform that the present results make.

        Args:
            stamp: Of the scan, in the eight bytes in which it came.
            number: Of the scan.
            scan_status: Its status flags.

        """
        results, writer = self._results, self._writer
        if self._total is not None:
            np.add(results.random, results.systematic, out=self._total)
        _NUMBER.pack_into(writer.bytes, self._number, number)
        _VERDICT.pack_into(
            writer.bytes,
            self._verdict,
            results.residual,
            results.redundancy,
            results.state,
            results.faults,
            scan_status,
        )
        return writer.write(stamp)


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
