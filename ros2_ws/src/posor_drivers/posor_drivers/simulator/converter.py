"""The analogue-to-digital converter: steps, and a range that ends."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from posor_estimator.core.types import FloatArray


def converted(
    values: FloatArray, limits: FloatArray, bits: int, *, steps: bool
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return what a converter makes of values, and which of the n scans have a channel at the end of its range.

    Code c of the ``2^bits`` codes stands for ``low + c (high - low) / 2^bits``.

    Args:
        values: (n, ...).
        limits: Low and high end of the range, (2,).
        bits: Of the converter.
        steps: Whether it rounds to codes, or only ends.

    """
    low, high = limits
    step = (high - low) / 2**bits
    codes = (values - low) / step
    last = 2**bits - 1
    ended = (codes <= 0.0) | (codes >= last)
    codes = np.clip(codes, 0.0, last)
    if steps:
        codes = np.round(codes)
    return low + step * codes, ended.reshape(len(values), -1).any(axis=1)
