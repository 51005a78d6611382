"""Numbers of estimates on their way into messages, compiled."""

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
