"""3x3 matrices for kernels: tuples of three row vectors, which compiled code keeps in registers."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from posor.numerics.compiled import inlined
from posor.numerics.vector import Vector, dot, exponential_coefficients, rotated_row, within

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

Matrix: TypeAlias = tuple[Vector, Vector, Vector]


@inlined
def matrix(rows: FloatArray, r: int, start: int = 0) -> Matrix:
    """Return the matrix that begins in row r of an array, at entry ``start`` of the row."""
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
def turned_by(m: Matrix, w: Vector) -> Matrix:
    """Return ``m @ exp3(w)``, w [rad] in the axes of m."""
    s, c, _ = exponential_coefficients(dot(w, w))
    return rotated_row(m[0], w, s, c), rotated_row(m[1], w, s, c), rotated_row(m[2], w, s, c)
