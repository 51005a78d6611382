"""A budget ready to be told: what was asked, the first-order budget, the draws, and the test of one by the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor_estimator.core.native import native_from_rotation

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.budget.first_order import ErrorBudget
    from posor_estimator.core.budget.monte_carlo import MonteCarlo
    from posor_estimator.core.budget.outputs import Output
    from posor_estimator.core.budget.validation import Validation

SCALES: Mapping[str, tuple[float, str]] = {"m": (1e6, "µm"), "rad": (1e6, "µrad")}
"""How quantities of each unit are shown: the factor and the unit's name."""


@dataclass(frozen=True)
class ToldBudget:
    """What the tables, files and pages of one budget are made of.

    Attributes:
        calibration: Name of the calibration.
        content_hash: Of what it says.
        session: The session applied, empty: none.
        budget: First order.
        drawn: Draws.
        validations: The first order's test by the draws, one for each judged quantity.
        seed: Of the draws.

    """

    calibration: str
    content_hash: str
    session: str
    budget: ErrorBudget
    drawn: MonteCarlo
    validations: tuple[Validation, ...]
    seed: int

    @property
    def holds(self) -> bool:
        """Whether the first order is valid for every judged quantity."""
        return all(validation.holds for validation in self.validations)

    @property
    def verdict(self) -> str:
        """One sentence on the test of clause 8 of JCGM 101."""
        failing = [validation.name for validation in self.validations if not validation.holds]
        unsettled = [validation.name for validation in self.validations if not validation.stable]
        if failing:
            sentence = f"First order and draws differ by more than the numerical tolerance in {', '.join(failing)}."
        else:
            sentence = "First order and draws agree within the numerical tolerance (JCGM 101, clause 8)."
        if unsettled:
            sentence += f" The draws have not settled to a fifth of it in {', '.join(unsettled)}: more would tell."
        return sentence

    @property
    def together(self) -> str:
        """What quantities that vary together make of the contributions, empty where none do."""
        names = self.budget.together
        if not names:
            return ""
        return (
            f"By the calibration {len(names)} quantities vary together, such as {names[0]}: each contribution is that "
            "of one quantity with all else exact. They do not add up to the full covariance, which counts how the "
            "quantities vary together, and a large one may cancel against others."
        )

    @property
    def pose(self) -> str:
        """The pose in native coordinates."""
        T = self.budget.T_R_T
        x, y, gap = (f"{1e3 * value:.4f}" for value in T.translation)
        alpha, beta, theta = (f"{1e3 * value:.3f}" for value in native_from_rotation(T.rotation))
        return f"x {x}, y {y}, gap {gap} mm; alpha {alpha}, beta {beta}, theta {theta} mrad"


def heading(output: Output) -> str:
    """Return a judged quantity and the unit that it is shown in."""
    return f"{output.name} [{SCALES[output.unit][1]}]"


def number(value: float, output: Output) -> str:
    """Return a number as it is shown, three digits of it."""
    shown = value * SCALES[output.unit][0]
    return f"{shown:#.3g}".rstrip(".") if shown < 1e3 else f"{shown:.0f}"  # noqa: PLR2004  three digits
