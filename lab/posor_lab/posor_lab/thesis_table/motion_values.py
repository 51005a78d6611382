# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Functions and figures of the motion tests of chapter 8: predictions, replays, and the tables of TWIS and GEN."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from posor.reporting.figure_style import BLUE, GREY, LIGHT_BLUE, ORANGE
from posor.reporting.plot import Plot
from posor_calibration.attitude_fit import deviation_from_first

from posor_lab.harness.rig_files import BAGS
from posor_lab.replay_1985.comparison import KIND_NAMES, UNDER_TABLE, error_figure, expectations, reasons
from posor_lab.replay_1985.end_of_beam import EndOfBeamProgram, SensorNoise, simulated_errors
from posor_lab.replay_1985.motion_test import ANGLES, offline_motion_test
from posor_lab.replay_1985.printed_results import (
    COLUMNS,
    EXPECTED_ERRORS_FILE,
    PRINTED_FILES,
    EndOfBeamTest,
    read_end_of_beam,
    read_predicted_errors,
    read_printed,
)
from posor_lab.replay_1985.replay_report import plot_angles
from posor_lab.thesis_budgets.chapter5 import root_sum_square
from posor_lab.thesis_budgets.motion_predictions import (
    READOUT,
    MotionName,
    dimensions,
    diode_error,
    increasing_errors,
    probe_budget,
    random_alpha,
    sensor_travel,
    spots_at,
    straightness_error,
    twist_stage_alpha,
)
from posor_lab.thesis_data import URAD, data_path, parse_number, read_table
from posor_lab.thesis_table.thesis_row import ComparisonKind

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

    from posor_lab.harness.rig_files import Bag, CalibrationName
    from posor_lab.replay_1985.motion_test import Angle

_TESTS: tuple[EndOfBeamTest, ...] = ("TWIS", "GEN")
Column = Literal["alpha", "z", "y"]
_UNITS: dict[Column, tuple[str, float]] = {"alpha": ("urad", URAD), "z": ("in", 1.0), "y": ("in", 1.0)}
"""Unit of each column of the printed tables, and its amount in those of the tables as read: rad and inch."""
_MAP_LOST = "the 1985 map of the diodes is lost, the derived one is local"
_PERCENTILES = (5.0, 50.0, 95.0)
_REPLAYS: tuple[tuple[Bag, CalibrationName], ...] = (
    ("ymo", "printed"),
    ("zmo", "section84"),
    ("ymo", "section84"),
    ("yzmo", "section84"),
)
"""Tests and calibrations whose errors section 8.4 and appendix 8B print."""


@cache
def stated_error(test: MotionName, freedom: str, column: str) -> float:
    """Return a number of the text of chapter 8: a cell of expected_errors.csv, in the unit of its row.

    Raises DataFileError: the table cannot be read, or has an invalid number.
    """
    path = data_path(EXPECTED_ERRORS_FILE)
    rows = read_table(path, ["test", "dof", column])
    row = next(row for row in rows if (row["test"], row["dof"]) == (test, freedom))
    return parse_number(row, column, f"{path}, {test}, {freedom}")


def predicted_theta(test: MotionName) -> float:
    """Return the predicted error of theta [rad]: stage straightness and table 7.9, over the travels of table 8.1."""
    travel = sensor_travel(test)
    return root_sum_square(straightness_error(travel.mean_x), diode_error(travel.mean_distance))


def predicted_alpha(test: MotionName) -> float:
    """Return the predicted error of alpha [rad]; the machining centre measured alpha in TWIS and GEN only."""
    others = random_alpha() if test in _TESTS else root_sum_square(probe_budget("random", "alpha"), twist_stage_alpha())
    return root_sum_square(others, increasing_errors(sensor_travel(test).slopes).alpha)


def predicted_beta(test: MotionName) -> float:
    """Return the predicted error of beta [rad]: random and increasing errors of the probes, machining centre."""
    readout = READOUT / dimensions()["lever_measured"]
    return root_sum_square(probe_budget("random", "beta"), increasing_errors(sensor_travel(test).slopes).beta, readout)


def replayed_deviation(bag: Bag, angle: Angle) -> float:
    """Return the standard deviation of the error of an angle with the zero shifts of table 8.1 [rad]."""
    test = offline_motion_test(bag, "section84")
    return float(deviation_from_first(test.angle_errors[test.has_pose, ANGLES.index(angle)]))


def replay_figures() -> list[dict[str, Any]]:
    """Return the errors [urad] that section 8.4 and appendix 8B print, with the zero shifts of each.

    Raises PosorError: a file of the rig is missing or invalid.
    """
    return [
        {
            "section": "App. 8B" if expected.source == UNDER_TABLE else expected.source.removeprefix("section "),
            "test": bag.upper(),
            "angle": expected.angle,
            "figure": KIND_NAMES[expected.kind],
            "printed": f"{expected.stated:g}",
            "error": error_figure(offline_motion_test(bag, calibration), expected),
            "kind": (
                ComparisonKind.DEPENDENT if expected.remark.startswith("not independent") else ComparisonKind.COMPUTED
            ).value,
            "reason": expected.remark or (_MAP_LOST if expected.angle == "theta" else ""),
        }
        for bag, calibration in _REPLAYS
        for expected in expectations(bag, calibration)
        if expected.stated is not None and (calibration == "section84" or expected.source == UNDER_TABLE)
    ]


def replay_plots() -> list[Plot]:
    """Return motion and error of each angle with the zero shifts of the printed tables, as figures 8.8 to 8.14.

    Raises PosorError: a table of the thesis or a file of the rig cannot be read.
    """
    plots = []
    for bag in BAGS:
        printed = read_printed(data_path(PRINTED_FILES[bag])) if bag in PRINTED_FILES else None
        predictions = read_predicted_errors(data_path(EXPECTED_ERRORS_FILE), bag)
        for plot in plot_angles(offline_motion_test(bag, "printed"), printed, predictions, reasons(bag, "printed")):
            plot.title = f"{bag.upper()}: {plot.title}"
            plots.append(plot)
    return plots


def _column(values: FloatArray, column: Column, amount: float | None = None) -> FloatArray:
    """Return a column of alpha, z and y, in urad or inch."""
    return np.asarray(values[..., COLUMNS.index(column)] / (amount or _UNITS[column][1]))


def printed_deviation(test: EndOfBeamTest, column: Column) -> float:
    """Return the standard deviation of the legible errors of a column [urad or inch], without the missing steps."""
    errors = _column(read_end_of_beam(test).errors, column, 1.0)
    return float(deviation_from_first(errors[np.isfinite(errors)])) / _UNITS[column][1]


def printed_root_mean_square(test: EndOfBeamTest, column: Column) -> float:
    """Return the root mean square of the legible errors of a column [rad or inch], without step 1."""
    return read_end_of_beam(test).root_mean_square(COLUMNS.index(column))


def legible_steps(test: EndOfBeamTest, column: Column) -> str:
    """Return how many steps of a column are legible."""
    errors = _column(read_end_of_beam(test).errors, column)[1:]
    return f"{np.count_nonzero(np.isfinite(errors))} of {len(errors)} steps are legible"


def legible_values(test: EndOfBeamTest, what: Literal["measured", "posor", "errors"], column: Column) -> list[float]:
    """Return the legible cells of a column of a printed result table, or their differences [urad or inch]."""
    values = _column(getattr(read_end_of_beam(test), what), column)
    legible: list[float] = values[np.isfinite(values)].tolist()
    return legible


def results_from_travel(test: EndOfBeamTest) -> dict[str, float]:
    """Return alpha, z and y at the end of a test by the formulas of 1985 from table 8.1 [rad, inch, inch].

    The table has no signs of the probes: all gaps are taken to grow.
    """
    gaps = np.zeros((1, 2, 3))
    gaps[0, 1] = sensor_travel(test).probes
    spots = np.array([[spots_at(test, "start"), spots_at(test, "finish")]])
    return dict(zip(COLUMNS, EndOfBeamProgram().evaluate(gaps, spots)[0, -1].tolist(), strict=True))


@cache
def _simulated(test: EndOfBeamTest) -> FloatArray:
    """Return simulated errors [rad, inch, inch], shape (draws, n, 3)."""
    return simulated_errors(test)


@cache
def _without_noise(test: EndOfBeamTest) -> FloatArray:
    """Return the error of the formulas alone [rad, inch, inch], shape (n, 3)."""
    return np.asarray(simulated_errors(test, noise=SensorNoise(np.zeros(3), np.zeros(4), 0.0), draws=1)[0])


@dataclass(frozen=True)
class SimulatedDeviation:
    """Standard deviation of the simulated errors of a column [urad or inch]: 5 %, median, 95 %, and without noise."""

    low: float
    median: float
    high: float
    without_noise: float


@cache
def simulated_deviation(test: EndOfBeamTest, column: Column) -> SimulatedDeviation:
    """Return the standard deviation of the errors of simulated runs with the noise of the budgets."""
    number, unit = COLUMNS.index(column), [amount for _, amount in _UNITS.values()]
    deviations = deviation_from_first(np.swapaxes(_simulated(test) / unit, 0, 1))
    low, median, high = np.percentile(deviations[:, number], _PERCENTILES).tolist()
    return SimulatedDeviation(low, median, high, float(deviation_from_first(_column(_without_noise(test), column))))


def place_of_print(printed: float | str, low: float, high: float) -> str:
    """Return where a printed number lies against the range of the simulated ones; empty: not legible."""
    if isinstance(printed, str):
        return ""
    place = "below" if printed < low else "above" if printed > high else "in"
    return f", the print lies {place} this range"


def end_of_beam_plots() -> list[Plot]:
    """Return figures 8.15 to 8.20: each motion, and its error with the range of the simulated errors.

    Raises DataFileError: a table of the thesis cannot be read.
    """
    figures: list[tuple[EndOfBeamTest, Column]] = [(test, column) for test in _TESTS for column in ("alpha", "y", "z")]
    return [
        plot for number, figure in enumerate(figures, start=15) for plot in _column_plots(f"Figure 8.{number}", *figure)
    ]


def _column_plots(number: str, test: EndOfBeamTest, column: Column) -> list[Plot]:
    results, unit = read_end_of_beam(test), _UNITS[column][0].replace("urad", "µrad")
    steps = np.arange(1, len(results.measured) + 1)
    motion = Plot(f"{number}A: {column} of the beam in {test}", "step", f"{column} [{unit}]")
    motion.curve("machining centre", steps, _column(results.measured, column), GREY, dash="dashed", marker="x")
    motion.curve("POSOR, as printed", steps, _column(results.posor, column), ORANGE, dash=None, marker="square")
    simulated = _column(results.motion, column) + _column(_without_noise(test), column)
    motion.curve("POSOR, simulated without noise", steps, simulated, BLUE, marker="circle")
    error = Plot(f"{number}B: error of {column} in {test}", "step", f"error [{unit}]", x_of=motion)
    error.zero()
    low, median, high = np.percentile(_column(_simulated(test), column), _PERCENTILES, axis=0)
    error.band("simulated, 5 to 95 %, exact zero shifts", steps, low, high, LIGHT_BLUE)
    error.curve("simulated, median", steps, median, BLUE, extra={"5 %": low, "95 %": high})
    printed = _column(results.errors, column)
    error.curve("as printed, zero shifts (0, .2, .3) V", steps, printed, ORANGE, dash=None, marker="square")
    return [motion, error]
