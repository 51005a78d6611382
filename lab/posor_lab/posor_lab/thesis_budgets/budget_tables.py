# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables 5.2, 5.4, 7.9 and 7.12 of the thesis, cell by cell: printed number, number of the model, reason.

``budgets`` of ``03_budgets.yaml`` has the tables: ``title``, ``file`` with the printed cells, ``name`` of a row,
``columns`` (the ``{output}`` of each) and two lists of rules. A rule applies to the rows and columns that match its
regular expressions ``rows`` and ``columns``; the first rule that applies counts:

- ``values``: ``value``, the effect of a unit. Rows with a size multiply it by ``unit`` times size to the ``power``.
  Instead of ``value``: ``parts``, the rows whose root sum square the row is.
- ``reasons``: why a printed cell differs (``text``), the number that follows from this reason (``gives``), and as
  needed ``values``, as in a row of the thesis table. ``$computed``, ``$size``, ``$printed`` (cells of the column by
  row) and ``$same_row`` (computed cells by column) are known.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from posor.calibration.calibration_file import load_calibration
from posor.estimation.posor import Posor
from posor.uncertainty.budget_poses import middle_pose, scan_at
from posor.uncertainty.budget_quantities import THETA
from posor.uncertainty.first_order import sensitivities
from scipy.constants import inch

from posor_lab.harness.rig_files import calibration_path
from posor_lab.thesis_budgets.chapter5 import root_sum_square
from posor_lab.thesis_data import data_path, last_digit, parse_number, read_table
from posor_lab.thesis_table.row_file import RowFile
from posor_lab.thesis_table.thesis_row import Agreement, ThesisRow, agrees_within

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

FACTOR_FILES = ("error_budget_table_5_2_probes.csv", "error_budget_table_5_4_diodes.csv")
FITS_FILE = "error_budget_table_7_7_diode_fits.csv"
DIODE_FILE = "error_budget_table_7_9_diodes.csv"
PROBE_FILE = "error_budget_table_7_12_probes.csv"
DIODE_TOTAL = "root mean square: total"
_UNITS = ("uin", "urad")
_DISTANCES = {"l_0_0": "the distance at (0, 0) in", "l_m1_1p5": "the distance at (-1, 1.5) in"}


@dataclass(frozen=True)
class BudgetCell:
    """One cell of a table."""

    table: str  # number of the table
    row: str  # the perturbation
    column: str  # the quantity that it affects
    printed: str  # the printed digits; ``nan``: not legible
    last_digit: float  # one unit of the last printed digit
    computed: float  # the number of the model, in the same unit
    input_rounding: float = 0.0  # possible change of ``computed`` by the rounding of the printed perturbation
    reason: str = ""  # how the thesis calculated the cell, inferred from the numbers; empty: unknown
    gives: float = math.nan  # the number that follows from the reason, in the unit of the cell

    @property
    def printed_number(self) -> float:
        """The printed number; NaN: not legible."""
        return float(self.printed)

    @property
    def ratio(self) -> float:
        """Computed over printed; NaN if the cell is not legible or both are zero."""
        if self.printed_number == 0.0:
            return math.nan if self.computed == 0.0 else math.inf
        return self.computed / self.printed_number

    @property
    def agreement(self) -> Agreement:
        """Result of the comparison, which is stricter than for a row of the thesis table.

        A cell agrees if the rounding of the cell (half a unit of its last digit) and of the printed perturbation covers
        the difference. A reason explains a cell within a whole unit, because some printed digits are cut, not rounded.
        """
        printed, unit = self.printed_number, self.last_digit
        if math.isnan(printed):
            return Agreement.NOT_LEGIBLE
        if agrees_within(0.5 * unit + self.input_rounding, self.computed, printed):
            return Agreement.AGREES
        explained = agrees_within(unit + self.input_rounding, self.gives, printed)
        return Agreement.EXPLAINED if explained else Agreement.DIFFERS

    @property
    def thesis_columns(self) -> dict[str, Any]:
        """The cell as columns for ``03_budgets.yaml``."""
        name, _, unit = self.column.rpartition("_")
        column, unit = (name, unit) if unit in _UNITS else (self.column, "in, rad")
        column = column.removeprefix("induced_").removeprefix("sigma_")
        digits = self.printed if self.printed_number else f"{0.0:.{max(0, round(-math.log10(self.last_digit)))}f}"
        digits = "" if math.isnan(self.printed_number) else digits  # a bare 0 gets the digits of its column
        agrees = ThesisRow("", "", "", digits, self.computed).verdict is Agreement.AGREES
        reasons = {
            Agreement.NOT_LEGIBLE: "not legible in the scan",
            Agreement.EXPLAINED: f"{self.reason}: {self.gives:.4g}",
            Agreement.DIFFERS: "no reason is known",
            Agreement.AGREES: "" if agrees else "within the rounding of the cell and of the printed perturbation",
        }
        return {
            "table": self.table,
            "row": self.row,
            "column": _DISTANCES.get(column, column),
            "unit": unit,
            "printed": digits,
            "computed": self.computed,
            "rounding": self.input_rounding,
            "reason": reasons[self.agreement],
        }


@dataclass(frozen=True)
class BudgetTable:
    """A table of the thesis: number such as ``5.2``, title, and cells column by column."""

    number: str
    title: str
    cells: tuple[BudgetCell, ...]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns, in printed order."""
        return tuple(dict.fromkeys(cell.column for cell in self.cells))

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the rows, in printed order."""
        return tuple(dict.fromkeys(cell.row for cell in self.cells))

    @property
    def holds(self) -> bool:
        """Whether every difference is explained."""
        return all(cell.agreement is not Agreement.DIFFERS for cell in self.cells)

    def cell(self, row: str, column: str) -> BudgetCell:
        """Return one cell."""
        return next(cell for cell in self.cells if (cell.row, cell.column) == (row, column))


def budget_tables() -> dict[str, BudgetTable]:
    """Return the tables by number.

    Raises DataFileError: a printed table cannot be read, or a cell of it is not a number.
    """
    file = RowFile(data_path("thesis_rows/03_budgets.yaml"))
    return {number: _table(file, number, content) for number, content in file.content["budgets"].items()}


def _table(file: RowFile, number: str, content: Mapping[str, Any]) -> BudgetTable:
    file.enter("budgets", content, "title")
    file.check_keys(content, ("title", "file", "name", "columns", "values", "reasons"), ())
    path = data_path(content["file"])
    rows = read_table(path, content["columns"])
    cells: dict[tuple[str, str], BudgetCell] = {}
    names = [file.fill(content["name"], row) for row in rows]
    for column, output in content["columns"].items():
        places = [f"{path}, row {n}" for n in range(1, len(rows) + 1)]
        numbers = [
            parse_number(*each) for each in ((row, column, place) for row, place in zip(rows, places, strict=True))
        ]
        units = [last_digit(row[column]) for row in rows]
        printed = dict(zip(names, numbers, strict=True))
        for name, row, unit in zip(names, rows, units, strict=True):
            known: dict[str, Any] = {**row, "output": output, "printed": printed}
            known["same_row"] = {cell.column: cell.computed for cell in cells.values() if cell.row == name}
            rule = _first_rule(content["values"], name, column)
            if "parts" in rule:
                parts = [c for c in cells.values() if c.column == column and re.fullmatch(rule["parts"], c.row)]
                computed = root_sum_square(*(part.computed for part in parts))
                rounding = sum(part.computed * part.input_rounding for part in parts) / computed
            else:
                size, rounding = _size(row, rule)
                effect = float(file.evaluate(rule["value"], known))
                computed, rounding, known["size"] = effect * size, effect * rounding, size
            known["computed"] = computed
            reason = _first_rule(content["reasons"], name, column)
            known = next(iter(file.combinations(reason, known)))
            gives = float(file.evaluate(reason["gives"], known)) if reason else math.nan
            last = min(units) if printed[name] == 0.0 else unit  # a bare 0 has the finest last digit of its column
            text = file.fill(reason.get("text", ""), known)
            cells[name, column] = BudgetCell(number, name, column, row[column], last, computed, rounding, text, gives)
    return BudgetTable(number, content["title"], tuple(cells.values()))


def _first_rule(rules: Sequence[Mapping[str, Any]], row: str, column: str) -> Mapping[str, Any]:
    """Return the first rule that applies to a cell; empty: no rule applies."""
    applying = (
        rule
        for rule in rules
        if re.fullmatch(rule.get("rows", ".*"), row) and re.fullmatch(rule.get("columns", ".*"), column)
    )
    return next(applying, {})


def _size(row: Mapping[str, str], rule: Mapping[str, str]) -> tuple[float, float]:
    """Return the size of a perturbation in the unit of the cells, and the effect of half its last digit."""
    if "value" not in row:
        return 1.0, 0.0
    value, unit, power = float(row["value"]), float(rule.get("unit", "1")), int(rule.get("power", "1"))
    return unit * value**power, unit * power * value ** (power - 1) * 0.5 * last_digit(row["value"])


def budget_cells() -> list[dict[str, Any]]:
    """Return the cells for the thesis table, without perturbations that have no effect, in print and in the model.

    Raises DataFileError: a printed table cannot be read.
    """
    cells = (cell for table in budget_tables().values() for cell in table.cells)
    return [cell.thesis_columns for cell in cells if cell.printed_number != 0.0 or cell.computed != 0.0]


def computed_cell(table: str, row: str, column: str) -> float:
    """Return a cell by the model [uin or urad]."""
    return budget_tables()[table].cell(row, column).computed


def printed_factor(row: str, column: str) -> float:
    """Return a printed factor of table 5.2 or 5.4."""
    rows = (each for name in FACTOR_FILES for each in read_table(data_path(name), ["perturbation"]))
    return next(float(each[column]) for each in rows if each["perturbation"] == row and column in each)


def fits_of_linearisation() -> dict[str, tuple[float, float]]:
    """Return the values of table 7.9's linearisation rows, and the mean deviations of ninth order of table 7.7 [uin].

    Raises DataFileError: a printed table cannot be read.
    """
    fits = {row["quantity"]: row for row in read_table(data_path(FITS_FILE), ["quantity"])}["mean_order9"]
    rows = read_table(data_path(DIODE_FILE), ["group", "perturbation", "value"])
    names = {row["perturbation"]: row["value"] for row in rows if row["group"] == "linearisation"}
    return {name: (float(value), float(fits[f"{name[-1]}{name[-2]}_uin"])) for name, value in names.items()}


def rig_theta(diodes: BudgetTable) -> tuple[float, float, float]:
    """Return theta of table 7.9 for the real rig, whose spots are apart along Y: derived, not printed.

    Returns effect of an inch of x, and of y, of a spot on theta [rad] by the calibration of the rig, and the root sum
    square of the rows with these [urad].
    """
    posor = Posor(load_calibration(calibration_path("section84")).for_session("ymo"))
    pose = middle_pose(posor)
    by_reading = sensitivities(posor, scan_at(posor, pose), pose).by_reading[THETA]
    names = [posor.stack.reading_names.index(f"spot {axis} diode_1") for axis in "xy"]
    by_x, by_y = (abs(float(by_reading[name])) * inch for name in names)
    x, y = (diodes.cell(DIODE_TOTAL, f"induced_sigma_{axis}_uin").computed for axis in "XY")
    return by_x, by_y, root_sum_square(by_x * x, by_y * y)
