"""The error budgets of the impedance probes, tables 5.2 and 7.12 of the thesis, from the model."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from posor_bringup.budget_cells import BudgetTable, Cell, Reason, last_digit, printed_cells
from posor_bringup.chapter5 import PROBE_RANGE, PROBES, Axis, Chapter5, Slopes, root_sum_square
from posor_bringup.installed import data_path
from posor_bringup.thesis import read_table

if TYPE_CHECKING:
    from collections.abc import Mapping

FACTORS_FILE = "error_budget_table_5_2_probes.csv"
BUDGET_FILE = "error_budget_table_7_12_probes.csv"

AT_ORIGIN, AT_POINT, ABOUT_X, ABOUT_Y = JUDGED = ("l_0_0", "l_m1_1p5", "alpha", "beta")
"""Columns of table 5.2: the distance at the origin and at (-1, 1.5) in, and the two inclinations."""
BUDGET_COLUMNS: Mapping[str, str] = {
    "sigma_l_0_0_uin": AT_ORIGIN,
    "sigma_l_m1_1p5_uin": AT_POINT,
    "sigma_alpha_urad": ABOUT_X,
    "sigma_beta_urad": ABOUT_Y,
}
"""Columns of table 7.12, and those of table 5.2 that they are made with."""

WORST = Slopes(PROBE_RANGE, PROBE_RANGE)
"""Where the factors of a, b, c hold: the probes' range, over 3 in each way."""
HALF = Slopes(PROBE_RANGE, PROBE_RANGE / 2.0)
_SHORT_LEVER = 1.5

SCANNED_LAST_CELL = 7.0
"""What the scan of table 7.12 shows, or may show, in the last cells of the three rows that go as sigma_l."""
OTHER_SIGMAS = {"sigma_a": 0.0144, "sigma_b": 0.0187, "sigma_c": 0.0159}
"""Uncertainties of a, b, c [inch] that would give the totals of section 7.5.4: derived, three numbers to four cells."""

INCREASING, RANDOM, TOTAL = "increasing", "random", "total"
_SUM = "root mean square"
_SUPPLY = "voltage supply"


@cache
def _worst() -> Chapter5:
    return Chapter5(WORST)


@cache
def _level() -> Chapter5:
    return Chapter5(Slopes())


@cache
def factor(row: str, judged: str) -> float:
    """Return the model's factor for a row of table 5.2, in inch and radian."""
    model = _worst()
    by_reading = [model.by_reading(judged, probe) for probe in PROBES]
    if row == "sigma_l":
        return root_sum_square(*by_reading)
    if row in _LEVERS:
        parameter, sign = _LEVERS[row]
        value = sign * model.by_parameter(judged, parameter)
        return value if judged == AT_ORIGIN else abs(value)  # only there the thesis prints a sign
    axis: Axis = "x" if row == "sigma_eX" else "y"
    longer = [_level().shift_by_square(probe, {f"GapProbes.axes[{i},0]": axis}) for i, probe in enumerate(PROBES)]
    return root_sum_square(*(by * by_square for by, by_square in zip(by_reading, longer, strict=True)))


_LEVERS: Mapping[str, tuple[str, float]] = {
    "sigma_a": ("GapProbes.tips[1,1]", 1.0),
    "sigma_b": ("GapProbes.tips[2,1]", -1.0),
    "sigma_c": ("GapProbes.tips[0,0]", -1.0),
}
"""Which coordinate of which tip each lever is, and its sign."""


@cache
def _reasons_of_factors() -> dict[tuple[str, str], Reason]:
    model = _worst()
    shared = [model.by_reading(AT_ORIGIN, probe) for probe in PROBES[1:]]
    point = root_sum_square(*shared, model.by_reading(AT_POINT, PROBES[0]))
    short = Chapter5(Slopes(), c=_SHORT_LEVER)
    rounded = "rounded beforehand: .025 times the factor of sigma_l to two digits"
    reasons = {
        ("sigma_l", AT_POINT): Reason(
            "probes 2 and 3 counted as at the origin, root(.5^2 + .5^2 + (1/3)^2); table 7.12 has each of them right",
            point,
        ),
        ("sigma_l", ABOUT_Y): Reason(
            "worked out with c = 1.5 in place of 3 in; the rows of eX and eY of the same column have c = 3",
            root_sum_square(*(short.by_reading(ABOUT_Y, probe) for probe in PROBES)),
        ),
        ("sigma_b", AT_POINT): Reason(
            "the part of beta left out: at (0, 1.5) in, over probe 2, b has no influence",
            abs(model.by_parameter("l_0_1p5", _LEVERS["sigma_b"][0])),
        ),
        ("sigma_c", AT_POINT): Reason(
            "a slope along X of .025 in over c, half of the one in the column of beta",
            abs(Chapter5(HALF).by_parameter(AT_POINT, _LEVERS["sigma_c"][0])),
        ),
    }
    for row in ("sigma_eX", "sigma_eY"):
        by_square = _level().shift_by_square(PROBES[0], {"GapProbes.axes[0,0]": "x"})
        reasons[row, AT_ORIGIN] = Reason(rounded, by_square * round(factor("sigma_l", AT_ORIGIN), 2))
        reasons[row, AT_POINT] = Reason("as in the row of sigma_l", by_square * point)
        reasons[row, ABOUT_Y] = Reason(rounded, by_square * round(factor("sigma_l", ABOUT_Y), 2))
    return reasons


def table_5_2() -> BudgetTable:
    """Return table 5.2: factors of the probes' budget.

    Raises:
        DataFileError: The printed table cannot be read.

    """
    path = data_path(FACTORS_FILE)
    rows = read_table(path, ["perturbation", *JUDGED])
    reasons = _reasons_of_factors()
    names = tuple(row["perturbation"] for row in rows)
    cells = [
        Cell("5.2", name, column, printed, factor(name, column), reason=reasons.get((name, column)))
        for column in JUDGED
        for name, printed in zip(names, printed_cells(rows, column, path), strict=True)
    ]
    return BudgetTable("5.2", "impedance probes, factors (inch, radian)", JUDGED, names, tuple(cells))


class _Budget:
    """Table 7.12 while it is worked out."""

    def __init__(self) -> None:
        path = data_path(BUDGET_FILE)
        self.rows = read_table(path, ["kind", "perturbation", "value", "value_unit", *BUDGET_COLUMNS])
        self.names = tuple(_name(row) for row in self.rows)
        self.printed = {column: printed_cells(self.rows, column, path) for column in BUDGET_COLUMNS}
        self._factors = {(cell.row, cell.column): cell.printed.number for cell in table_5_2().cells}

    def cells(self, column: str) -> list[Cell]:
        """Return a column, its sums last worked out of the rows above them."""
        judged = BUDGET_COLUMNS[column]
        made: list[Cell] = []
        sums: dict[str, float] = {}
        for row, name, printed in zip(self.rows, self.names, self.printed[column], strict=True):
            kind = row["kind"]
            if row["value"]:
                scale = _scale(row)
                factors = _row_factor(row, judged)
                computed = factors * float(row["value"]) * scale
                rounding = factors * 0.5 * last_digit(row["value"]) * scale
                reason = self._of_factor(row, judged) or Reason("the model's number rounded up in print", computed)
            else:
                parts = [cell for cell in made if cell.row.startswith(kind)]
                computed = root_sum_square(*(sums.values() if kind == TOTAL else (cell.computed for cell in parts)))
                rounding = sum(cell.computed * cell.input_rounding for cell in parts) / computed
                sums[kind] = computed
                reason = self._of_sum(kind, column)
            made.append(Cell("7.12", name, column, printed, computed, rounding, reason))
        return made

    def _of_factor(self, row: Mapping[str, str], judged: str) -> Reason | None:
        name = _row_of_factors(row["perturbation"])
        if row["kind"] != INCREASING or name is None:
            return None
        printed = self._factors[name, judged]
        text = f"the factor as table 5.2 prints it, {printed:g} of {name}, times the value"
        return Reason(text, abs(printed) * float(row["value"]) * _scale(row))

    def _of_sum(self, kind: str, column: str) -> Reason:
        judged = BUDGET_COLUMNS[column]
        if kind == TOTAL:
            gives = root_sum_square(*(self._factors[name, judged] * 1e6 * s for name, s in OTHER_SIGMAS.items()))
            given = ", ".join(f"{name[-1]} {value:g}" for name, value in OTHER_SIGMAS.items())
            return Reason(
                f"not of the table's values: follows from the factors printed in table 5.2 with sigmas of {given} in "
                "(derived: three numbers fitted to the four cells of this row)",
                gives,
            )
        parts = [
            (row, printed.number)
            for row, printed in zip(self.rows, self.printed[column], strict=True)
            if row["kind"] == kind and row["value"]
        ]
        if kind == RANDOM:
            return Reason("root sum square of the rounded cells", root_sum_square(*(number for _, number in parts)))
        without = [(row, number) for row, number in parts if not row["perturbation"].startswith(_SUPPLY)]
        text = "root sum square of the printed cells without the rows of the supply voltage"
        if judged == ABOUT_Y:
            text += ", and with 7, which the scan shows, as the last cell of the three rows that go as sigma_l"
            without = [
                (row, SCANNED_LAST_CELL if "as sigma_l" in row["perturbation"] else number) for row, number in without
            ]
        return Reason(text, root_sum_square(*(number for _, number in without)))


def _name(row: Mapping[str, str]) -> str:
    return f"{row['kind']}: {row['perturbation']}"


def _scale(row: Mapping[str, str]) -> float:
    """Return what makes uin or urad of a factor times the value."""
    return 1e6 if row["value_unit"] == "in" else 1.0


def _row_of_factors(perturbation: str) -> str | None:
    """Return the row of table 5.2 that a perturbation goes by; nothing for that of a single probe."""
    if "as sigma_l" in perturbation:
        return "sigma_l"
    return perturbation if perturbation in _LEVERS else None


def _row_factor(row: Mapping[str, str], judged: str) -> float:
    name = _row_of_factors(row["perturbation"])
    if name is not None:
        return abs(factor(name, judged))
    return abs(_worst().by_reading(judged, f"gap probe_{row['perturbation'][-1]}"))


def table_7_12() -> BudgetTable:
    """Return table 7.12: budget of the calibrated probes.

    Raises:
        DataFileError: A printed table cannot be read.

    """
    budget = _Budget()
    cells = [cell for column in BUDGET_COLUMNS for cell in budget.cells(column)]
    title = "impedance probes as calibrated (uin, urad)"
    return BudgetTable("7.12", title, tuple(BUDGET_COLUMNS), budget.names, tuple(cells))
