"""Printed results of the tests TWIS and GEN, appendix 8B: alpha, and z and y at the end of the measuring beam.

Inch and rad, as in the table. Columns: alpha, z, y.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from posor_lab.thesis_data import URAD, data_path, parse_number, read_table

if TYPE_CHECKING:
    from posor.numerics.array_types import BoolArray, FloatArray

EndOfBeamTest = Literal["TWIS", "GEN"]
COLUMNS: tuple[Literal["alpha", "z", "y"], ...] = ("alpha", "z", "y")
_UNITS = (("urad", URAD), ("in", 1.0), ("in", 1.0))


@dataclass(frozen=True)
class EndOfBeamResults:
    """A printed result table; NaN: not legible.

    Attributes:
        measured: By the machining centre [rad, inch, inch], shape (n, 3), less step 1.
        posor: By the POSOR with zero shifts of (0, .2, .3) V, shape (n, 3), less step 1.

    """

    measured: FloatArray
    posor: FloatArray

    @property
    def errors(self) -> FloatArray:
        """POSOR less machining centre, shape (n, 3)."""
        return np.asarray(self.posor - self.measured)

    @property
    def legible(self) -> BoolArray:
        """Which errors are legible, shape (n, 3)."""
        return np.asarray(np.isfinite(self.errors))

    @property
    def motion(self) -> FloatArray:
        """The measured columns, each missing cell interpolated between its neighbouring steps, shape (n, 3)."""
        steps = np.arange(len(self.measured), dtype=float)
        filled = [np.interp(steps, steps[known := np.isfinite(column)], column[known]) for column in self.measured.T]
        return np.asarray(np.column_stack(filled))

    def root_mean_square(self, column: int) -> float:
        """Return the root mean square of the legible errors of a column, without step 1."""
        errors = self.errors[1:, column]
        return float(np.sqrt(np.nanmean(np.square(errors))))


def read_end_of_beam(test: EndOfBeamTest) -> EndOfBeamResults:
    """Return the printed results of a test.

    Raises:
        DataFileError: The table cannot be read, or has an invalid number.

    """
    path = data_path(f"{test.lower()}_output.csv")
    names = {
        kind: [f"{name}_{kind}_{unit}" for name, (unit, _) in zip(COLUMNS, _UNITS, strict=True)]
        for kind in ("meas", "posor")
    }
    rows = read_table(path, ["step", *names["meas"], *names["posor"]])
    scales = np.array([scale for _, scale in _UNITS])

    def columns(kind: str) -> FloatArray:
        cells = [[parse_number(row, name, f"{path}, step {row['step']}") for name in names[kind]] for row in rows]
        return np.asarray(np.array(cells) * scales)

    return EndOfBeamResults(columns("meas"), columns("posor"))
