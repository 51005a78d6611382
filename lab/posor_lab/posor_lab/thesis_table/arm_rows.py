"""Rows and plots of the thesis table for section 9.3: accuracy of the conceptual robot's measuring system."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.calibration.designs import PROBE_ACCURACY
from posor.chain.arm_file import load_arm
from posor.reporting.figure_style import BLUE
from posor.reporting.plot import Plot
from posor_design.endpoint_budget import thesis_covariance
from scipy.constants import inch

from posor_lab.arm_study.arm_budget_command import FIGURES, THESIS, WHOLE, arm_budget, thesis_arm_path
from posor_lab.arm_study.thesis_robot import CONFIGURATIONS, ENDPOINT_FILE, JOINTS_FILE
from posor_lab.thesis_budgets.chapter5 import root_sum_square
from posor_lab.thesis_data import URAD, data_path, parse_number, read_table
from posor_lab.thesis_table.thesis_row import ThesisRow

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.numerics.array_types import FloatArray

CALIBRATION_ERROR = 50.0
"""Error of the calibration of the measuring system, section 9.3.3 [uin]."""
BEAM_DEFORMATIONS = (50.0, 20.0)
"""Errors at the endpoint by the first and second long beam of aluminium, section 9.3.2 [uin]."""
ALUMINIUM, IRON = 10e6, 30e6
"""Young's modulus [psi]: of aluminium as in 6.2.3.1, of an iron alloy (assumed, usual value of steel)."""
TURNS, SHIFTS, TOTAL = FIGURES[:3], FIGURES[3:6], FIGURES[6]
_COLUMNS = dict(
    zip(
        FIGURES,
        (*(f"alpha_{axis}_urad" for axis in "XYZ"), *(f"d{axis}_uin" for axis in "XYZ"), "total_uin"),
        strict=True,
    )
)
"""Columns of the printed table, by figure."""
_SENSORS, _WHOLE_SYSTEM = "9.3.1", "9.3.3"


def rows() -> list[ThesisRow]:
    """Return the rows of section 9.3.

    Raises:
        PosorError: A table of the thesis or a file of the arm cannot be read.

    """
    result = [*_joint_rows(), _beam_row()]
    for configuration in CONFIGURATIONS:
        result += [*_sensor_rows(configuration), *_headline_rows(configuration), *_own_rows(configuration)]
    return result


def plots() -> list[Plot]:
    """Return what each joint contributes to the error of the endpoint, for figures 9.5 and 9.6.

    Raises:
        PosorError: A table of the thesis or a file of the arm cannot be read.

    """
    drawn = []
    for configuration, name in CONFIGURATIONS.items():
        parts = _budget()[configuration][THESIS]["contributions"]
        names = [part["name"] for part in parts]
        plot = Plot(
            f"Endpoint, {name}: contribution of each joint (9.3.1)", "displacement [µin]", "joint", categories=names
        )
        plot.bars("accuracies of section 9.3.1", [part[TOTAL] for part in parts], names, BLUE)
        drawn.append(plot)
    return drawn


@cache
def _budget() -> Mapping[str, Mapping[str, Any]]:
    """Return the budgets of the five-axis arm; a single draw, because no row needs the Monte Carlo runs."""
    return arm_budget(load_arm(thesis_arm_path()), draws=1)


@cache
def _printed(section: str, configuration: str) -> Mapping[str, str]:
    """Return the printed digits of a section, by figure."""
    rows_of_table = read_table(data_path(ENDPOINT_FILE), ["section", "configuration", *_COLUMNS.values()])
    name = CONFIGURATIONS[configuration]
    row = next(row for row in rows_of_table if (row["section"], row["configuration"]) == (section, name))
    return {figure: row[column] for figure, column in _COLUMNS.items()}


def _joint_rows() -> list[ThesisRow]:
    joints = read_table(
        data_path(JOINTS_FILE), ["joint", "posor_od_in", "large_dof_accuracy_urad", "small_dof_accuracy_urad"]
    )
    result = []
    for row in joints:
        outside = float(row["posor_od_in"])
        small, large = np.sqrt(np.diagonal(thesis_covariance(outside * inch)))[[3, 5]] / URAD
        name = f"{row['joint']}, POSOR of {outside:g} in"
        result += [
            ThesisRow(
                _SENSORS,
                f"{name}: large rotation, over the radius",
                "urad",
                row["large_dof_accuracy_urad"],
                float(large),
            ),
            ThesisRow(_SENSORS, f"{name}: small rotations", "urad", row["small_dof_accuracy_urad"], float(small)),
        ]
    first = joints[0]
    formula = PROBE_ACCURACY / (float(first["posor_od_in"]) * inch - 2.0 * inch) / URAD
    result.append(
        ThesisRow(
            _SENSORS,
            f"{first['joint']}: large rotation by the formula of the section, 5 uin / (D - 2 in)",
            "urad",
            first["large_dof_accuracy_urad"],
            formula,
            "all five printed figures are twice the formula: they divide by the radius of the ring",
        )
    )
    return result


def _beam_row() -> ThesisRow:
    return ThesisRow(
        "9.3.2",
        "endpoint, deformation of the measuring beams of an iron alloy",
        "uin",
        "18",
        root_sum_square(*BEAM_DEFORMATIONS) * ALUMINIUM / IRON,
        f"assumes that the deformation goes with 1/E, {ALUMINIUM:.0e} and {IRON:.0e} psi",
    )


def _sensor_rows(configuration: str) -> list[ThesisRow]:
    name, printed = CONFIGURATIONS[configuration], _printed(_SENSORS, configuration)
    budget = _budget()[configuration][THESIS]
    reason = _extended_reason() if configuration == "extended" else _bent_reason()
    components = [float(printed[figure]) for figure in SHIFTS]
    result = [
        ThesisRow(_SENSORS, f"{name}: {figure.rpartition('_')[0]}", "urad", printed[figure], budget[figure])
        for figure in TURNS
    ]
    result += [
        ThesisRow(_SENSORS, f"{name}: {figure.rpartition('_')[0]}", "uin", printed[figure], budget[figure], reason)
        for figure in (*SHIFTS, TOTAL)
    ]
    quantity = f"{name}: root sum square of the printed components"
    result.append(ThesisRow(_SENSORS, quantity, "uin", printed[TOTAL], root_sum_square(*components)))
    return result


def _extended_reason() -> str:
    """Return what the printed components of the extended arm follow from, with the numbers."""
    shifts = extended_as_printed()
    return (
        "the exact chain; the print follows if the elbow's turn about Z is counted in dZ instead of dY, and the yaw's "
        f"small turn in dX beside dZ: {shifts[0]:.1f}, {shifts[1]:.1f}, {shifts[2]:.1f}, total "
        f"{np.linalg.norm(shifts):.1f} uin"
    )


def extended_as_printed() -> FloatArray:
    """Return dX, dY, dZ [uin] of the extended arm with two terms along other axes, as the print seems to have them."""
    table = read_table(data_path(JOINTS_FILE), ["joint", "posor_od_in", "distance_to_grip_in", "link_to_next_joint_in"])
    sides: list[float] = []
    ups: list[float] = []
    along = 0.0
    for row in table:
        # The swivel is as far from the grip as the shoulder; its own cell is empty.
        where = f"{JOINTS_FILE}, {row['joint']}"
        arm = parse_number(table[1] if row is table[0] else row, "distance_to_grip_in", where)
        small, large = np.sqrt(np.diagonal(thesis_covariance(float(row["posor_od_in"]) * inch)))[[3, 5]] / URAD
        about_z, about_y = {
            "base swivel": (large, small),
            "shoulder": (small, large),
            "elbow": (small, large),
            "wrist roll": (small, small),
            "wrist yaw": (large, small),
        }[row["joint"]]
        (ups if row["joint"] == "elbow" else sides).append(about_z * arm)
        ups.append(about_y * arm)
        along = small * arm  # of the last joint, the yaw
    return np.array([along, root_sum_square(*sides), root_sum_square(*ups)])


def _bent_reason() -> str:
    return (
        "the exact chain with the wrist at 90 degrees; no posture gives all printed components: in dY and dZ lever "
        "arms of the extended arm are likely, the terms of dX = 73 are open (docs/background/five_axis_budget.md)"
    )


def with_calibration_and_beams(shifts: FloatArray) -> FloatArray:
    """Return dX, dY, dZ [uin] with the errors of section 9.3.3 added.

    The calibration error acts along every axis, the deformation of the beams across them, not along X.
    """
    beams = _printed_beams()
    added = np.square([0.0, beams, beams]) + CALIBRATION_ERROR**2
    return np.asarray(np.sqrt(np.square(shifts) + added))


@cache
def _printed_beams() -> float:
    """Return the printed deformation of the measuring beams [uin]."""
    table = read_table(data_path(ENDPOINT_FILE), ["section", "total_uin"])
    return next(float(row["total_uin"]) for row in table if row["section"] == "9.3.2")


def _headline_rows(configuration: str) -> list[ThesisRow]:
    name, printed = CONFIGURATIONS[configuration], _printed(_WHOLE_SYSTEM, configuration)
    sensors = np.array([float(_printed(_SENSORS, configuration)[figure]) for figure in SHIFTS])
    whole = with_calibration_and_beams(sensors)
    own = with_calibration_and_beams(np.array([_budget()[configuration][THESIS][figure] for figure in SHIFTS]))
    added = f"{CALIBRATION_ERROR:g} and {_printed_beams():g} uin added"
    result = [
        ThesisRow(
            _WHOLE_SYSTEM, f"{name}: {figure[:2]}, {added} to the printed component", "uin", printed[figure], value
        )
        for figure, value in zip(SHIFTS, whole.tolist(), strict=True)
    ]
    total = float(np.linalg.norm(whole))
    result.append(
        ThesisRow(_WHOLE_SYSTEM, f"{name}: total, {added} to the printed components", "uin", printed[TOTAL], total)
    )
    reason = _extended_reason() if configuration == "extended" else _bent_reason()
    result.append(
        ThesisRow(
            _WHOLE_SYSTEM,
            f"{name}: total, {added} to the components of the exact chain",
            "uin",
            printed[TOTAL],
            float(np.linalg.norm(own)),
            reason,
        )
    )
    return result


def _own_rows(configuration: str) -> list[ThesisRow]:
    """Return the figures of this project's sensor models, with assumed errors of calibration and beams."""
    name, printed = CONFIGURATIONS[configuration], _printed(_WHOLE_SYSTEM, configuration)
    budget = _budget()[configuration][WHOLE]
    reason = (
        "assumed errors of calibration and beams of this project, and the noise of all three probes in a small "
        f"rotation (root 1.5 = {math.sqrt(1.5):.2f} times that of the thesis)"
    )
    return [
        ThesisRow(
            _WHOLE_SYSTEM,
            f"{name}: {figure.rpartition('_')[0]}, this project's sensor models and assumed budget",
            "urad" if figure in TURNS else "uin",
            printed[figure],
            budget[figure],
            reason,
        )
        for figure in (*TURNS, TOTAL)
    ]
