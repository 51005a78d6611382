# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Three-vectors, 3x3 matrices, angles and rigid motions for kernels.

A vector is a tuple of three numbers, a matrix a tuple of three row vectors: compiled code keeps them in registers,
where an array would cost an allocation. A pose is an array (7,): x, y, z [m] and the quaternion x, y, z, w.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from posor.numerics.compiled import in_place

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

SERIES_BELOW = 0.02  # squared angle [rad^2] below which the exponential map is summed as a series

Vector: TypeAlias = tuple[float, float, float]
Matrix: TypeAlias = tuple[Vector, Vector, Vector]
ZERO_VECTOR: Vector = (0.0, 0.0, 0.0)
ZERO_MATRIX: Matrix = (ZERO_VECTOR, ZERO_VECTOR, ZERO_VECTOR)
IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@in_place
def in_double(value: float) -> float:
    """Convert float32 to float64, in compiled and in Python code."""
    return float(value) * 1.0


@in_place
def square(value: float) -> float:
    """Return the square; ``**`` rounds differently where it is not compiled."""
    return value * value


@in_place
def at(array: FloatArray, start: int) -> Vector:
    """Return three consecutive entries of an array."""
    return array[start], array[start + 1], array[start + 2]


@in_place
def store(array: FloatArray, start: int, a: Vector) -> None:
    """Write a vector into three consecutive entries of an array."""
    array[start], array[start + 1], array[start + 2] = a


@in_place
def within(rows: FloatArray, r: int, start: int = 0) -> Vector:
    """Return three consecutive entries of row r; a slice of the row would cost more than the arithmetic."""
    return rows[r, start], rows[r, start + 1], rows[r, start + 2]


@in_place
def put(rows: FloatArray, r: int, start: int, a: Vector) -> None:
    """Write a vector into three consecutive entries of row r."""
    rows[r, start], rows[r, start + 1], rows[r, start + 2] = a


@in_place
def over(a: Vector, divisor: float) -> Vector:
    """Return a / divisor."""
    return a[0] / divisor, a[1] / divisor, a[2] / divisor


@in_place
def plus(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@in_place
def minus(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@in_place
def times(factor: float, a: Vector) -> Vector:
    """Return factor a."""
    return factor * a[0], factor * a[1], factor * a[2]


@in_place
def wrapped(angle: float) -> float:
    """Return an angle [rad] in [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


def wrapped_angles(angles: FloatArray) -> FloatArray:
    """Return angles [rad] in [-pi, pi), of any shape."""
    return np.asarray(np.mod(angles + np.pi, 2.0 * np.pi) - np.pi)


def theta_of(rotation: FloatArray) -> float:
    """Return theta [rad] of ``R_R_T``, in (-pi, pi]."""
    return math.atan2(-rotation[0, 1], rotation[1, 1])


theta_in_kernel = in_place(theta_of)  # the same, for kernels


def thetas_of(rotations: FloatArray) -> FloatArray:
    """Return theta [rad] of each ``R_R_T``, shape (n, 3, 3), in (-pi, pi], shape (n,)."""
    return np.asarray(np.arctan2(-rotations[:, 0, 1], rotations[:, 1, 1]))


@in_place
def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@in_place
def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@in_place
def matrix(rows: FloatArray, r: int, start: int = 0) -> Matrix:
    """Return the matrix that begins in row r of an array, at entry ``start`` of the row."""
    return within(rows, r, start), within(rows, r + 1, start), within(rows, r + 2, start)


@in_place
def transposed(m: Matrix) -> Matrix:
    """Return the transpose."""
    a, b, c = m
    return (a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2])


@in_place
def applied(m: Matrix, v: Vector) -> Vector:
    """Return ``m @ v``."""
    return dot(m[0], v), dot(m[1], v), dot(m[2], v)


@in_place
def row_times(v: Vector, m: Matrix) -> Vector:
    """Return ``v @ m``."""
    a, b, c = v
    return (
        a * m[0][0] + b * m[1][0] + c * m[2][0],
        a * m[0][1] + b * m[1][1] + c * m[2][1],
        a * m[0][2] + b * m[1][2] + c * m[2][2],
    )


@in_place
def product(m: Matrix, n: Matrix) -> Matrix:
    """Return ``m @ n``."""
    return row_times(m[0], n), row_times(m[1], n), row_times(m[2], n)


@in_place
def rotated_about_z(a: Vector, angle: float) -> Vector:
    """Return a vector rotated about Z by ``angle`` [rad]."""
    if angle == 0.0:
        return a
    c, s = math.cos(angle), math.sin(angle)
    return c * a[0] - s * a[1], s * a[0] + c * a[1], a[2]


@in_place
def rotate(rotation: FloatArray, a: Vector) -> Vector:
    """Return ``rotation @ a``."""
    return dot(within(rotation, 0), a), dot(within(rotation, 1), a), dot(within(rotation, 2), a)


@in_place
def rotate_back(rotation: FloatArray, a: Vector) -> Vector:
    """Return ``rotation.T @ a``."""
    return (
        rotation[0, 0] * a[0] + rotation[1, 0] * a[1] + rotation[2, 0] * a[2],
        rotation[0, 1] * a[0] + rotation[1, 1] * a[1] + rotation[2, 1] * a[2],
        rotation[0, 2] * a[0] + rotation[1, 2] * a[1] + rotation[2, 2] * a[2],
    )


@in_place
def apply_tangent(rotation: FloatArray, translation: FloatArray, step: FloatArray) -> None:
    """Replace the pose by ``pose * exp6(step)`` in place; ``step`` (6,) in the axes of T, translation first."""
    move(rotation, translation, at(step, 0), at(step, 3))


@in_place
def move(rotation: FloatArray, translation: FloatArray, v: Vector, w: Vector) -> None:
    """Replace the pose by ``pose * exp6(v, w)`` in place, v [m] and w [rad] in the axes of T.

    The same map as ``pinocchio.exp6`` (checked in the tests).
    """
    s, c, d = exponential_coefficients(dot(w, w))
    w_v = cross(w, v)
    shift = rotate(rotation, plus(v, plus(times(c, w_v), times(d, cross(w, w_v)))))
    for i in range(3):
        translation[i] += shift[i]
        put(rotation, i, 0, rotated_row(within(rotation, i), w, s, c))


@in_place
def rotated_row(row: Vector, w: Vector, s: float, c: float) -> Vector:
    """Return a row of ``m @ exp3(w)``, which is exp(-w) applied to the row of m; s, c: exponential coefficients."""
    w_row = cross(w, row)
    return plus(row, plus(times(-s, w_row), times(c, cross(w, w_row))))


@in_place
def exponential_coefficients(x: float) -> Vector:
    """Return sin a / a, (1 - cos a) / a^2 and (a - sin a) / a^3 of an angle a with square x."""
    if x < SERIES_BELOW:
        # One minus a cosine would cancel digits; the omitted terms are below 1e-18.
        s = 1.0 - x / 6.0 * (1.0 - x / 20.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0)))
        c = 0.5 * (1.0 - x / 12.0 * (1.0 - x / 30.0 * (1.0 - x / 56.0 * (1.0 - x / 90.0))))
        return s, c, (1.0 - x / 20.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0 * (1.0 - x / 110.0)))) / 6.0
    if not x < math.inf:
        return math.nan, math.nan, math.nan  # uncompiled, math.sin would raise
    angle = math.sqrt(x)
    s = math.sin(angle) / angle
    return s, (1.0 - math.cos(angle)) / x, (1.0 - s) / x


@in_place
def turned_by(m: Matrix, w: Vector) -> Matrix:
    """Return ``m @ exp3(w)``, w [rad] in the axes of m."""
    s, c, _ = exponential_coefficients(dot(w, w))
    return rotated_row(m[0], w, s, c), rotated_row(m[1], w, s, c), rotated_row(m[2], w, s, c)


@in_place
def orthonormalise(rotation: FloatArray) -> None:
    """Remove accumulated rounding: one Newton step toward the nearest rotation, in place."""
    a, b, c = within(rotation, 0), within(rotation, 1), within(rotation, 2)
    ab, ac, bc = 0.5 * dot(a, b), 0.5 * dot(a, c), 0.5 * dot(b, c)
    aa, bb, cc = 1.5 - 0.5 * dot(a, a), 1.5 - 0.5 * dot(b, b), 1.5 - 0.5 * dot(c, c)
    for j in range(3):
        rotation[0, j] = aa * a[j] - ab * b[j] - ac * c[j]
        rotation[1, j] = bb * b[j] - ab * a[j] - bc * c[j]
        rotation[2, j] = cc * c[j] - ac * a[j] - bc * b[j]


@in_place
def rotation_of_pose(pose: FloatArray) -> Matrix:
    """Return the rotation of a pose (7,), whose quaternion may have any length but zero."""
    x, y, z, w = pose[3], pose[4], pose[5], pose[6]
    scale = 2.0 / (x * x + y * y + z * z + w * w)
    return (
        (1.0 - scale * (y * y + z * z), scale * (x * y - w * z), scale * (x * z + w * y)),
        (scale * (x * y + w * z), 1.0 - scale * (x * x + z * z), scale * (y * z - w * x)),
        (scale * (x * z - w * y), scale * (y * z + w * x), 1.0 - scale * (x * x + y * y)),
    )


@in_place
def write_pose(rotation: Matrix, translation: Vector, pose: FloatArray) -> None:
    """Write a transform as a pose (7,) with a unit quaternion, whose sign is that of ``pinocchio.SE3ToXYZQUAT``."""
    for i in range(3):
        pose[i] = translation[i]
    trace = rotation[0][0] + (rotation[1][1] + rotation[2][2])  # pinocchio's order of summation: same last bit
    if trace > 0.0:
        root = math.sqrt(trace + 1.0)
        pose[6] = 0.5 * root
        root = 0.5 / root
        pose[3] = (rotation[2][1] - rotation[1][2]) * root
        pose[4] = (rotation[0][2] - rotation[2][0]) * root
        pose[5] = (rotation[1][0] - rotation[0][1]) * root
        return
    i = 0
    if rotation[1][1] > rotation[0][0]:
        i = 1
    if rotation[2][2] > rotation[i][i]:
        i = 2
    j, k = (i + 1) % 3, (i + 2) % 3
    root = math.sqrt(rotation[i][i] - rotation[j][j] - rotation[k][k] + 1.0)
    pose[3 + i] = 0.5 * root
    root = 0.5 / root
    pose[6] = (rotation[k][j] - rotation[j][k]) * root
    pose[3 + j] = (rotation[j][i] + rotation[i][j]) * root
    pose[3 + k] = (rotation[k][i] + rotation[i][k]) * root
