"""Numbers on their way into the rows of transforms and out of them, compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.locate import NATIVE, POSE, RESIDUAL

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray


@compiled
def write_numbers(
    row: FloatArray, columns: IntArray, figures: FloatArray, one: FloatArray, other: FloatArray, out: FloatArray
) -> None:
    """Write transforms: what is the same in all of them, poses, native coordinates, residuals and covariances.

    Args:
        row: What is the same, shape (w,).
        columns: Where in a row pose, native coordinates, residual and covariance begin.
        figures: Of the estimates, see ``Estimates``, shape (n, 14).
        one: Their covariances, shape (n, 6, 6).
        other: What is to be added to these, shape (n, 6, 6), or (0, 6, 6): nothing.
        out: Rows to write, shape (n, w).

    """
    pose, native, residual, covariance = columns[0], columns[1], columns[2], columns[3]
    add = other.shape[0] > 0
    for n in range(out.shape[0]):
        to, said = out[n], figures[n]
        for k in range(row.shape[0]):
            to[k] = row[k]
        for k in range(NATIVE - POSE):
            to[pose + k] = said[POSE + k]
        for k in range(RESIDUAL - NATIVE):
            to[native + k] = said[NATIVE + k]
        to[residual] = said[RESIDUAL]
        there = to[covariance : covariance + 36]
        for i in range(6):
            for j in range(6):
                there[6 * i + j] = one[n, i, j]
        if add:
            for i in range(6):
                for j in range(6):
                    there[6 * i + j] += other[n, i, j]


@compiled
def read_numbers(
    rows: FloatArray, columns: IntArray, j: int, poses: FloatArray, covariances: FloatArray, thetas: FloatArray
) -> None:
    """Read the transforms of one joint as the chain wants them.

    Args:
        rows: The transforms, shape (n, w).
        columns: Where in a row pose, native coordinates and covariance begin.
        j: Which joint of the chain it is.
        poses: To write, shape (n, joints, 7).
        covariances: To write, shape (n, joints, 6, 6).
        thetas: To write, shape (n, joints).

    """
    pose, native, covariance = columns[0], columns[1], columns[2]
    for n in range(rows.shape[0]):
        row = rows[n]
        for k in range(7):
            poses[n, j, k] = row[pose + k]
        thetas[n, j] = row[native + 5]
        there = row[covariance : covariance + 36]
        for i in range(6):
            for k in range(6):
                covariances[n, j, i, k] = there[6 * i + k]
