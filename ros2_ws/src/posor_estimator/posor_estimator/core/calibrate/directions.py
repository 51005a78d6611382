"""What readings cannot tell apart: combinations of parameters that they determine badly, and what would help."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.types import FloatArray

BLIND = 1e-9
"""Of the largest singular value: below this the data say nothing at all."""
UNTOLD = 0.5
"""A direction whose standard uncertainty stays above this part of what was known before is not told by the data."""
NAMED = 0.3
"""Parameters with at least this share in a direction are named."""


@dataclass(frozen=True)
class Direction:
    """A combination of parameters that the data determine badly.

    Attributes:
        shares: Components of the unit direction, of the parameters scaled by what was known of them before, (p,).
        remaining: Standard uncertainty along it after the fit, over that before; infinite where the data are blind.
        names: The parameters with the largest shares.

    """

    shares: FloatArray
    remaining: float
    names: tuple[str, ...]

    def left(self, gain: float = 0.0) -> float:
        """Return the standard uncertainty along it, over that before, where what was known before counts too, 0 to 1.

        Args:
            gain: Information that further readings would add: their squared derivatives along the direction.

        """
        return float(1.0 / np.sqrt(1.0 + self.remaining**-2 + gain))


def weak_directions(scaled_jacobian: FloatArray, names: Sequence[str]) -> tuple[Direction, ...]:
    """Return the combinations of parameters that readings tell badly, the worst first.

    Args:
        scaled_jacobian: d(normalised residual)/d(parameter over what was known of it before), (n, p).
        names: Of the parameters, (p,).

    """
    size = len(names)
    padded = np.vstack([scaled_jacobian, np.zeros((max(0, size - len(scaled_jacobian)), size))])
    _, singular, directions = np.linalg.svd(padded, full_matrices=False)
    found = []
    for value, shares in zip(singular[::-1], directions[::-1], strict=True):
        remaining = np.inf if value <= BLIND * singular[0] else 1.0 / value
        if remaining < UNTOLD:
            break
        order = np.argsort(-np.abs(shares))
        named = tuple(names[i] for i in order if abs(shares[i]) >= NAMED) or (names[order[0]],)
        found.append(Direction(shares, float(remaining), named))
    return tuple(found)


def telling(direction: Direction, candidates: Sequence[FloatArray]) -> list[int]:
    """Return which readings would tell a weak direction best: indices of candidates, the best first.

    Args:
        direction: What the data at hand do not tell.
        candidates: For each candidate pose its scaled Jacobian, (m, p).

    """
    gains = [float(np.sum(np.square(candidate @ direction.shares))) for candidate in candidates]
    return [int(index) for index in np.argsort(-np.array(gains), kind="stable")]
