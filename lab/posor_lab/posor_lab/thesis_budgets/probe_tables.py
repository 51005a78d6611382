"""The error budgets of the impedance probes, tables 5.2 and 7.12 of the thesis, from the model."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from posor_lab.thesis_budgets.budget_cells import BudgetTable, Cell, Printed, Reason, printed_cells
from posor_lab.thesis_budgets.chapter5 import PROBE_RANGE, PROBES, Axis, Chapter5, Slopes, root_sum_square
from posor_lab.thesis_data import data_path, last_digit, read_table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    Row = Mapping[str, str]

FACTORS_FILE = "error_budget_table_5_2_probes.csv"
BUDGET_FILE = "error_budget_table_7_12_probes.csv"

AT_ORIGIN, AT_POINT, ALPHA, BETA = OUTPUTS = ("l_0_0", "l_m1_1p5", "alpha", "beta")
"""Columns of table 5.2: distance at the origin and at (-1, 1.5) in, and the two inclinations."""
BUDGET_COLUMNS: Mapping[str, str] = {
    "sigma_l_0_0_uin": AT_ORIGIN,
    "sigma_l_m1_1p5_uin": AT_POINT,
    "sigma_alpha_urad": ALPHA,
    "sigma_beta_urad": BETA,
}
"""Columns of table 7.12, and the columns of table 5.2 with their factors."""

WORST = Slopes(PROBE_RANGE, PROBE_RANGE)
"""Inclination at which the factors of a, b, c hold: the range of the probes over 3 in each way."""
HALF = Slopes(PROBE_RANGE, PROBE_RANGE / 2.0)
_SHORT_LEVER = 1.5

SCANNED_LAST_CELL = 7.0
"""Probable reading of the scan of table 7.12 in the last cells of the three rows that go as sigma_l."""
OTHER_SIGMAS = {"sigma_a": 0.0144, "sigma_b": 0.0187, "sigma_c": 0.0159}
"""Uncertainties of a, b, c [inch] that give the totals of section 7.5.4: derived, three numbers for four cells."""

INCREASING, RANDOM, TOTAL = "increasing", "random", "total"

LEVERS: Mapping[str, tuple[str, float]] = {
    "sigma_a": ("GapProbes.tips[1,1]", 1.0),
    "sigma_b": ("GapProbes.tips[2,1]", -1.0),
    "sigma_c": ("GapProbes.tips[0,0]", -1.0),
}
"""Tip coordinate of each lever, and its sign."""


@cache
def _model(slopes: Slopes) -> Chapter5:
    """Return the model at an inclination."""
    return Chapter5(slopes)


def _lean_shift(probe: int, axis: Axis) -> float:
    """Return the effect of the square of the angle of a probe axis on its gap [inch], plate level."""
    return _model(Slopes()).quadratic_shift(PROBES[probe], {f"GapProbes.axes[{probe},0]": axis})


@cache
def factor(row: str, output: str) -> float:
    """Return the factor of the model for a row of table 5.2, in inch and radian."""
    model = _model(WORST)
    by_gap = [model.reading_sensitivity(output, probe) for probe in PROBES]
    if row == "sigma_l":
        return root_sum_square(*by_gap)
    if row in LEVERS:
        parameter, sign = LEVERS[row]
        value = sign * model.parameter_sensitivity(output, parameter)
        return value if output == AT_ORIGIN else abs(value)  # the thesis prints signs in this column only
    axis: Axis = "x" if row == "sigma_eX" else "y"
    return root_sum_square(*(by * _lean_shift(probe, axis) for probe, by in enumerate(by_gap)))


@cache
def _factor_reasons() -> dict[tuple[str, str], Reason]:
    """Return the reasons of the differences in table 5.2, by row and column."""
    model, short = _model(WORST), Chapter5(Slopes(), c=_SHORT_LEVER)
    shared = [model.reading_sensitivity(AT_ORIGIN, probe) for probe in PROBES[1:]]
    point = root_sum_square(*shared, model.reading_sensitivity(AT_POINT, PROBES[0]))
    rounded = "rounded beforehand: .025 times the factor of sigma_l to two digits"
    reasons = {
        ("sigma_l", AT_POINT): Reason(
            "probes 2 and 3 counted as at the origin, root(.5^2 + .5^2 + (1/3)^2); table 7.12 has each of them right",
            point,
        ),
        ("sigma_l", BETA): Reason(
            "worked out with c = 1.5 in place of 3 in; the rows of eX and eY of the same column have c = 3",
            root_sum_square(*(short.reading_sensitivity(BETA, probe) for probe in PROBES)),
        ),
        ("sigma_b", AT_POINT): Reason(
            "the part of beta left out: at (0, 1.5) in, over probe 2, b has no influence",
            abs(model.parameter_sensitivity("l_0_1p5", LEVERS["sigma_b"][0])),
        ),
        ("sigma_c", AT_POINT): Reason(
            "a slope along X of .025 in over c, half of the one in the column of beta",
            abs(_model(HALF).parameter_sensitivity(AT_POINT, LEVERS["sigma_c"][0])),
        ),
    }
    for row in ("sigma_eX", "sigma_eY"):
        lean = _lean_shift(0, "x")
        reasons[row, AT_ORIGIN] = Reason(rounded, lean * round(factor("sigma_l", AT_ORIGIN), 2))
        reasons[row, AT_POINT] = Reason("as in the row of sigma_l", lean * point)
        reasons[row, BETA] = Reason(rounded, lean * round(factor("sigma_l", BETA), 2))
    return reasons


def table_5_2() -> BudgetTable:
    """Return table 5.2: factors of the probes' budget.

    Raises:
        DataFileError: The printed table cannot be read.

    """
    path = data_path(FACTORS_FILE)
    rows = read_table(path, ["perturbation", *OUTPUTS])
    cells = [
        Cell("5.2", name, column, printed, factor(name, column), reason=_factor_reasons().get((name, column)))
        for column in OUTPUTS
        for name, printed in zip((row["perturbation"] for row in rows), printed_cells(rows, column, path), strict=True)
    ]
    return BudgetTable("5.2", "impedance probes, factors (inch, radian)", tuple(cells))


def table_7_12() -> BudgetTable:
    """Return table 7.12: budget of the calibrated probes.

    Raises:
        DataFileError: A printed table cannot be read.

    """
    path = data_path(BUDGET_FILE)
    rows = read_table(path, ["kind", "perturbation", "value", "value_unit", *BUDGET_COLUMNS])
    printed_factors = {(cell.row, cell.column): cell.printed.number for cell in table_5_2().cells}
    cells = [
        cell
        for column in BUDGET_COLUMNS
        for cell in _budget_column(column, rows, printed_cells(rows, column, path), printed_factors)
    ]
    return BudgetTable("7.12", "impedance probes as calibrated (uin, urad)", tuple(cells))


def _budget_column(
    column: str, rows: Sequence[Row], printed: Sequence[Printed], printed_factors: Mapping[tuple[str, str], float]
) -> list[Cell]:
    """Return a column of table 7.12; rows without a value are root sums of squares of the rows above them."""
    output = BUDGET_COLUMNS[column]
    cells: list[Cell] = []
    sums: dict[str, float] = {}
    for row, number in zip(rows, printed, strict=True):
        kind = row["kind"]
        if row["value"]:
            unit = _unit(row)
            row_factor = _row_factor(row, output)
            computed = row_factor * float(row["value"]) * unit
            rounding = row_factor * 0.5 * last_digit(row["value"]) * unit
            reason = _printed_factor_reason(row, output, printed_factors) or Reason(
                "a guess: the model's number rounded up in print; 7 times .41, the factor of sigma_l to two digits, "
                "is 2.87 and fits as well",
                computed,
            )
        else:
            parts = [cell for cell in cells if cell.row.startswith(kind)]
            computed = root_sum_square(*(sums.values() if kind == TOTAL else (cell.computed for cell in parts)))
            rounding = sum(cell.computed * cell.input_rounding for cell in parts) / computed
            sums[kind] = computed
            numbers = [(one, p.number) for one, p in zip(rows, printed, strict=True) if one["kind"] == kind]
            reason = _sum_reason(kind, output, [part for part in numbers if part[0]["value"]], printed_factors)
        cells.append(Cell("7.12", f"{kind}: {row['perturbation']}", column, number, computed, rounding, reason))
    return cells


def _unit(row: Row) -> float:
    """Return the factor that turns the value of a row into uin or urad."""
    return 1e6 if row["value_unit"] == "in" else 1.0


def _factor_row(perturbation: str) -> str | None:
    """Return the row of table 5.2 with the factor of a perturbation; None: it affects a single probe."""
    if "as sigma_l" in perturbation:
        return "sigma_l"
    return perturbation if perturbation in LEVERS else None


def _row_factor(row: Row, output: str) -> float:
    name = _factor_row(row["perturbation"])
    if name is not None:
        return abs(factor(name, output))
    return abs(_model(WORST).reading_sensitivity(output, f"gap probe_{row['perturbation'][-1]}"))


def _printed_factor_reason(row: Row, output: str, factors: Mapping[tuple[str, str], float]) -> Reason | None:
    """Return the reason of a row that the thesis worked out with a printed factor of table 5.2."""
    name = _factor_row(row["perturbation"])
    if row["kind"] != INCREASING or name is None:
        return None
    printed = factors[name, output]
    text = f"the factor as table 5.2 prints it, {printed:g} of {name}, times the value"
    return Reason(text, abs(printed) * float(row["value"]) * _unit(row))


def _sum_reason(
    kind: str, output: str, parts: Sequence[tuple[Row, float]], factors: Mapping[tuple[str, str], float]
) -> Reason:
    """Return the reason of a row that sums up others; ``parts``: rows of its kind with their printed cells."""
    if kind == TOTAL:
        given = ", ".join(f"{name[-1]} {value:g}" for name, value in OTHER_SIGMAS.items())
        return Reason(
            f"not of the table's values: follows from the factors printed in table 5.2 with sigmas of {given} in "
            "(derived: three numbers fitted to the four cells of this row)",
            root_sum_square(*(factors[name, output] * 1e6 * sigma for name, sigma in OTHER_SIGMAS.items())),
        )
    if kind == RANDOM:
        return Reason("root sum square of the rounded cells", root_sum_square(*(number for _, number in parts)))
    parts = [part for part in parts if not part[0]["perturbation"].startswith("voltage supply")]
    text = "root sum square of the printed cells without the rows of the supply voltage"
    if output == BETA:
        text += ", and with 7, which the scan shows, as the last cell of the three rows that go as sigma_l"
        parts = [(row, SCANNED_LAST_CELL if "as sigma_l" in row["perturbation"] else number) for row, number in parts]
    return Reason(text, root_sum_square(*(number for _, number in parts)))
