"""Measurements of the joints as the chain takes them: one by name, many in arrays, or as rows of message bytes."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from posor_estimator.numerics.compiled import in_place, inlined

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pinocchio as pin

    from posor_estimator.numerics.array_types import ByteArray, FloatArray, IntArray

RecordArray: TypeAlias = NDArray[np.void]

POSE_NOT_FINITE, QUATERNION_NOT_UNIT, COVARIANCE_NOT_FINITE = 1, 2, 3
FAULT_TEXTS = {
    POSE_NOT_FINITE: "has a pose that is not finite",
    QUATERNION_NOT_UNIT: "has an orientation that is not a unit quaternion",
    COVARIANCE_NOT_FINITE: "has a covariance that is not finite",
}
"""Why a joint's measurement cannot be used, by the result of ``measurement_fault``."""
UNIT_QUATERNION_TOLERANCE = 1e-6
"""Largest difference of a quaternion's length from one."""
LARGEST_FLOAT = sys.float_info.max

ROW_LAYOUT = np.dtype([("pose", np.int64), ("theta", np.int64), ("covariance", np.int64), ("state", np.int64)])
"""Where a row of message bytes holds its fields: indices of 8-byte numbers, and of the byte ``state``."""


@dataclass(frozen=True)
class MeasuredJoint:
    """Measurement of one POSOR.

    Attributes:
        T_parent_child: Pose of the target plate in the receiving plate.
        covariance: (6, 6) of x, y, z [m], about X, Y, Z [rad], axes of the parent (as ``posor_msgs/JointTransform``).

    """

    T_parent_child: pin.SE3
    covariance: FloatArray


class JointMeasurements(NamedTuple):
    """Measurements of all j joints in n scans.

    Attributes:
        stamps_ns: Times of the scans, (n,).
        poses: Target plate in receiving plate, (n, j, 7): x, y, z [m], unit quaternion x, y, z, w.
        covariances: As ``MeasuredJoint.covariance``, (n, j, 6, 6); only the upper triangle is read.
        thetas: Counted large rotations [rad], (n, j); NaN: not counted.

    """

    stamps_ns: IntArray
    poses: FloatArray
    covariances: FloatArray
    thetas: FloatArray

    @classmethod
    def allocate(cls, scans: int, joints: int) -> JointMeasurements:
        """Return measurements at the identity, without covariance and without a counted theta."""
        poses = np.zeros((scans, joints, 7))
        poses[..., 6] = 1.0
        return cls(
            np.zeros(scans, dtype=np.int64), poses, np.zeros((scans, joints, 6, 6)), np.full((scans, joints), np.nan)
        )


@dataclass(frozen=True)
class JointRowLayout:
    """Byte offsets of the fields of a serialised joint measurement.

    Attributes:
        pose: x, y, z [m] and the quaternion x, y, z, w, each a float of 8 bytes; a multiple of 8.
        theta: Counted large rotation [rad], likewise.
        covariance: 36 numbers, row by row, likewise.
        state: ``State``, one byte.
        size: Length of the row.

    """

    pose: int
    theta: int
    covariance: int
    state: int
    size: int

    @property
    def record(self) -> RecordArray:
        """The layout for the kernels, (1,) of ``ROW_LAYOUT``.

        Raises:
            ValueError: The offset of a number is not a multiple of 8.

        """
        if any(offset % 8 for offset in (self.pose, self.theta, self.covariance)):
            message = f"{self}: expected offsets of numbers that are multiples of 8"
            raise ValueError(message)
        return np.array([(self.pose // 8, self.theta // 8, self.covariance // 8, self.state)], dtype=ROW_LAYOUT)


class JointRows(NamedTuple):
    """Serialised measurements of one scan, one row for each joint.

    Attributes:
        layouts: Where each row holds its fields, (j,) of ``ROW_LAYOUT``.
        numbers: The rows as 8-byte floats, (j, w).
        octets: The same memory as bytes, (j, 8 w).

    """

    layouts: RecordArray
    numbers: FloatArray
    octets: ByteArray

    @classmethod
    def allocate(cls, layouts: Sequence[JointRowLayout]) -> JointRows:
        """Return empty rows of joints with these layouts."""
        numbers = np.zeros((len(layouts), max((-(-layout.size // 8) for layout in layouts), default=0)))
        records = [layout.record for layout in layouts]
        return cls(np.concatenate(records) if records else np.empty(0, ROW_LAYOUT), numbers, numbers.view(np.uint8))


@inlined
def measurement_fault(pose: FloatArray, covariance: FloatArray) -> int:
    """Return what is wrong with a pose (7,) or covariance (6, 6): a key of ``FAULT_TEXTS``, or zero."""
    for i in range(7):
        if not math.isfinite(pose[i]):
            return POSE_NOT_FINITE
    length = math.sqrt(pose[3] * pose[3] + pose[4] * pose[4] + pose[5] * pose[5] + pose[6] * pose[6])
    if abs(length - 1.0) > UNIT_QUATERNION_TOLERANCE:
        return QUATERNION_NOT_UNIT
    finite = True
    for i in range(6):
        for j in range(6):
            finite &= abs(covariance[i, j]) <= LARGEST_FLOAT  # no early exit: the compiler vectorises the loop
    return 0 if finite else COVARIANCE_NOT_FINITE


@inlined
def read_row(layouts: RecordArray, joint: int, numbers: FloatArray, pose: FloatArray, covariance: FloatArray) -> float:
    """Copy a row of numbers (w,) into ``pose`` (7,) and ``covariance`` (6, 6); return theta."""
    layout = layouts[joint]
    first_of_pose, first_of_covariance = layout["pose"], layout["covariance"]
    for k in range(7):
        pose[k] = numbers[first_of_pose + k]
    entries = numbers[first_of_covariance : first_of_covariance + 36]
    for i in range(6):
        for k in range(6):
            covariance[i, k] = entries[6 * i + k]
    return float(numbers[layout["theta"]])


@in_place
def _read_rows(layout: RecordArray, numbers: FloatArray, joint: int, measurements: JointMeasurements) -> None:
    """Read the rows (n, w) of one joint in n scans."""
    for n in range(numbers.shape[0]):
        measurements.thetas[n, joint] = read_row(
            layout, 0, numbers[n], measurements.poses[n, joint], measurements.covariances[n, joint]
        )


def read_rows(rows: ByteArray, layout: JointRowLayout, joint: int, measurements: JointMeasurements) -> None:
    """Copy serialised measurements (n, bytes) of one joint in n scans into ``measurements``."""
    _read_rows(layout.record, rows.view(np.float64), joint, measurements)
