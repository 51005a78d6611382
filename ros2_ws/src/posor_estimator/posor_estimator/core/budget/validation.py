"""Is the first-order budget good enough? The validation test of JCGM 101, clause 8."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from scipy.stats import norm

if TYPE_CHECKING:
    from posor_estimator.core.budget.first_order import ErrorBudget
    from posor_estimator.core.budget.monte_carlo import MonteCarlo

COVERAGE = 0.95
"""Coverage probability of the intervals that are compared."""
COVERAGE_FACTOR = float(norm.ppf(0.5 + 0.5 * COVERAGE))


@dataclass(frozen=True)
class Validation:
    """One quantity's first-order interval against that of the draws.

    Attributes:
        name: The quantity.
        tolerance: Numerical tolerance of its standard uncertainty [m, rad].
        low: Distance of the lower ends of the two 95 % intervals.
        high: Distance of the upper ends.
        stable: Whether the draws have settled far enough to tell.

    """

    name: str
    tolerance: float
    low: float
    high: float
    stable: bool

    @property
    def holds(self) -> bool:
        """Whether both ends agree within the tolerance."""
        return self.low <= self.tolerance and self.high <= self.tolerance


def numerical_tolerance(sigma: float, digits: int) -> float:
    """Return half a unit of the last of an uncertainty's significant digits (JCGM 101, 7.9.2); zero of zero."""
    if not sigma > 0.0:
        return 0.0
    last = math.floor(math.log10(sigma)) - (digits - 1)
    if round(sigma / 10.0**last) >= 10**digits:  # 0.96 is 1.0, to one digit
        last += 1
    return 0.5 * 10.0**last


def validate(budget: ErrorBudget, drawn: MonteCarlo, digits: int = 1) -> tuple[Validation, ...]:
    """Compare the two 95 % intervals of each judged quantity.

    Args:
        budget: First-order budget.
        drawn: Draws of the same POSOR at the same pose and points.
        digits: Significant digits of an uncertainty that are taken to matter.

    """
    found = []
    for i, output in enumerate(budget.outputs):
        expanded = COVERAGE_FACTOR * budget.sigmas[i]
        found.append(
            Validation(
                name=output.name,
                tolerance=numerical_tolerance(float(budget.sigmas[i]), digits),
                low=float(abs(budget.values[i] - expanded - drawn.low[i])),
                high=float(abs(budget.values[i] + expanded - drawn.high[i])),
                stable=bool(drawn.stable[i]),
            )
        )
    return tuple(found)
