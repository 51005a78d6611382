# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Joint measurements: ``MeasuredJoint`` for one joint, ``JointMeasurements`` for n scans, ``JointRows`` as bytes."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from posor.estimation.fault_model import EFFECT
from posor.numerics.compiled import in_place
from posor.numerics.vector import rotation_of_pose

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pinocchio as pin

    from posor.numerics.array_types import ByteArray, FloatArray, IntArray

RecordArray: TypeAlias = NDArray[np.void]

MAX_OFFSET = 0.02
"""Largest distance of a target plate's origin from the nominal joint in the URDF [m]; a POSOR measures millimetres."""
MAX_VARIANCE = 100.0  # largest variance [m^2], [rad^2]; a greater one is useless and may overflow along the arm
POSE_NOT_FINITE, QUATERNION_NOT_UNIT, COVARIANCE_NOT_FINITE, NATIVE_DISAGREES, POSE_TOO_FAR = 1, 2, 3, 4, 5
VARIANCE_TOO_LARGE, COVARIANCE_NOT_SYMMETRIC, COVARIANCE_NOT_POSITIVE, ENDPOINT_NOT_FINITE = 6, 7, 8, 9
SHARED_TOO_LARGE, STAMP_SHIFT_INVALID, COVARIANCE_ZERO = 10, 11, 12
FAULT_TEXTS = {  # why a joint's measurement cannot be used, by its fault in ``Endpoints.faults``
    POSE_NOT_FINITE: "has a pose that is not finite",
    QUATERNION_NOT_UNIT: "has an orientation that is not a unit quaternion",
    COVARIANCE_NOT_FINITE: "has a covariance that is not finite",
    NATIVE_DISAGREES: "has native coordinates that are not finite or do not agree with its pose",
    POSE_TOO_FAR: f"is further than {MAX_OFFSET:g} m from the nominal joint of the URDF",
    VARIANCE_TOO_LARGE: f"has a variance above {MAX_VARIANCE:g} m^2 or rad^2",
    COVARIANCE_NOT_SYMMETRIC: "has a covariance that is not symmetric",
    COVARIANCE_NOT_POSITIVE: "has a covariance that is not positive semi-definite",
    ENDPOINT_NOT_FINITE: "gives an endpoint that is not finite",
    SHARED_TOO_LARGE: "has effects of shared terms that exceed its systematic covariance",
    STAMP_SHIFT_INVALID: "has a stamp shift that is negative or not a number",
    COVARIANCE_ZERO: "has covariances of zeros, which mean unknown",
}
UNIT_QUATERNION_TOLERANCE = 1e-6  # largest difference of a quaternion's length from one
NATIVE_TOLERANCE = 1e-8  # largest difference of native angles from the pose [rad]; x, y and gap are equal
SYMMETRY_TOLERANCE = 1e-6  # largest difference of opposite covariances, relative to both standard deviations
PIVOT_TOLERANCE = 1e-9  # part of a variance that counts as rounding in the test for a positive semi-definite covariance
LARGEST_FLOAT = sys.float_info.max

ROW_LAYOUT = np.dtype(
    [
        (name, np.int64)
        for name in (
            "pose",
            "native",
            "covariance_random",
            "covariance_systematic",
            "shared",
            "effects",
            "stamp_shift",
            "state",
            "effect_count",
        )
    ]
)
"""Where a row of message bytes holds its fields: indices of 8-byte numbers, ``effects`` of 4-byte ones, ``state`` of a
byte; and the number of fault effects."""
VIBRATION = np.dtype(
    [
        ("mean", float, 3),
        ("difference", float, 3),
        ("sigma_mean", float),
        ("sigma_difference", float),
        ("bounded", np.int64),
    ]
)
"""Specific force that bends a beam, axes of its start [m/s^2]: at its centre, and its increase from start to end (NaN:
that of a beam at rest); standard uncertainties of both; 1, or 0 where protection levels are not bounded."""
BYTES_PER_INDEX = {"effects": 4, "state": 1, "effect_count": 1}  # of a field of ``ROW_LAYOUT``; of the others 8


@dataclass(frozen=True)
class MeasuredJoint:
    """Measurement of one POSOR."""

    T_parent_child: pin.SE3  # pose of the target plate in the receiving plate
    # White from scan to scan, (6, 6) of x, y, z [m], about X, Y, Z [rad], axes of the parent (as
    # ``posor_msgs/JointTransform``)
    covariance_random: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    # The same, common to all scans of one calibration
    covariance_systematic: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    # Change of the pose by one standard uncertainty of each shared term, by name, (6,); its square is in the systematic
    # covariance
    shared_effects: Mapping[str, FloatArray] = field(default_factory=dict)


class JointMeasurements(NamedTuple):
    """Measurements of all j joints in n scans."""

    stamps_ns: IntArray  # times of the scans, (n,)
    poses: FloatArray  # target plate in receiving plate, (n, j, 7): x, y, z [m], unit quaternion x, y, z, w
    covariances_random: FloatArray  # as ``MeasuredJoint.covariance_random``, (n, j, 6, 6)
    covariances_systematic: FloatArray  # as ``MeasuredJoint.covariance_systematic``, (n, j, 6, 6)
    thetas: FloatArray  # counted large rotations [rad], (n, j); NaN: not counted; infinite: the row is invalid
    shared_effects: FloatArray  # as ``MeasuredJoint.shared_effects``, (n, j, T, 6), see ``ArmGeometry.joint_terms``
    stamp_shifts: FloatArray  # as ``posor_msgs/JointTransform.stamp_shift``, (n, j, 6) [m], [rad]
    # As ``estimation.fault_effects``, C of a joint at most, (n, j, C, EFFECT), floats of 4 bytes; NaN: not known
    fault_effects: NDArray[np.float32]
    vibrations: RecordArray  # of the beams, (n, b) of ``VIBRATION``; (n, 0): no beam states its vibration

    @classmethod
    def allocate(cls, scans: int, joints: int, terms: int = 0, effects: int = 0) -> JointMeasurements:
        """Return measurements at the identity, without covariances and without a counted theta."""
        poses = np.zeros((scans, joints, 7))
        poses[..., 6] = 1.0
        random, systematic = np.zeros((2, scans, joints, 6, 6))
        thetas, shared = np.full((scans, joints), np.nan), np.zeros((scans, joints, terms, 6))
        shifts = np.zeros((scans, joints, 6))
        faults = np.full((scans, joints, effects, EFFECT), np.nan, dtype=np.float32)
        stamps, vibrations = np.zeros(scans, dtype=np.int64), np.zeros((scans, 0), dtype=VIBRATION)
        return cls(stamps, poses, random, systematic, thetas, shared, shifts, faults, vibrations)


@dataclass(frozen=True)
class JointRowLayout:
    """Byte offsets of the fields of a serialised joint measurement."""

    pose: int  # x, y, z [m] and the quaternion x, y, z, w, each a float of 8 bytes; a multiple of 8
    native: int  # six native coordinates, of which the counted large rotation [rad] is the last, likewise
    covariance_random: int  # 36 numbers, row by row, likewise
    covariance_systematic: int  # the same
    shared: int  # six numbers for each shared term, likewise
    effects: int  # EFFECT numbers for each fault effect, floats of 4 bytes; a multiple of 4
    stamp_shift: int  # six numbers, likewise
    state: int  # ``State``, one byte
    size: int  # length of the row
    effect_count: int = 0  # number of fault effects

    @property
    def record(self) -> RecordArray:
        """The layout for the kernels, (1,) of ``ROW_LAYOUT``.

        Raises ValueError: the offset of a number is not a multiple of its size.
        """
        covariances = self.covariance_random, self.covariance_systematic
        numbers = self.pose, self.native, *covariances, self.shared, self.stamp_shift
        if any(offset % 8 for offset in numbers) or self.effects % 4:
            message = f"{self}: expected offsets of numbers that are multiples of their sizes"
            raise ValueError(message)
        record = np.zeros(1, dtype=ROW_LAYOUT)
        for name in ROW_LAYOUT.names or ():
            record[name] = getattr(self, name) // BYTES_PER_INDEX.get(name, 8)
        return record


class JointRows(NamedTuple):
    """Serialised measurements of one scan, one row for each joint."""

    layouts: RecordArray  # where each row holds its fields, (j,) of ``ROW_LAYOUT``
    numbers: FloatArray  # the rows as 8-byte floats, (j, w)
    octets: ByteArray  # the same memory as bytes, (j, 8 w)
    singles: NDArray[np.float32]  # the same memory as floats of 4 bytes, (j, 2 w)
    missing: IntArray  # rows that ``copy_transform`` did not write, (1,); the estimate of the endpoint resets it

    @classmethod
    def allocate(cls, layouts: Sequence[JointRowLayout]) -> JointRows:
        """Return empty rows of joints with these layouts."""
        numbers = np.zeros((len(layouts), max((-(-layout.size // 8) for layout in layouts), default=0)))
        records = [layout.record for layout in layouts]
        layout = np.concatenate(records) if records else np.empty(0, ROW_LAYOUT)
        missing = np.zeros(1, dtype=np.int64)
        return cls(layout, numbers, numbers.view(np.uint8), numbers.view(np.float32), missing)


@in_place
def covariance_fault(covariance: FloatArray, scratch: FloatArray) -> int:
    """Return what is wrong with a covariance (6, 6): a key of ``FAULT_TEXTS``, or zero. Writes ``scratch``, (6, 6)."""
    finite = small = True
    for i in range(6):
        for j in range(6):
            finite &= abs(covariance[i, j]) <= LARGEST_FLOAT  # no early exit: the compiler vectorises the loop
        small &= abs(covariance[i, i]) <= MAX_VARIANCE
    if not (finite and small):
        return VARIANCE_TOO_LARGE if finite else COVARIANCE_NOT_FINITE
    symmetric = True
    for i in range(6):
        for j in range(i):
            difference, product = covariance[i, j] - covariance[j, i], covariance[i, i] * covariance[j, j]
            symmetric &= difference * difference <= SYMMETRY_TOLERANCE * SYMMETRY_TOLERANCE * abs(product)
    if not symmetric:
        return COVARIANCE_NOT_SYMMETRIC
    return 0 if is_positive_semidefinite(covariance, scratch) else COVARIANCE_NOT_POSITIVE


@in_place
def is_positive_semidefinite(covariance: FloatArray, scratch: FloatArray) -> bool:
    """Return whether a symmetric matrix (6, 6) of small numbers is positive semi-definite, but for rounding.

    It is factorised as L D L^T: ``scratch`` (6, 6) gets L below the diagonal and (L D)^T above. A pivot near zero must
    belong to a column of zeros.
    """
    positive = True
    for j in range(6):
        pivot, tolerance = covariance[j, j], PIVOT_TOLERANCE * covariance[j, j]
        for k in range(j):
            pivot -= scratch[j, k] * scratch[k, j]
        positive &= pivot >= -tolerance and tolerance >= 0.0
        inverse = 1.0 / pivot if pivot > tolerance else 0.0
        for i in range(j + 1, 6):
            rest = covariance[j, i]
            for k in range(j):
                rest -= scratch[i, k] * scratch[k, j]
            limit = 4.0 * PIVOT_TOLERANCE * abs(covariance[i, i] * covariance[j, j])
            positive &= inverse > 0.0 or rest * rest <= limit
            scratch[i, j], scratch[j, i] = rest * inverse, rest
    return positive


@in_place
def measurement_fault(
    pose: FloatArray, random: FloatArray, systematic: FloatArray, theta: float, origin: FloatArray, scratch: FloatArray
) -> int:
    """Return what is wrong with the measurement of a joint: a key of ``FAULT_TEXTS``, or zero.

    ``pose``: target plate in receiving plate, (7,); ``random``, ``systematic``: its covariances, (6, 6); ``theta``: as
    in ``JointMeasurements.thetas``; ``origin``: of the nominal joint in the receiving plate [m], (3,); ``scratch``:
    (6, 6), is written.
    """
    for i in range(7):
        if not math.isfinite(pose[i]):
            return POSE_NOT_FINITE
    length = math.sqrt(pose[3] * pose[3] + pose[4] * pose[4] + pose[5] * pose[5] + pose[6] * pose[6])
    if not abs(length - 1.0) <= UNIT_QUATERNION_TOLERANCE:
        return QUATERNION_NOT_UNIT
    x, y, z = pose[0] - origin[0], pose[1] - origin[1], pose[2] - origin[2]
    if not x * x + y * y + z * z <= MAX_OFFSET * MAX_OFFSET:
        return POSE_TOO_FAR
    if math.isinf(theta):
        return NATIVE_DISAGREES if theta > 0.0 else COVARIANCE_ZERO
    return covariance_fault(random, scratch) or covariance_fault(systematic, scratch)


@in_place
def shared_fault(shared: FloatArray, systematic: FloatArray) -> int:
    """Return a key of ``FAULT_TEXTS`` where effects of shared terms (T, 6) are not part of a covariance; else zero."""
    for i in range(6):
        total = 0.0
        for t in range(shared.shape[0]):
            total += shared[t, i] * shared[t, i]
        if not total <= systematic[i, i] * (1.0 + PIVOT_TOLERANCE):
            return SHARED_TOO_LARGE
    return 0


@in_place
def stamp_shift_fault(shift: FloatArray) -> int:
    """Return what is wrong with a stamp shift (6,): a key of ``FAULT_TEXTS``, or zero."""
    valid = True
    for i in range(6):
        valid &= shift[i] >= 0.0
    return 0 if valid else STAMP_SHIFT_INVALID


@in_place
def native_agrees(native: FloatArray, pose: FloatArray) -> bool:
    """Return whether native coordinates (6,) are finite and those of a pose (7,) (``model.native_coordinates``)."""
    rotation = rotation_of_pose(pose)
    alpha, beta, theta = native[3], native[4], native[5]
    off_beta = math.cos(beta) * rotation[0][2] - math.sin(beta) * rotation[2][2]
    off_theta = math.cos(theta) * rotation[0][1] + math.sin(theta) * rotation[1][1]
    largest = max(abs(math.sin(alpha) + rotation[1][2]), abs(off_beta), abs(off_theta))
    same = largest <= NATIVE_TOLERANCE and math.cos(theta) * rotation[1][1] >= math.sin(theta) * rotation[0][1]
    for k in range(3):
        same &= native[k] == pose[k]
        same &= abs(native[3 + k]) <= LARGEST_FLOAT
    return same


@in_place
def read_row(
    layouts: RecordArray,
    joint: int,
    numbers: FloatArray,
    pose: FloatArray,
    random: FloatArray,
    systematic: FloatArray,
    shift: FloatArray,
) -> float:
    """Copy a row of numbers (w,) into ``pose`` (7,), into both covariances, (6, 6), and into the stamp shift, (6,).

    Return theta; infinite where the native coordinates do not agree with the pose, minus infinity where both
    covariances are zero.
    """
    layout = layouts[joint]
    first_of_pose, first_of_native = layout["pose"], layout["native"]
    first_of_random, first_of_systematic = layout["covariance_random"], layout["covariance_systematic"]
    for k in range(7):
        pose[k] = numbers[first_of_pose + k]
    random_entries = numbers[first_of_random : first_of_random + 36]
    systematic_entries = numbers[first_of_systematic : first_of_systematic + 36]
    for i in range(6):
        for k in range(6):
            random[i, k] = random_entries[6 * i + k]
            systematic[i, k] = systematic_entries[6 * i + k]
        shift[i] = numbers[layout["stamp_shift"] + i]
    is_zero = True
    for i in range(6):
        is_zero &= random[i, i] == 0.0 and systematic[i, i] == 0.0
    if is_zero:
        return -math.inf
    native = numbers[first_of_native : first_of_native + 6]
    return float(native[5]) if native_agrees(native, pose) else math.inf


@in_place
def read_joint(measurements: JointMeasurements, rows: JointRows, joint: int, terms: IntArray) -> None:
    """Read the measurement of a joint from its row, but for its fault effects.

    ``terms``: as ``ArmGeometry.joint_terms``.
    """
    measurements.thetas[0, joint] = read_row(
        rows.layouts,
        joint,
        rows.numbers[joint],
        measurements.poses[0, joint],
        measurements.covariances_random[0, joint],
        measurements.covariances_systematic[0, joint],
        measurements.stamp_shifts[0, joint],
    )
    shared, first = measurements.shared_effects[0, joint], rows.layouts[joint]["shared"]
    for t in range(shared.shape[0]):
        for i in range(6):
            shared[t, i] = rows.numbers[joint, first + 6 * t + i] if terms[joint, t] >= 0 else 0.0
