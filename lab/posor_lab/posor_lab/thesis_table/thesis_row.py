"""One row of the table of the thesis: printed number, computed number, verdict."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from enum import Enum

RELATIVE_TOLERANCE = 0.02
"""A computed number agrees within this share of the printed one, or within the rounding of the printed one."""
_MARGIN = 1.0 + 1e-9
_MANTISSA = re.compile(r"[-+]?\d*\.?(?P<decimals>\d*)")


class Verdict(Enum):
    """Result of the comparison of a printed number with a computed one."""

    AGREES = "agrees"
    DIFFERS = "differs"
    NOT_LEGIBLE = "not legible"


@dataclass(frozen=True)
class ThesisRow:
    """A printed number and its counterpart.

    Attributes:
        section: Section, table or appendix of the thesis, such as ``6.2.2`` or ``App. 1A``.
        quantity: What the number is.
        unit: Unit of both numbers, as printed.
        printed: The printed digits, such as ``.0065`` or ``5.6e-9``; empty: not legible.
        computed: The number that this project computes, in the same unit.
        reason: Why the two differ, or what was assumed; required if they differ or if no number is legible.
        input_rounding: Possible change of the computed number by the rounding of a printed input, in the same unit.

    """

    section: str
    quantity: str
    unit: str
    printed: str
    computed: float
    reason: str = ""
    input_rounding: float = 0.0

    def __post_init__(self) -> None:
        """Check the row.

        Raises:
            ValueError: The computed number is not finite, or a difference has no reason.

        """
        if not math.isfinite(self.computed):
            raise ValueError(f"{self.section}, {self.quantity}: computed {self.computed}; expected a finite number")
        if self.verdict is not Verdict.AGREES and not self.reason:
            raise ValueError(
                f"{self.section}, {self.quantity}: printed '{self.printed}', computed {self.computed:g}; "
                "expected a reason"
            )

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
        mantissa, _, exponent = self.printed.lower().partition("e")
        match = _MANTISSA.fullmatch(mantissa)
        decimals = len(match["decimals"]) if match and "." in mantissa else 0
        return 0.5 * 10.0 ** (int(exponent or 0) - decimals)

    @property
    def verdict(self) -> Verdict:
        """Agreement within 2 % of the printed number, or within its rounding and that of a printed input."""
        if self.printed_number is None or self.difference is None:
            return Verdict.NOT_LEGIBLE
        tolerance = max(RELATIVE_TOLERANCE * abs(self.printed_number), self.rounding + self.input_rounding)
        return Verdict.AGREES if abs(self.difference) <= _MARGIN * tolerance else Verdict.DIFFERS
