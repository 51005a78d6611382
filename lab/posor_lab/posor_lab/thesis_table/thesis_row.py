# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""One row of the table of the thesis: printed number, computed number, verdict, and kind of the comparison."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from posor_lab.thesis_data import last_digit

RELATIVE_TOLERANCE = 0.02
"""A computed number agrees within this share of the printed one, or within the rounding of the printed one."""
_BINARY_ROUNDING = 1.0 + 1e-9  # factor of a tolerance that allows for the rounding of a binary number


def agrees_within(tolerance: float, computed: float, printed: float) -> bool:
    """Return whether a computed number is within a tolerance of a printed one."""
    return abs(computed - printed) <= _BINARY_ROUNDING * tolerance


class Agreement(Enum):
    """Result of the comparison of a printed number with a computed one."""

    AGREES = "agrees"
    EXPLAINED = "differs, explained"
    DIFFERS = "differs"
    NOT_LEGIBLE = "not legible"


class ComparisonKind(Enum):
    """Weight of a comparison: the source of the computed number."""

    COMPUTED = "computed from inputs"
    BUDGET_CELL = "budget cell"
    PRINT = "print with print"
    SIGN = "sign"
    DEPENDENT = "not independent"


@dataclass(frozen=True)
class ThesisRow:
    """A printed number and its counterpart."""

    section: str  # section, table or appendix of the thesis, such as ``6.2.2`` or ``App. 1A``
    quantity: str  # name of the number
    unit: str  # unit of both numbers, as printed
    printed: str  # the printed digits, such as ``.0065`` or ``5.6e-9``; empty: not legible
    computed: float  # the number that this project computes, in the same unit
    reason: str = ""  # why the two differ, or an assumption; required if they differ or no number is legible
    input_rounding: float = 0.0  # possible change of ``computed`` by the rounding of a printed input
    kind: ComparisonKind = ComparisonKind.COMPUTED  # source of the computed number

    @property
    def printed_number(self) -> float | None:
        """The printed number; None: not legible."""
        return float(self.printed) if self.printed else None

    @property
    def difference(self) -> float | None:
        """Computed minus printed number; None: not legible."""
        return None if self.printed_number is None else self.computed - self.printed_number

    @property
    def rounding(self) -> float:
        """Half a unit of the last printed digit."""
        return 0.5 * last_digit(self.printed)

    @property
    def verdict(self) -> Agreement:
        """Agreement within 2 % of the printed number, or within the rounding of this number and of a printed input."""
        if self.printed_number is None:
            return Agreement.NOT_LEGIBLE
        rounding = self.rounding + self.input_rounding
        agrees = self._within_share or agrees_within(rounding, self.computed, self.printed_number)
        return Agreement.AGREES if agrees else Agreement.DIFFERS

    @property
    def kind_name(self) -> str:
        """Name of the kind; of a number from inputs that agrees by rounding alone: the number of printed digits."""
        if self.kind is not ComparisonKind.COMPUTED or self.verdict is not Agreement.AGREES or self._within_share:
            return self.kind.value
        digits = len(self.printed.lower().partition("e")[0].lstrip("+-0.").replace(".", "")) or 1
        return f"rounding of {digits} digit{'s' if digits > 1 else ''}"

    @property
    def _within_share(self) -> bool:
        printed = self.printed_number
        return printed is not None and agrees_within(RELATIVE_TOLERANCE * abs(printed), self.computed, printed)
