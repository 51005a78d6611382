"""The error budgets of light sources and diodes, tables 5.4 and 7.9 of the thesis, from the model.

X and Y are those of chapter 5, whose cotangent form (equation 5.34) has the spots apart along X.
"""

from __future__ import annotations

import math
import re
from functools import cache
from typing import TYPE_CHECKING

from posor.calibration.calibration_file import load_calibration
from posor.errors import DataFileError
from posor.estimation.posor import Posor
from posor.uncertainty.budget_poses import middle_pose, scan_at
from posor.uncertainty.budget_quantities import THETA
from posor.uncertainty.first_order import sensitivities
from posor_bringup.installed import calibration_path
from scipy.constants import inch

from posor_lab.thesis_budgets.budget_cells import BudgetTable, Cell, Reason, printed_cells
from posor_lab.thesis_budgets.chapter5 import LEG_X, LEG_Y, Chapter5, Slopes, root_sum_square
from posor_lab.thesis_data import data_path, last_digit, read_table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_lab.thesis_budgets.chapter5 import Axis

    Row = Mapping[str, str]

FACTORS_FILE = "error_budget_table_5_4_diodes.csv"
FITS_FILE = "error_budget_table_7_7_diode_fits.csv"
BUDGET_FILE = "error_budget_table_7_9_diodes.csv"
FACTOR_COLUMNS = ("sigma_X", "sigma_Y", "theta_X", "theta_Y")
BUDGET_COLUMNS = ("induced_sigma_X_uin", "induced_sigma_Y_uin", "induced_sigma_theta_urad")

SLANT = 1.0 + (LEG_Y / LEG_X) ** 2
_SLANT_REASON = ".5/9 printed for what goes by X; the spots are root(3^2 + .5^2) in apart then: the model has .5/9.25"
REPEATABILITY_Y_UIN = 35.0
"""Repeatability of the offset of the diodes along Y, section 7.4.4."""

SPOT_X, SPOT_Y = "spot x diode_1", "spot y diode_1"
OFFSET, LINEARISATION = "axes offset", "linearisation"
"""Groups of table 7.9 whose shift affects the diode or its map; in the other groups it affects the reading."""

_TURNS: Mapping[str, Axis] = {"Xalpha": "x", "Ybeta": "y", "Ztheta": "z"}
"""Perturbations that turn a diode, and the axis about which it turns."""
_SKEW = "Zgamma"
_RAYS: Mapping[str, int] = {"Xlalpha": 0, "Ylbeta": 1}
"""Perturbations that lean a ray, and the component of its direction that they change."""
_SHIFTS: Mapping[str, int] = {"X": 0, "Y": 1}
_FITS: Mapping[str, str] = {f"sigma_{axis}{k}": f"{k}{axis}_uin" for k in (1, 2) for axis in "XY"}
"""Columns of table 7.7, by row of table 7.9."""


@cache
def _model() -> Chapter5:
    return Chapter5(Slopes())


def _perturbation_kind(perturbation: str) -> str:
    """Return the name without the number of the diode or light source: ``Xlalpha`` of sigma_Xl1alpha."""
    return re.sub(r"[\d_]", "", perturbation.removeprefix("sigma_"))


@cache
def spot_shifts(perturbation: str, group: str = OFFSET) -> tuple[float, float]:
    """Return the effect of a unit of a perturbation, or of its square, on X and Y of the spot, in inch and radian.

    Args:
        perturbation: Name in tables 5.4 and 7.9, such as ``sigma_Xalpha1``; without a number: of diode 1.
        group: Group of the row in table 7.9.

    Raises:
        DataFileError: The perturbation is unknown.

    """
    kind = _perturbation_kind(perturbation)
    k = int((re.findall(r"\d", perturbation) or ["1"])[0]) - 1
    return _shift(f"spot x diode_{k + 1}", k, kind, group), _shift(f"spot y diode_{k + 1}", k, kind, group)


def _shift(spot: str, k: int, kind: str, group: str) -> float:
    model = _model()
    x_axis, y_axis = f"Diodes.x_axes[{k},0]", f"Diodes.y_axes[{k},0]"
    if kind in _RAYS:
        return abs(model.reading_shift(spot, f"Diodes.source_directions[{k},{_RAYS[kind]}]") / inch)
    if kind in _TURNS:
        return model.quadratic_shift(spot, {x_axis: _TURNS[kind], y_axis: _TURNS[kind]})
    if kind == _SKEW:  # each axis out of square to the other
        return root_sum_square(*(model.quadratic_shift(spot, {axis: "z"}) for axis in (x_axis, y_axis)))
    if kind not in _SHIFTS:
        raise DataFileError(f"perturbation 'sigma_{kind}' is unknown", expected="one of table 5.4")
    component = _SHIFTS[kind]
    if group == OFFSET:
        return abs(model.reading_shift(spot, f"Diodes.origins[{k},{component}]"))
    if group == LINEARISATION:
        return abs(model.reading_shift(spot, f"Diodes.maps[{k},{4 * component}]"))
    return float(spot.startswith(f"spot {'xy'[component]}"))


@cache
def theta_factors() -> tuple[float, float]:
    """Return the effect of an inch of X, and of Y, of a spot on theta [rad].

    Each is taken where it is largest: that of X with the spots 0.5 in apart along Y, that of Y with none.
    """
    level = Chapter5(Slopes(), leg_y=0.0)
    return abs(_model().reading_sensitivity("theta", SPOT_X)), abs(level.reading_sensitivity("theta", SPOT_Y))


def table_5_4() -> BudgetTable:
    """Return table 5.4: factors of the diodes' budget.

    Raises:
        DataFileError: The printed table cannot be read.

    """
    path = data_path(FACTORS_FILE)
    rows = read_table(path, ["perturbation", *FACTOR_COLUMNS])
    cells = []
    for column in FACTOR_COLUMNS:
        for row, printed in zip(rows, printed_cells(rows, column, path), strict=True):
            computed, reason = _factor(row["perturbation"], column)
            cells.append(Cell("5.4", row["perturbation"], column, printed, computed, reason=reason))
    return BudgetTable("5.4", "light sources and diodes, factors (inch, radian)", tuple(cells))


def _factor(perturbation: str, column: str) -> tuple[float, Reason | None]:
    """Return the factor of a cell of table 5.4 (inch, radian; unsigned in theta_X), and the reason of a difference."""
    index = "XY".index(column[-1])
    shift = spot_shifts(perturbation)[index]
    if column == "sigma_X" and shift < 0.0:
        reason = Reason("the sign: turning both axes shortens either coordinate; squared it has no effect", -shift)
        return shift, reason
    if column.startswith("sigma"):
        return shift, None
    if column == "theta_Y":
        return theta_factors()[index] * shift, None
    computed = theta_factors()[index] * abs(shift)
    if _perturbation_kind(perturbation) == _SKEW:
        text = f"divided by root 2, as its neighbour theta_Y is not; and {_SLANT_REASON}"
        return computed, Reason(text, computed * SLANT / math.sqrt(2.0))
    return computed, Reason(_SLANT_REASON, computed * SLANT)


def table_7_9() -> BudgetTable:
    """Return table 7.9: budget of the calibrated diodes.

    Raises:
        DataFileError: The printed table cannot be read.

    """
    path = data_path(BUDGET_FILE)
    rows = read_table(path, ["group", "perturbation", "value", "value_unit", *BUDGET_COLUMNS])
    cells: list[Cell] = []
    for i, column in enumerate(BUDGET_COLUMNS):
        column_cells: list[Cell] = []
        for row, printed in zip(rows, printed_cells(rows, column, path), strict=True):
            if row["value"]:
                size, half_digit = _size(row)
                effect = _effects(row, theta_factors())[i]
                computed, rounding = effect * size, effect * half_digit
            else:
                computed = root_sum_square(*(cell.computed for cell in column_cells))
                rounding = sum(cell.computed * cell.input_rounding for cell in column_cells) / computed
            name = f"{row['group']}: {row['perturbation']}"
            column_cells.append(Cell("7.9", name, column, printed, computed, rounding, _reason(row, column, rows)))
        cells.extend(column_cells)
    return BudgetTable("7.9", "light sources and diodes as calibrated (uin, urad)", tuple(cells))


def _effects(row: Row, by_spot: tuple[float, float]) -> tuple[float, float, float]:
    """Return the effect of a unit on X and Y of a spot and, by the effects ``by_spot`` of these, on theta."""
    x, y = (abs(shift) for shift in spot_shifts(row["perturbation"], row["group"]))
    return x, y, root_sum_square(by_spot[0] * x, by_spot[1] * y)


def _size(row: Row) -> tuple[float, float]:
    """Return a perturbation, or its square, in units that give uin and urad, and the effect of half its last digit."""
    value, half = float(row["value"]), 0.5 * last_digit(row["value"])
    if _perturbation_kind(row["perturbation"]) in (*_TURNS, _SKEW):  # these act by their square
        return value**2 * 1e-6, 2.0 * value * half * 1e-6
    return value, half


def fits_of_linearisation() -> dict[str, tuple[float, float]]:
    """Return the values of table 7.9's linearisation rows, and the mean deviations of ninth order of table 7.7 [uin].

    Raises:
        DataFileError: A printed table cannot be read.

    """
    fits = {row["quantity"]: row for row in read_table(data_path(FITS_FILE), ["quantity", *_FITS.values()])}
    return {
        row["perturbation"]: (float(row["value"]), float(fits["mean_order9"][_FITS[row["perturbation"]]]))
        for row in read_table(data_path(BUDGET_FILE), ["group", "perturbation", "value"])
        if row["group"] == LINEARISATION
    }


def _reason(row: Row, column: str, rows: Sequence[Row]) -> Reason | None:
    """Return the reason of a difference in table 7.9."""
    by_x, by_y = theta_factors()
    by_x *= SLANT  # the factors of the thesis are .5/9 and 1/3
    kind = _perturbation_kind(row["perturbation"]) if row["value"] else ""
    is_theta = column == BUDGET_COLUMNS[2]
    if row["group"] == OFFSET and kind == "Y":
        text = "made of the repeatability, .000035 in (7.4.4), not of the value in the row"
        return Reason(text, REPEATABILITY_Y_UIN * (by_y if is_theta else 1.0))
    if not is_theta:
        return None
    if not row["value"]:
        return Reason(_SLANT_REASON, _theta_total(rows, by_x, by_y))
    if kind in {"Xalpha", "Ybeta"}:
        return Reason("factors of X and Y exchanged against table 5.4", _effects(row, (by_y, by_x))[2] * _size(row)[0])
    if kind == "Ylbeta":
        by_angle = table_5_4().cell("sigma_Yl_beta", "theta_Y").printed.number
        return Reason(f"the factor as table 5.4 prints it, {by_angle}, times the value", by_angle * _size(row)[0])
    return Reason(_SLANT_REASON, _effects(row, (by_x, by_y))[2] * _size(row)[0])


def _theta_total(rows: Sequence[Row], by_x: float, by_y: float) -> float:
    """Return the root sum square of theta [urad] over rows of table 7.9."""
    return root_sum_square(*(_effects(row, (by_x, by_y))[2] * _size(row)[0] for row in rows if row["value"]))


def rig_theta() -> tuple[float, float, float]:
    """Return theta of table 7.9 for the real rig, whose spots are apart along Y: derived, not printed.

    Returns:
        Effect of an inch of x, and of y, of a spot on theta [rad] by the calibration of the rig, and the root sum
        square of the rows with these [urad].

    """
    posor = Posor(load_calibration(calibration_path("section84")).for_session("ymo"))
    pose = middle_pose(posor)
    by_reading = sensitivities(posor, scan_at(posor, pose), pose).by_reading[THETA]
    names = posor.stack.reading_names
    by_x, by_y = (abs(float(by_reading[names.index(spot)])) * inch for spot in (SPOT_X, SPOT_Y))
    rows = read_table(data_path(BUDGET_FILE), ["group", "perturbation", "value"])
    return by_x, by_y, _theta_total(rows, by_x, by_y)
