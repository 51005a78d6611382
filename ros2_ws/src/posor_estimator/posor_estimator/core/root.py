"""The parameters of a stack as sums of standard normal deviates, as the compiled loop wants them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse.csgraph import connected_components

from posor_estimator.core.calibration.stated import root_of

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
    def of(sigmas: FloatArray, correlation: FloatArray | None = None) -> Root:
        """Return the root for parameters of standard uncertainties (p,) and correlations (p, p); None: independent.

        A parameter that is correlated with no other has a deviate of its own, a block of those that are has as many
        as its correlations have directions.
        """
        known = np.flatnonzero(sigmas > 0.0)
        parts = np.zeros((sigmas.size, 3), dtype=np.int64)
        factors: list[FloatArray] = [np.zeros(0)]
        deviates = placed = 0
        for block in _blocks(known, correlation):
            root = sigmas[block, None]
            if correlation is not None and block.size > 1:
                root = root * root_of(correlation[np.ix_(block, block)])
            count = root.shape[1]
            parts[block, 0], parts[block, 1] = deviates, count
            parts[block, 2] = placed + count * np.arange(block.size)
            factors.append(root.ravel())
            deviates, placed = deviates + count, placed + root.size
        return Root(parts, np.concatenate(factors), deviates)

    def dense(self) -> FloatArray:
        """Return the root with its zeros, shape (p, deviates)."""
        out = np.zeros((len(self.parts), self.deviates))
        for row, (first, count, begin) in zip(out, self.parts, strict=True):
            row[first : first + count] = self.factors[begin : begin + count]
        return out


def _blocks(known: IntArray, correlation: FloatArray | None) -> list[IntArray]:
    """Return the parameters (k,) in blocks, in their order; none is correlated with one of another block."""
    if correlation is None:
        return list(known[:, None])
    count, labels = connected_components(correlation[np.ix_(known, known)] != 0.0, directed=False)
    return [known[labels == label] for label in range(count)]
