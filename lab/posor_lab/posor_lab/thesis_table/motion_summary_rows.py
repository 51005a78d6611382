"""Rows of the thesis table for sections 8.4 and 8.5: ratios to the predictions, table 8.2, and the averages."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from posor_calibration.attitude_fit import deviation_from_first

from posor_lab.replay_1985.motion_test import ANGLES, offline_motion_test
from posor_lab.replay_1985.printed_results import EXPECTED_ERRORS_FILE, read_end_of_beam
from posor_lab.thesis_budgets.chapter5 import LEG_X, root_sum_square
from posor_lab.thesis_budgets.motion_predictions import (
    CURVE_PEAK,
    READOUT,
    dimensions,
    diode_error,
    increasing_errors,
    probe_budget,
    random_alpha,
    sensor_travel,
    straightness_error,
    twist_stage_alpha,
)
from posor_lab.thesis_data import URAD, data_path, parse_number, read_table
from posor_lab.thesis_table.end_of_beam_rows import ALPHA, UNITS, Y, Z, printed_deviation
from posor_lab.thesis_table.thesis_row import ThesisRow

if TYPE_CHECKING:
    from posor_bringup.installed import Bag

    from posor_lab.replay_1985.motion_test import Angle
    from posor_lab.replay_1985.printed_results import EndOfBeamTest
    from posor_lab.thesis_budgets.motion_predictions import MotionName

_MISSING = "table 8.2 is not in the scan"


def motion_summary_rows() -> list[ThesisRow]:
    """Return the rows of table 8.2, of the ratios in section 8.4, and of the averages in sections 8.5 and 9.1.

    Raises:
        PosorError: A table of the thesis or a file of the rig cannot be read.

    """
    return [*_ratio_rows(), *_table_8_2(), *_average_rows()]


@cache
def stated_error(test: MotionName, freedom: str, column: str) -> float:
    """Return a number of the text of chapter 8: a cell of expected_errors.csv, in the unit of its row.

    Raises:
        DataFileError: The table cannot be read, or has an invalid number.

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
    others = (
        random_alpha()
        if test in ("TWIS", "GEN")
        else root_sum_square(probe_budget("random", "alpha"), twist_stage_alpha())
    )
    return root_sum_square(others, increasing_errors(sensor_travel(test).slopes).alpha)


def predicted_beta(test: MotionName) -> float:
    """Return the predicted error of beta [rad]: random and increasing errors of the probes, machining centre."""
    readout = READOUT / dimensions()["lever_measured"]
    return root_sum_square(probe_budget("random", "beta"), increasing_errors(sensor_travel(test).slopes).beta, readout)


def _ratio_rows() -> list[ThesisRow]:
    lever = dimensions()["lever_endpoint"]
    random_y = lever * probe_budget("random", "beta")
    twis_peak = CURVE_PEAK * lever / LEG_X
    straight = {test: straightness_error(round(sensor_travel(test).mean_x, 3)) / URAD for test in ("YMO", "YZMO")}
    ratios: tuple[tuple[str, MotionName, str, float, str], ...] = (
        ("8.4.2", "YMO", "theta", stated_error("YMO", "theta", "observed_max") / straight["YMO"], ""),
        ("8.4.3", "YZMO", "theta", stated_error("YZMO", "theta", "observed_max") / straight["YZMO"], ""),
        (
            "8.4.4",
            "TWIS",
            "z",
            stated_error("TWIS", "z", "observed_max") / twis_peak,
            "the thesis divides by .0045 in",
        ),
        (
            "8.4.5",
            "GEN",
            "z",
            stated_error("GEN", "z", "observed_max") / (lever * predicted_theta("GEN")),
            "the printed prediction has 120 urad for the stage, which does not follow",
        ),
        (
            "8.4.5",
            "GEN",
            "y",
            stated_error("GEN", "y", "observed_sd")
            / root_sum_square(random_y, increasing_errors(sensor_travel("GEN").slopes).y),
            "",
        ),
    )
    return [
        ThesisRow(
            section,
            f"{test}: printed error of {freedom} over the predicted error",
            "1",
            f"{stated_error(test, freedom, 'stated_ratio_to_predicted_sd'):g}",
            ratio,
            reason,
        )
        for section, test, freedom, ratio, reason in ratios
    ]


def replayed_deviation(bag: Bag, angle: Angle) -> float:
    """Return the standard deviation of the error of an angle with the zero shifts of table 8.1 [rad]."""
    test = offline_motion_test(bag, "section84")
    return float(deviation_from_first(test.angle_errors[test.has_pose, ANGLES.index(angle)]))


def _table_8_2() -> list[ThesisRow]:
    """Return what can be computed of table 8.2: observed and predicted error of each test."""
    lever = dimensions()["lever_endpoint"]
    predicted = {"alpha": predicted_alpha, "beta": predicted_beta, "theta": predicted_theta}
    observed_of: tuple[tuple[MotionName, Bag, tuple[Angle, ...]], ...] = (
        ("ZMO", "zmo", ("theta",)),
        ("YMO", "ymo", ("alpha", "beta", "theta")),
        ("YZMO", "yzmo", ("alpha", "beta", "theta")),
    )
    rows = []
    for test, bag, angles in observed_of:
        for angle in angles:
            observed = replayed_deviation(bag, angle) / URAD
            rows += _observed_and_predicted(test, angle, "urad", observed, predicted[angle](test) / URAD)
    ends: tuple[EndOfBeamTest, ...] = ("TWIS", "GEN")
    for test in ends:
        at_end = {
            ALPHA: ("alpha", predicted_alpha(test) / URAD),
            Z: ("z", lever * predicted_theta(test)),
            Y: ("y", lever * predicted_beta(test)),
        }
        for column, (name, value) in at_end.items():
            rows += _observed_and_predicted(test, name, UNITS[column], printed_deviation(test, column), value)
    return rows


def _observed_and_predicted(
    test: MotionName, name: str, unit: str, observed: float, predicted: float
) -> list[ThesisRow]:
    shifts = "zero shifts (0, .2, .3) V, legible steps" if test in ("TWIS", "GEN") else "zero shifts of table 8.1"
    return [
        ThesisRow(
            "Table 8.2", f"{test}: {name}, standard deviation of the error", unit, "", observed, f"{_MISSING}; {shifts}"
        ),
        ThesisRow(
            "Table 8.2",
            f"{test}: {name}, predicted error",
            unit,
            "",
            predicted,
            f"{_MISSING}; root sum square of the terms of section 8.4",
        ),
    ]


def _average_rows() -> list[ThesisRow]:
    """Return the average errors at the end of the beam: y by the probes, z by the diodes."""
    lever = dimensions()["lever_endpoint"]
    ends = [stated_error(test, "y", "observed_sd") for test in ("TWIS", "GEN")]
    stated_beta = [lever * stated_error(test, "beta", "observed_sd") * URAD for test in ("YMO", "YZMO")]
    replayed_beta = [lever * replayed_deviation(bag, "beta") for bag in ("ymo", "yzmo")]
    stated, replayed = _mean([*stated_beta, *ends]), _mean([*replayed_beta, *ends])
    theta: dict[str, list[float]] = {
        column: [lever * stated_error(test, "theta", column) * URAD for test in ("ZMO", "YMO", "YZMO")]
        for column in ("observed_sd", "observed_max")
    }
    diodes = _mean(
        [
            *theta["observed_sd"],
            read_end_of_beam("TWIS").root_mean_square(Z),
            stated_error("GEN", "z", "observed_sd"),
        ]
    )
    largest = _mean([*theta["observed_max"], *(stated_error(test, "z", "observed_max") for test in ("TWIS", "GEN"))])
    legible = "z of TWIS from the legible steps"
    return [
        ThesisRow(
            "8.5", "average error at the end of the beam, probes, by the printed deviations", "in", ".000625", stated
        ),
        ThesisRow(
            "8.5", "average error at the end of the beam, probes, by the replayed tests", "in", ".000625", replayed
        ),
        ThesisRow(
            "9.1",
            "average error at the end of the beam, probes, by the printed deviations",
            "in",
            ".0006",
            stated,
            "rounded from .000625",
        ),
        ThesisRow(
            "9.1",
            "average error at the end of the beam, diodes, by the printed deviations",
            "in",
            ".0047",
            diodes,
            legible,
        ),
        ThesisRow(
            "8.5",
            "average error at the end of the beam, diodes, by the printed deviations",
            "in",
            ".008929",
            diodes,
            f"does not follow: section 9.1 has .0047 in for the same average; the largest errors of the five tests "
            f"average {largest:.6f} in; {legible}",
        ),
    ]


def _mean(values: list[float]) -> float:
    return sum(values) / len(values)
