"""The parameters of a stack as sums of standard normal deviates, as the compiled loop wants them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray


@dataclass(frozen=True)
class Root:
    """A square root of the parameters' covariance, row by row without its zeros.

    Attributes:
        parts: Of each parameter its first deviate, how many follow one another, and where their factors begin; none
            where it is exact, shape (p, 3).
        factors: The factors, shape (entries,).
        deviates: How many deviates there are.

    """

    parts: IntArray
    factors: FloatArray
    deviates: int

    @staticmethod
    def of_sigmas(sigmas: FloatArray) -> Root:
        """Return the root for independent parameters of these standard uncertainties, shape (p,)."""
        known = np.flatnonzero(sigmas > 0.0)
        parts = np.zeros((sigmas.size, 3), dtype=np.int64)
        parts[known, 0] = parts[known, 2] = np.arange(known.size)
        parts[known, 1] = 1
        return Root(parts, sigmas[known], known.size)

    def dense(self) -> FloatArray:
        """Return the root with its zeros, shape (p, deviates)."""
        out = np.zeros((len(self.parts), self.deviates))
        for row, (first, count, begin) in zip(out, self.parts, strict=True):
            row[first : first + count] = self.factors[begin : begin + count]
        return out
