# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of many times."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor.numerics.compiled import in_place

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray, IntArray

MEAN, DEVIATION, LEAST, GREATEST = 0, 1, 2, 3
FIGURES = 4


@in_place
def figures_of(values: IntArray, limit: int, out: FloatArray) -> int:
    """Write mean, standard deviation, least and greatest of those values that are nearer to zero than a limit.

    ``values``: shape (n,); ``limit``: what is as large, or larger, does not count; ``out``: to write, shape (4,), where
    there is any value. Return how many values count.
    """
    count, total, least, greatest = 0, 0, 0, 0
    for n in range(values.shape[0]):
        value = values[n]
        if abs(value) < limit:
            least = value if count == 0 else min(least, value)
            greatest = value if count == 0 else max(greatest, value)
            count += 1
            total += value
    if count == 0:
        return 0
    mean = total / count
    squares = 0.0
    for n in range(values.shape[0]):
        if abs(values[n]) < limit:
            squares += (values[n] - mean) * (values[n] - mean)
    out[MEAN], out[DEVIATION] = mean, math.sqrt(squares / max(1, count - 1))
    out[LEAST], out[GREATEST] = least, greatest
    return count
