"""Rows and plots of the thesis table for TWIS and GEN: the legible result tables, and the simulation of both tests."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from posor.reporting.figure_style import BLUE, GREY, LIGHT_BLUE, ORANGE
from posor.reporting.plot import Plot
from posor_calibration.attitude_fit import deviation_from_first

from posor_lab.replay_1985.end_of_beam import DRAWS, Z_LEVER, EndOfBeamProgram, SensorNoise, simulated_errors
from posor_lab.replay_1985.printed_results import COLUMNS, read_end_of_beam
from posor_lab.thesis_budgets.motion_predictions import sensor_travel, spots_at
from posor_lab.thesis_data import URAD
from posor_lab.thesis_table.thesis_row import ThesisRow

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

    from posor_lab.replay_1985.printed_results import EndOfBeamTest

TESTS: tuple[EndOfBeamTest, ...] = ("TWIS", "GEN")
SECTIONS: dict[EndOfBeamTest, str] = {"TWIS": "8.4.4", "GEN": "8.4.5"}
ALPHA, Z, Y = range(3)
UNITS = ("urad", "in", "in")
SCALES = (URAD, 1.0, 1.0)
_UNCOMPENSATED = "the text has the zero shifts of table 8.1, the legible table (0, .2, .3) V"
_PERCENTILES = (5.0, 50.0, 95.0)


def end_of_beam_rows() -> list[ThesisRow]:
    """Return the rows of TWIS and GEN.

    Raises:
        DataFileError: A table of the thesis cannot be read.

    """
    return [*_twist_rows(), *_general_rows(), *_travel_rows(), *_simulation_rows()]


def printed_deviation(test: EndOfBeamTest, column: int) -> float:
    """Return the standard deviation of the legible errors of a column [urad or inch], without the missing steps."""
    results = read_end_of_beam(test)
    errors = results.errors[results.legible[:, column], column]
    return float(deviation_from_first(errors)) / SCALES[column]


def _legible_steps(test: EndOfBeamTest, column: int) -> str:
    legible = read_end_of_beam(test).legible[1:, column]
    return f"{np.count_nonzero(legible)} of {len(legible)} steps are legible"


def _largest_error(test: EndOfBeamTest, column: int) -> float:
    return float(np.nanmax(np.abs(read_end_of_beam(test).errors[:, column]))) / SCALES[column]


def _motion_range(test: EndOfBeamTest, column: int) -> float:
    return float(np.nanmax(read_end_of_beam(test).measured[:, column])) / SCALES[column]


def _twist_rows() -> list[ThesisRow]:
    z_root, y_root = (read_end_of_beam("TWIS").root_mean_square(column) for column in (Z, Y))
    alpha = printed_deviation("TWIS", ALPHA)
    return [
        ThesisRow("8.4.4", "TWIS: range of alpha", "urad", "5796", _motion_range("TWIS", ALPHA)),
        ThesisRow("8.4.4", "TWIS: range of y", "in", ".005933", _motion_range("TWIS", Y)),
        ThesisRow("8.4.4", "TWIS: alpha, standard deviation of the error", "urad", "53", alpha, _UNCOMPENSATED),
        ThesisRow(
            "App. 8B",
            "TWIS: alpha, standard deviation under the table",
            "urad",
            "",
            alpha,
            "the scan shows only the digits 34 of it",
        ),
        ThesisRow(
            "App. 8B",
            "TWIS: z, root mean square of the legible errors",
            "in",
            "",
            z_root,
            f"the scan shows .003..2 of the standard deviation; {_legible_steps('TWIS', Z)}",
        ),
        ThesisRow(
            "App. 8B",
            "TWIS: y, standard deviation under the table",
            "in",
            ".0046",
            printed_deviation("TWIS", Y),
            f"{_legible_steps('TWIS', Y)}; not independent: the signs of steps 2 to 9 were chosen by this number",
        ),
        ThesisRow(
            "App. 8B",
            "TWIS: y, root mean square of the legible errors",
            "in",
            "",
            y_root,
            f"not printed: the table divides by n - 2; {_legible_steps('TWIS', Y)}",
        ),
        ThesisRow(
            "8.4.4",
            "TWIS: z, largest error",
            "in",
            ".007",
            _largest_error("TWIS", Z),
            f"'about' in the text; {_legible_steps('TWIS', Z)}",
        ),
        ThesisRow(
            "8.4.4",
            "TWIS: y, standard deviation of the error",
            "in",
            ".001627",
            printed_deviation("TWIS", Y),
            f"{_UNCOMPENSATED}, which make most of this error",
        ),
    ]


def _general_rows() -> list[ThesisRow]:
    alpha, z, y = (printed_deviation("GEN", column) for column in (ALPHA, Z, Y))
    return [
        ThesisRow("8.4.5", "GEN: alpha at the last step", "urad", "1565", _last_alpha()),
        ThesisRow("8.4.5", "GEN: range of y", "in", ".007242", _motion_range("GEN", Y)),
        ThesisRow("App. 8B", "GEN: alpha, standard deviation under the table", "urad", "176", alpha),
        ThesisRow("8.4.5", "GEN: alpha, standard deviation of the error", "urad", "91", alpha, _UNCOMPENSATED),
        ThesisRow(
            "8.4.5",
            "GEN: z, largest error",
            "in",
            ".0155",
            _largest_error("GEN", Z),
            "not independent: damaged digits of the last cell were chosen by this number",
        ),
        ThesisRow(
            "8.4.5",
            "GEN: z, standard deviation of the error",
            "in",
            ".0085",
            z,
            f"{_legible_steps('GEN', Z)}, the late ones",
        ),
        ThesisRow("App. 8B", "GEN: y, standard deviation under the table", "in", ".00535", y, _legible_steps("GEN", Y)),
        ThesisRow(
            "8.4.5",
            "GEN: y, standard deviation of the error",
            "in",
            ".000506",
            y,
            f"{_UNCOMPENSATED}, which make most of it",
        ),
    ]


def _last_alpha() -> float:
    return float(read_end_of_beam("GEN").measured[-1, ALPHA]) / URAD


def results_from_travel(test: EndOfBeamTest) -> FloatArray:
    """Return alpha, z and y at the end of a test by the formulas of 1985 from table 8.1 [rad, inch, inch], shape (3,).

    The table has no signs of the probes: all gaps are taken to grow.
    """
    gaps = np.zeros((1, 2, 3))
    gaps[0, 1] = sensor_travel(test).probes
    spots = np.array([[spots_at(test, "start"), spots_at(test, "finish")]])
    return np.asarray(EndOfBeamProgram().evaluate(gaps, spots)[0, -1])


def _travel_rows() -> list[ThesisRow]:
    rows = []
    for test in TESTS:
        posor = read_end_of_beam(test).posor
        rows.append(
            ThesisRow(
                "Table 8.1",
                f"{test}: alpha of the POSOR from step 2 to the end, by the probe ranges",
                "urad",
                f"{(posor[-1, ALPHA] - posor[1, ALPHA]) / URAD:.0f}",
                float(results_from_travel(test)[ALPHA]) / URAD,
                "the ranges of probes 2 and 3 in table 8.1 do not belong to the printed alpha",
            )
        )
    rows.append(
        ThesisRow(
            "Table 8.1",
            "GEN: z of the POSOR at the last step, by the light spots",
            "in",
            f"{read_end_of_beam('GEN').posor[-1, Z]:.6f}",
            float(results_from_travel("GEN")[Z]),
            f"with {Z_LEVER} in, the lever that the listing shows",
        )
    )
    return rows


@cache
def _simulated(test: EndOfBeamTest) -> FloatArray:
    """Return simulated errors in the units of the table, shape (draws, n, 3)."""
    return np.asarray(simulated_errors(test) / np.array(SCALES))


@cache
def _without_noise(test: EndOfBeamTest) -> FloatArray:
    """Return the error of the formulas alone in the units of the table, shape (n, 3)."""
    exact = SensorNoise(np.zeros(3), np.zeros(4), 0.0)
    return np.asarray(simulated_errors(test, noise=exact, draws=1)[0] / np.array(SCALES))


def _simulation_rows() -> list[ThesisRow]:
    """Return the standard deviations of the simulated errors beside those of the text, both with exact zero shifts."""
    stated: dict[EndOfBeamTest, tuple[str, str, str]] = {
        "TWIS": ("53", "", ".001627"),
        "GEN": ("91", ".0085", ".000506"),
    }
    rows = []
    for test, printed in stated.items():
        low, median, high = np.percentile(
            deviation_from_first(np.swapaxes(_simulated(test), 0, 1)), _PERCENTILES, axis=0
        )
        alone = deviation_from_first(_without_noise(test))
        for column, name in enumerate(COLUMNS):
            reason = (
                f"median of {DRAWS} simulated runs, 5 to 95 %: {low[column]:.3g} to {high[column]:.3g}"
                f"{_place_of_print(printed[column], float(low[column]), float(high[column]))}; without noise "
                f"{alone[column]:.2g}, because the flatness terms have theta of the previous step; not simulated: "
                "errors of the diode map, drift of the probes; assumed: the readings share the motion as in table 8.1"
            )
            quantity = f"{test}: {name}, standard deviation of the error, simulated with the noise of the budgets"
            rows.append(
                ThesisRow(SECTIONS[test], quantity, UNITS[column], printed[column], float(median[column]), reason)
            )
    return rows


def _place_of_print(printed: str, low: float, high: float) -> str:
    """Return where a printed number lies against the range of the simulated ones."""
    if not printed:
        return ""
    place = "below" if float(printed) < low else "above" if float(printed) > high else "in"
    return f", the print lies {place} this range"


def end_of_beam_plots() -> list[Plot]:
    """Return figures 8.15 to 8.20: each motion, and its error with the range of the simulated errors.

    Raises:
        DataFileError: A table of the thesis cannot be read.

    """
    return [plot for test in TESTS for column in (ALPHA, Y, Z) for plot in _column_plots(test, column)]


def _column_plots(test: EndOfBeamTest, column: int) -> list[Plot]:
    results, scale = read_end_of_beam(test), SCALES[column]
    steps = np.arange(1, len(results.measured) + 1)
    number = {"TWIS": 15, "GEN": 18}[test] + (ALPHA, Y, Z).index(column)
    name, unit = COLUMNS[column], UNITS[column].replace("urad", "µrad")
    motion = Plot(f"Figure 8.{number}A: {name} of the beam in {test}", "step", f"{name} [{unit}]")
    motion.curve("machining centre", steps, results.measured[:, column] / scale, GREY, dash="dashed", marker="x")
    motion.curve("POSOR, as printed", steps, results.posor[:, column] / scale, ORANGE, dash=None, marker="square")
    simulated = results.motion[:, column] / scale + _without_noise(test)[:, column]
    motion.curve("POSOR, simulated without noise", steps, simulated, BLUE, marker="circle")
    error = Plot(f"Figure 8.{number}B: error of {name} in {test}", "step", f"error [{unit}]", x_of=motion)
    error.zero()
    low, median, high = np.percentile(_simulated(test)[:, :, column], _PERCENTILES, axis=0)
    error.band("simulated, 5 to 95 %, exact zero shifts", steps, low, high, LIGHT_BLUE)
    error.curve("simulated, median", steps, median, BLUE, extra={"5 %": low, "95 %": high})
    printed = results.errors[:, column] / scale
    error.curve("as printed, zero shifts (0, .2, .3) V", steps, printed, ORANGE, dash=None, marker="square")
    return [motion, error]
