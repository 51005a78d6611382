"""The error budgets of light sources and diodes, tables 5.4 and 7.9 of the thesis, from the model.

X and Y are those of chapter 5, whose cotangent form (equation 5.34) has the spots apart along X.
"""

from __future__ import annotations

import math
import re
from functools import cache
from typing import TYPE_CHECKING

from posor_estimator.core.budget.first_order import sensitivities
from posor_estimator.core.budget.outputs import THETA
from posor_estimator.core.budget.poses import middle_pose, scan_at
from posor_estimator.core.calibration.load import load_calibration
from posor_estimator.core.design_parts import INCH
from posor_estimator.core.posor import Posor
from posor_estimator.errors import DataFileError

from posor_bringup.budget_cells import BudgetTable, Cell, Reason, last_digit, printed_cells
from posor_bringup.chapter5 import LEG_X, LEG_Y, Chapter5, Slopes, root_sum_square
from posor_bringup.installed import calibration_path, data_path
from posor_bringup.thesis import read_table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_bringup.chapter5 import Axis

FACTORS_FILE = "error_budget_table_5_4_diodes.csv"
FITS_FILE = "error_budget_table_7_7_diode_fits.csv"
BUDGET_FILE = "error_budget_table_7_9_diodes.csv"
FACTOR_COLUMNS = ("sigma_X", "sigma_Y", "theta_X", "theta_Y")
BUDGET_COLUMNS = ("induced_sigma_X_uin", "induced_sigma_Y_uin", "induced_sigma_theta_urad")
TOTAL = "root mean square"

SLANT = 1.0 + (LEG_Y / LEG_X) ** 2
_SLANT = ".5/9 printed for what goes by X; the spots are root(3^2 + .5^2) in apart then: the model has .5/9.25"
REPEATABILITY_Y_UIN = 35.0
"""Repeatability of the offset of the diodes along Y, section 7.4.4."""

SPOT_X, SPOT_Y = "spot x diode_1", "spot y diode_1"
OFFSET, LINEARISATION = "axes offset", "linearisation"
"""Groups of table 7.9 whose shift is one of the diode, and one of its map; in the others it is one of the reading."""

_U, _V = "Diodes.x_axes[{},0]", "Diodes.y_axes[{},0]"
_TURNS: Mapping[str, Axis] = {"Xalpha": "x", "Ybeta": "y", "Ztheta": "z"}
"""Perturbations that turn a diode, and about which axis."""
_SKEW = "Zgamma"
_RAYS: Mapping[str, int] = {"Xlalpha": 0, "Ylbeta": 1}
"""Perturbations that lean a ray, and which component of its direction they change."""
_SHIFTS: Mapping[str, int] = {"X": 0, "Y": 1}
_FITS: Mapping[str, str] = {f"sigma_{axis}{k}": f"{k}{axis}_uin" for k in (1, 2) for axis in "XY"}
"""Columns of table 7.7, by row of table 7.9."""
SQUARED = (*_TURNS, _SKEW)
"""Perturbations of which the square counts."""


@cache
def _model() -> Chapter5:
    return Chapter5(Slopes())


def kind_of(perturbation: str) -> str:
    """Return a perturbation's name without the number of its diode or light source: ``Xlalpha`` of sigma_Xl1alpha."""
    return re.sub(r"[\d_]", "", perturbation.removeprefix("sigma_"))


@cache
def spot_shifts(perturbation: str, group: str = OFFSET) -> tuple[float, float]:
    """Return what a unit of a perturbation, or of its square, does to X and Y of its diode's spot, in inch and radian.

    Args:
        perturbation: As tables 5.4 and 7.9 name it, such as ``sigma_Xalpha1``; without a number: of diode 1.
        group: The group of table 7.9 that it stands in.

    Raises:
        DataFileError: There is no such perturbation.

    """
    kind = kind_of(perturbation)
    k = int((re.findall(r"\d", perturbation) or ["1"])[0]) - 1
    return _shift(f"spot x diode_{k + 1}", k, kind, group), _shift(f"spot y diode_{k + 1}", k, kind, group)


def _shift(spot: str, k: int, kind: str, group: str) -> float:
    model = _model()
    u, v = _U.format(k), _V.format(k)
    if kind in _RAYS:
        return abs(model.shift_by_angle(spot, f"Diodes.source_directions[{k},{_RAYS[kind]}]"))
    if kind in _TURNS:
        return model.shift_by_square(spot, {u: _TURNS[kind], v: _TURNS[kind]})
    if kind == _SKEW:  # each axis out of square to the other
        return root_sum_square(model.shift_by_square(spot, {u: "z"}), model.shift_by_square(spot, {v: "z"}))
    if kind not in _SHIFTS:
        raise DataFileError(f"perturbation 'sigma_{kind}' is unknown", expected="one of table 5.4")
    which = _SHIFTS[kind]
    if group == OFFSET:
        return abs(model.shift(spot, f"Diodes.origins[{k},{which}]"))
    if group == LINEARISATION:
        return abs(model.shift(spot, f"Diodes.maps[{k},{4 * which}]"))
    return float(spot.startswith(f"spot {'xy'[which]}"))


@cache
def theta_factors() -> tuple[float, float]:
    """Return what an inch of a spot's X, and of its Y, does to theta [rad].

    Each is taken where it is largest: that of X with the spots .5 in apart along Y, that of Y with none.
    """
    level = Chapter5(Slopes(), leg_y=0.0)
    return abs(_model().by_reading("theta", SPOT_X)), abs(level.by_reading("theta", SPOT_Y))


def printed_theta_factors() -> tuple[float, float]:
    """Return the same as the thesis reckons them: .5/9 and 1/3."""
    by_x, by_y = theta_factors()
    return by_x * SLANT, by_y


def table_5_4() -> BudgetTable:
    """Return table 5.4: factors of the diodes' budget.

    Raises:
        DataFileError: The printed table cannot be read.

    """
    path = data_path(FACTORS_FILE)
    rows = read_table(path, ["perturbation", *FACTOR_COLUMNS])
    names = tuple(row["perturbation"] for row in rows)
    cells = [
        Cell("5.4", name, column, printed, factor(name, column), reason=_reason_of_factor(name, column))
        for column in FACTOR_COLUMNS
        for name, printed in zip(names, printed_cells(rows, column, path), strict=True)
    ]
    return BudgetTable("5.4", "light sources and diodes, factors (inch, radian)", FACTOR_COLUMNS, names, tuple(cells))


def factor(perturbation: str, column: str) -> float:
    """Return the model's factor for a cell of table 5.4, in inch and radian; no sign in the column theta_X."""
    which = "XY".index(column[-1])
    shift = spot_shifts(perturbation)[which]
    if column.startswith("sigma"):
        return shift
    return theta_factors()[which] * (abs(shift) if which == 0 else shift)


def _reason_of_factor(perturbation: str, column: str) -> Reason | None:
    computed = factor(perturbation, column)
    if column == "theta_X" and kind_of(perturbation) == _SKEW:
        text = f"divided by root 2, as its neighbour theta_Y is not; and {_SLANT}"
        return Reason(text, computed * SLANT / math.sqrt(2.0))
    if column == "theta_X":
        return Reason(_SLANT, computed * SLANT)
    if column == "sigma_X" and computed < 0.0:
        return Reason("the sign: turning both axes shortens either coordinate; squared it has no effect", -computed)
    return None


def table_7_9() -> BudgetTable:
    """Return table 7.9: budget of the calibrated diodes.

    Raises:
        DataFileError: The printed table cannot be read.

    """
    path = data_path(BUDGET_FILE)
    rows = read_table(path, ["group", "perturbation", "value", "value_unit", *BUDGET_COLUMNS])
    names = tuple(f"{row['group']}: {row['perturbation']}" for row in rows)
    cells = []
    for i, column in enumerate(BUDGET_COLUMNS):
        made: list[Cell] = []
        for row, name, printed in zip(rows, names, printed_cells(rows, column, path), strict=True):
            if row["value"]:
                size, half_unit = _size(row)
                by_unit = _effects(row, theta_factors())[i]
                computed, rounding = by_unit * size, by_unit * half_unit
            else:
                computed = root_sum_square(*(cell.computed for cell in made))
                rounding = sum(cell.computed * cell.input_rounding for cell in made) / computed
            made.append(Cell("7.9", name, column, printed, computed, rounding, _reason(row, column, rows)))
        cells.extend(made)
    return BudgetTable("7.9", "light sources and diodes as calibrated (uin, urad)", BUDGET_COLUMNS, names, tuple(cells))


def _effects(row: Mapping[str, str], by_spot: tuple[float, float]) -> tuple[float, float, float]:
    """Return what a unit does to X and Y of a spot and, with what these do to it, to theta."""
    x, y = (abs(shift) for shift in spot_shifts(row["perturbation"], row["group"]))
    return x, y, root_sum_square(by_spot[0] * x, by_spot[1] * y)


def _size(row: Mapping[str, str]) -> tuple[float, float]:
    """Return a perturbation, or its square, in units that make uin and urad, and what half a unit of it makes."""
    value, half = float(row["value"]), 0.5 * last_digit(row["value"])
    if kind_of(row["perturbation"]) in SQUARED:
        return value**2 * 1e-6, 2.0 * value * half * 1e-6
    return value, half


def fits_of_linearisation() -> dict[str, tuple[float, float]]:
    """Return the values of table 7.9's linearisation rows, and the mean deviations of ninth order of table 7.7 [uin].

    Raises:
        DataFileError: A printed table cannot be read.

    """
    fits = {row["quantity"]: row for row in read_table(data_path(FITS_FILE), ["quantity", *_FITS.values()])}
    rows = read_table(data_path(BUDGET_FILE), ["group", "perturbation", "value"])
    return {
        row["perturbation"]: (float(row["value"]), float(fits["mean_order9"][_FITS[row["perturbation"]]]))
        for row in rows
        if row["group"] == LINEARISATION
    }


def _reason(row: Mapping[str, str], column: str, rows: Sequence[Mapping[str, str]]) -> Reason | None:
    by_x, by_y = printed_theta_factors()
    kind = kind_of(row["perturbation"]) if row["value"] else ""
    about_theta = column == BUDGET_COLUMNS[2]
    if row["group"] == OFFSET and kind == "Y":
        text = "made of the repeatability, .000035 in (7.4.4), not of the value in the row"
        return Reason(text, REPEATABILITY_Y_UIN * (by_y if about_theta else 1.0))
    if not about_theta:
        return None
    if not row["value"]:
        every = [_effects(one, (by_x, by_y))[2] * _size(one)[0] for one in rows if one["value"]]
        return Reason(_SLANT, root_sum_square(*every))
    if kind in {"Xalpha", "Ybeta"}:
        text = "factors of X and Y exchanged against table 5.4"
        return Reason(text, _effects(row, (by_y, by_x))[2] * _size(row)[0])
    if kind == "Ylbeta":
        by_angle = table_5_4().cell("sigma_Yl_beta", "theta_Y").printed.number
        return Reason(f"the factor as table 5.4 prints it, {by_angle}, times the value", by_angle * _size(row)[0])
    return Reason(_SLANT, _effects(row, (by_x, by_y))[2] * _size(row)[0])


def rig_theta() -> tuple[float, float, float]:
    """Return what table 7.9 makes of theta in the real rig, which has its spots apart along Y: derived, not printed.

    Returns:
        What an inch of a spot's x, and of its y, does to theta [rad] by the rig's calibration, and the root sum square
        of the table's rows with these [urad].

    """
    posor = Posor(load_calibration(calibration_path("section84")).for_session("ymo"))
    pose = middle_pose(posor)
    by_reading = sensitivities(posor, scan_at(posor, pose), pose).by_reading[THETA]
    names = posor.stack.reading_names
    by_x, by_y = (abs(float(by_reading[names.index(f"spot {c} diode_1")])) * INCH for c in "xy")
    path = data_path(BUDGET_FILE)
    rows = [row for row in read_table(path, ["group", "perturbation", "value"]) if row["value"]]
    total = root_sum_square(*(_effects(row, (by_x, by_y))[2] * _size(row)[0] for row in rows))
    return by_x, by_y, total
