# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""arm_budget: error budget of an arm's endpoint, extended and with a bent wrist, beside the figures of the thesis.

``./run posor_lab arm_budget [--arm ARM.yaml] [--output budget.json] [--draws N]``
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from posor.calibration.designs import PROBE_ACCURACY, SMALLEST_DIAMETER
from posor.chain.arm_file import load_arm_file
from posor.chain.kinematic_chain import load_chain
from posor.errors import ChainError, DataFileError, ParameterError
from posor.reporting.command_line_parser import CommandLineParser, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import ReportTable, report_console
from posor.uncertainty.budget_poses import model_covariances
from posor_design.endpoint_budget import Spread, configurations, endpoint_budget
from scipy.constants import inch

from posor_lab.arm_study.endpoint_monte_carlo import monte_carlo
from posor_lab.harness.rig_files import share
from posor_lab.lab_output import check_writable, write_json
from posor_lab.thesis_budgets.chapter5 import root_sum_square
from posor_lab.thesis_data import MICROINCH, URAD, data_path, parse_number, read_numbers, read_table

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Mapping, Sequence

    from posor.chain.arm_file import ArmFile
    from posor.chain.kinematic_chain import Chain
    from posor.numerics.array_types import FloatArray
    from rich.console import Console

CALIBRATION_ERROR = 50.0  # error of the calibration of the measuring system, section 9.3.3 [uin]
DRAWS = 10_000
SEED = 1985
FIGURES = ("alpha_x_urad", "alpha_y_urad", "alpha_z_urad", "dx_uin", "dy_uin", "dz_uin", "displacement_uin")

JOINTS_FILE = "error_budget_five_axis_robot.csv"
ENDPOINT_FILE = "error_budget_robot_endpoint.csv"
SENSORS_ONLY = "9.3.1"  # section of the endpoint errors by the sensors alone
CONFIGURATIONS: Mapping[str, str] = {"extended": "fully extended", "bent": "bent wrist"}
"""Names of the configurations in the table."""
PRINTED = ("alpha_X_urad", "alpha_Y_urad", "alpha_Z_urad", "dX_uin", "dY_uin", "dZ_uin", "total_uin")
"""Columns of ``FIGURES`` in the table."""

THESIS, NOISE, WHOLE = "thesis", "sensor_noise", "sensor_models"
TITLES = {
    THESIS: "thesis 9.3.1, exact beams",
    NOISE: "sensor models, exact beams: noise",
    WHOLE: "noise, calibration and beams",
}


def thesis_covariance(outside_diameter: float) -> FloatArray:
    """Return the covariance (6, 6), ROS order, of a POSOR of an outside diameter [m] by section 9.3.1.

    Small rotations: 5 microinch over 0.75 (D - 1 in). Large rotation: 5 microinch over the radius of the ring, half of
    D - 2 in; the formula of the section has D - 2 in, but all its figures are those of the radius. Translations: zero.

    Raises ParameterError: the diameter is too small for a ring.
    """
    if not outside_diameter >= SMALLEST_DIAMETER:
        raise ParameterError(f"outside diameter {outside_diameter:g} m", expected=f"at least {SMALLEST_DIAMETER:g} m")
    small = PROBE_ACCURACY / (0.75 * (outside_diameter - inch))
    large = PROBE_ACCURACY / (0.5 * (outside_diameter - 2.0 * inch))
    return np.diag(np.square([0.0, 0.0, 0.0, small, small, large]))


def thesis_arm_path() -> Path:
    """Return the file of the installed five-axis arm, the robot of thesis chapter 9."""
    return share() / "arms" / "five_axis" / "arm.yaml"


def read_joints(path: Path) -> dict[str, float]:
    """Return the outside diameters [m] of the joints' POSORs by their names in the URDF, from base to wrist.

    Raises DataFileError: the file cannot be read, lacks a column, or has an invalid number.
    """
    return {name.replace(" ", "_"): od * inch for name, od in read_numbers(path, "joint", "posor_od_in").items()}


def read_endpoint(path: Path) -> dict[str, dict[str, float]]:
    """Return the printed ``FIGURES`` of the endpoint by the sensors alone, by configuration.

    Raises DataFileError: the file cannot be read, lacks a column or a configuration, or has an invalid number.
    """
    rows, printed = read_table(path, ["section", "configuration", *PRINTED]), {}
    for name, printed_name in CONFIGURATIONS.items():
        row = next((r for r in rows if (r["section"], r["configuration"]) == (SENSORS_ONLY, printed_name)), None)
        if row is None:
            raise DataFileError(f"no row of section {SENSORS_ONLY} for '{printed_name}'", where=str(path))
        numbers = (parse_number(row, column, f"{path}, row '{printed_name}'") for column in PRINTED)
        printed[name] = dict(zip(FIGURES, numbers, strict=True))
    return printed


def _spread_figures(spread: Spread) -> dict[str, float]:
    turns, shifts = (spread.orientation / URAD).tolist(), (spread.displacement / MICROINCH).tolist()
    return dict(zip(FIGURES, [*turns, *shifts, spread.total / MICROINCH], strict=True))


def arm_budget(arm: ArmFile, draws: int = DRAWS) -> dict[str, dict[str, Any]]:
    """Return the budgets of an arm, by configuration: ``extended`` and ``bent``.

    Each configuration has the figures of ``FIGURES`` by the source of the joints' accuracies: ``sensor_noise``,
    ``sensor_models``, and ``thesis`` if the arm is the installed five-axis arm. Each source also has the
    same figures by ``monte_carlo``, and ``contributions``. The configuration itself has the figures of ``thesis``, or
    else of ``sensor_models``; ``printed`` are the figures printed in the thesis.

    Raises PosorError: a file of the arm is invalid, or its POSORs cannot be read at zero angles.
    """
    chain = arm.chain()
    straight = load_chain(arm.urdf, arm.endpoint_frame)
    joints = read_joints(data_path(JOINTS_FILE))
    printed = read_endpoint(data_path(ENDPOINT_FILE))
    names = [joint.name for joint in chain.joints]
    is_thesis_robot = arm.path.resolve() == thesis_arm_path().resolve()
    calibrations = {name: arm.calibration(name) for name in names}
    result: dict[str, dict[str, Any]] = {}
    for configuration, angles in configurations(names).items():
        try:
            model = model_covariances(calibrations, chain, angles)
        except ChainError:
            if any(angles.values()):
                continue  # a joint cannot reach this angle, such as that of the test rig
            raise
        cases: dict[str, tuple[Chain, Mapping[str, FloatArray], Mapping[str, Mapping[str, FloatArray]]]] = {
            NOISE: (straight, model.random, {}),
            WHOLE: (chain, model.own(), model.shared),
        }
        if is_thesis_robot:
            thesis = {name: thesis_covariance(diameter) for name, diameter in joints.items()}
            cases = {THESIS: (straight, thesis, {}), **cases}
        budgets = {name: _case_budget(angles, draws, *case) for name, case in cases.items()}
        selected = budgets[THESIS if is_thesis_robot else WHOLE]
        result[configuration] = {**{name: selected[name] for name in FIGURES}, **budgets}
        if is_thesis_robot:
            result[configuration]["printed"] = printed[configuration]
    return result


def _case_budget(
    angles: Mapping[str, float],
    draws: int,
    chain: Chain,
    covariances: Mapping[str, FloatArray],
    shared: Mapping[str, Mapping[str, FloatArray]],
) -> dict[str, Any]:
    budget = endpoint_budget(chain, angles, covariances, shared)
    return {
        **_spread_figures(budget.spread),
        "monte_carlo": _spread_figures(monte_carlo(chain, angles, covariances, draws, SEED, shared)),
        "contributions": [{"name": part.name, **_spread_figures(part.spread)} for part in budget.contributions],
    }


@cache
def five_axis_budgets() -> Mapping[str, Mapping[str, Any]]:
    """Return the budgets of the five-axis arm as ``arm_budget``, by configuration and by source of the accuracies.

    A single draw, because no row needs the Monte Carlo runs.

    Raises PosorError: a file of the arm cannot be read.
    """
    return arm_budget(load_arm_file(thesis_arm_path()), draws=1)


def joint_contributions(configuration: Literal["extended", "bent"]) -> dict[str, list[Any]]:
    """Return names and contributions to the displacement [uin] of the joints, by the accuracies of 9.3.1."""
    parts = five_axis_budgets()[configuration][THESIS]["contributions"]
    return {"names": [part["name"] for part in parts], "displacements": [part[FIGURES[-1]] for part in parts]}


def printed_endpoint(section: str, name: str) -> Mapping[str, str]:
    """Return the printed digits of a section for a configuration, by column.

    Raises DataFileError: the table cannot be read.
    """
    table = read_table(data_path(ENDPOINT_FILE), ["section", "configuration", "dX_uin", "total_uin", "alpha_X_urad"])
    return next(row for row in table if (row["section"], row["configuration"]) == (section, name))


def joint_accuracies() -> list[dict[str, Any]]:
    """Return the printed joints, each with ``large`` and ``small``: its accuracies by the formulas of 9.3.1 [rad].

    Raises DataFileError: the table cannot be read.
    """
    table = read_table(data_path(JOINTS_FILE), ["joint", "posor_od_in", "distance_to_grip_in"])
    result = []
    for row in table:
        small, large = np.sqrt(np.diagonal(thesis_covariance(float(row["posor_od_in"]) * inch)))[[3, 5]].tolist()
        result.append({**row, "small": small, "large": large})
    return result


def extended_as_printed() -> FloatArray:
    """Return dX, dY, dZ [uin] of the extended arm with two terms along other axes, as the print seems to have them.

    Raises DataFileError: the table cannot be read, or has an invalid number.
    """
    joints = joint_accuracies()
    sides: list[float] = []
    ups: list[float] = []
    along = 0.0
    for row in joints:
        # The swivel is as far from the grip as the shoulder; its own cell is empty.
        cells = joints[1] if row is joints[0] else row
        arm = parse_number(cells, "distance_to_grip_in", f"{JOINTS_FILE}, {row['joint']}")
        small, large = row["small"] / URAD, row["large"] / URAD
        about_z = large if row["joint"] in {"base swivel", "wrist yaw"} else small
        about_y = large if row["joint"] in {"shoulder", "elbow"} else small
        (ups if row["joint"] == "elbow" else sides).append(about_z * arm)
        ups.append(about_y * arm)
        along = small * arm  # of the last joint, the yaw
    return np.array([along, root_sum_square(*sides), root_sum_square(*ups)])


def with_calibration_and_beams(shifts: Sequence[float]) -> FloatArray:
    """Return dX, dY, dZ [uin] with the errors of section 9.3.3 added.

    The calibration error acts along every axis, the deformation of the beams across them, not along X.
    """
    beams = float(printed_endpoint("9.3.2", "measuring beam deformation")["total_uin"])
    return np.asarray(np.sqrt(np.square(shifts) + np.square([0.0, beams, beams]) + CALIBRATION_ERROR**2))


def _print_budgets(budgets: Mapping[str, Mapping[str, Any]], console: Console) -> None:
    for configuration, budget in budgets.items():
        cases = {title: budget[name] for name, title in TITLES.items() if name in budget}
        rows = [row for title, case in cases.items() for row in ((title, case), ("  Monte Carlo", case["monte_carlo"]))]
        if "printed" in budget:
            rows.append(("printed in thesis 9.3.1", budget["printed"]))
        title = f"Endpoint, {configuration}: standard uncertainties (k = 1)"
        _table(title, "accuracies of the joints", rows).print(console)
        for title, case in cases.items():
            parts = [(part["name"], part) for part in case["contributions"]]
            _table(f"Contributions, {configuration}: {title}", "contribution", parts).print(console)


def _table(title: str, first: str, rows: Iterable[tuple[str, Mapping[str, float]]]) -> ReportTable:
    cells = [
        (
            name,
            *(f"{row[figure]:.{1 if figure.endswith('uin') else 2}f}" for figure in FIGURES),
            f"{row['displacement_uin'] * MICROINCH * 1e6:.2f}",
        )
        for name, row in rows
    ]
    header = (first, "aX urad", "aY urad", "aZ urad", "dX uin", "dY uin", "dZ uin", "total uin", "total um")
    return ReportTable(title, header, cells)


def _parse_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = CommandLineParser(prog="arm_budget", description="Error budget of an arm's endpoint.")
    add, default = parser.add_argument, thesis_arm_path()
    add("--arm", type=Path, default=default, metavar="ARM.yaml", help="default: the five-axis arm")
    add("--output", type=Path, metavar="FILE.json", help="file for the figures")
    text = f"draws of each Monte Carlo run (default: {DRAWS})"
    add("--draws", type=whole_number_from(1), default=DRAWS, help=text)
    return parser.parse_args(arguments)


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program."""
    options = _parse_options(arguments)
    if options.output is not None:
        check_writable(options.output)
    budgets = arm_budget(load_arm_file(options.arm), options.draws)
    _print_budgets(budgets, report_console(118))
    if options.output is not None:
        write_json(options.output, budgets)
    return 0
