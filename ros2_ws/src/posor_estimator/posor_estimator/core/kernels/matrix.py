"""Matrices of three by three for the kernels: three rows, as vectors, which compiled live in registers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

from posor_estimator.core.compiled import inlined
from posor_estimator.core.kernels.vector import SERIES_BELOW, Vector, cross, dot, plus, times, within

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray

Matrix: TypeAlias = tuple[Vector, Vector, Vector]


@inlined
def matrix(rows: FloatArray, r: int, start: int = 0) -> Matrix:
    """Return a matrix that begins in row r of an array, at an entry of it."""
    return within(rows, r, start), within(rows, r + 1, start), within(rows, r + 2, start)


@inlined
def transposed(m: Matrix) -> Matrix:
    """Return the transpose."""
    a, b, c = m
    return (a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2])


@inlined
def applied(m: Matrix, v: Vector) -> Vector:
    """Return ``m @ v``."""
    return dot(m[0], v), dot(m[1], v), dot(m[2], v)


@inlined
def row_times(v: Vector, m: Matrix) -> Vector:
    """Return ``v @ m``."""
    a, b, c = v
    return (
        a * m[0][0] + b * m[1][0] + c * m[2][0],
        a * m[0][1] + b * m[1][1] + c * m[2][1],
        a * m[0][2] + b * m[1][2] + c * m[2][2],
    )


@inlined
def product(m: Matrix, n: Matrix) -> Matrix:
    """Return ``m @ n``."""
    return row_times(m[0], n), row_times(m[1], n), row_times(m[2], n)


@inlined
def turned_row(row: Vector, w: Vector, s: float, c: float) -> Vector:
    """Return a row of ``m @ exp3(w)``: exp(-w) applied to that of m; s and c are those of ``turned_by``."""
    w_row = cross(w, row)
    return plus(row, plus(times(-s, w_row), times(c, cross(w, w_row))))


@inlined
def turned_by(m: Matrix, w: Vector) -> Matrix:
    """Return ``m @ exp3(w)``, w [rad] in the axes of m: what ``apply_tangent`` does where nothing is shifted."""
    x = dot(w, w)
    if x < SERIES_BELOW:
        s = 1.0 - x / 6.0 * (1.0 - x / 20.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0)))
        c = 0.5 * (1.0 - x / 12.0 * (1.0 - x / 30.0 * (1.0 - x / 56.0 * (1.0 - x / 90.0))))
    else:
        angle = math.sqrt(x)
        s = math.sin(angle) / angle
        c = (1.0 - math.cos(angle)) / x
    return turned_row(m[0], w, s, c), turned_row(m[1], w, s, c), turned_row(m[2], w, s, c)
