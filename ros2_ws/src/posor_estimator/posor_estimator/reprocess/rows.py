"""Numbers on their way into the rows of transforms and out of them, compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.core.compiled import compiled

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray


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
