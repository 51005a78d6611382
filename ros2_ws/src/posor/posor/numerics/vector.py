"""Three-vectors and rigid motions for kernels.

Vectors are tuples of three numbers: compiled code keeps them in registers, where an array would cost an allocation.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from posor.numerics.compiled import in_place, inlined

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

SERIES_BELOW = 0.02  # squared angle [rad^2] below which the exponential map is summed as a series

Vector: TypeAlias = tuple[float, float, float]


@inlined
def square(value: float) -> float:
    """Return the square; ``**`` rounds differently where it is not compiled."""
    return value * value


@inlined
def at(array: FloatArray, start: int) -> Vector:
    """Return three consecutive entries of an array."""
    return array[start], array[start + 1], array[start + 2]


@inlined
def store(array: FloatArray, start: int, a: Vector) -> None:
    """Write a vector into three consecutive entries of an array."""
    array[start], array[start + 1], array[start + 2] = a


@inlined
def within(rows: FloatArray, r: int, start: int = 0) -> Vector:
    """Return three consecutive entries of row r; a slice of the row would cost more than the arithmetic."""
    return rows[r, start], rows[r, start + 1], rows[r, start + 2]


@inlined
def put(rows: FloatArray, r: int, start: int, a: Vector) -> None:
    """Write a vector into three consecutive entries of row r."""
    rows[r, start], rows[r, start + 1], rows[r, start + 2] = a


@inlined
def over(a: Vector, divisor: float) -> Vector:
    """Return a / divisor."""
    return a[0] / divisor, a[1] / divisor, a[2] / divisor


@inlined
def plus(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def minus(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def times(factor: float, a: Vector) -> Vector:
    """Return factor a."""
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def wrapped(angle: float) -> float:
    """Return an angle [rad] in [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


def wrapped_angles(angles: FloatArray) -> FloatArray:
    """Return angles [rad] in [-pi, pi), of any shape."""
    return np.asarray(np.mod(angles + np.pi, 2.0 * np.pi) - np.pi)


@inlined
def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@in_place
def rotated_about_z(a: Vector, angle: float) -> Vector:
    """Return a vector rotated about Z by ``angle`` [rad]."""
    if angle == 0.0:
        return a
    c, s = math.cos(angle), math.sin(angle)
    return c * a[0] - s * a[1], s * a[0] + c * a[1], a[2]


@inlined
def rotate(rotation: FloatArray, a: Vector) -> Vector:
    """Return ``rotation @ a``."""
    return dot(within(rotation, 0), a), dot(within(rotation, 1), a), dot(within(rotation, 2), a)


@inlined
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


@inlined
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


@inlined
def rotated_row(row: Vector, w: Vector, s: float, c: float) -> Vector:
    """Return a row of ``m @ exp3(w)``, which is exp(-w) applied to the row of m; s, c: exponential coefficients."""
    w_row = cross(w, row)
    return plus(row, plus(times(-s, w_row), times(c, cross(w, w_row))))


@inlined
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
def orthonormalise(rotation: FloatArray) -> None:
    """Remove accumulated rounding: one Newton step toward the nearest rotation, in place."""
    a, b, c = within(rotation, 0), within(rotation, 1), within(rotation, 2)
    ab, ac, bc = 0.5 * dot(a, b), 0.5 * dot(a, c), 0.5 * dot(b, c)
    aa, bb, cc = 1.5 - 0.5 * dot(a, a), 1.5 - 0.5 * dot(b, b), 1.5 - 0.5 * dot(c, c)
    for j in range(3):
        rotation[0, j] = aa * a[j] - ab * b[j] - ac * c[j]
        rotation[1, j] = bb * b[j] - ab * a[j] - bc * c[j]
        rotation[2, j] = cc * c[j] - ac * a[j] - bc * b[j]
