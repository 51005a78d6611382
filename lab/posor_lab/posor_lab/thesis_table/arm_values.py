"""Functions of section 9.3, accuracy of the conceptual robot's measuring system, for the file of rows."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from posor.chain.arm_file import load_arm_file
from posor_design.endpoint_budget import thesis_covariance
from scipy.constants import inch

from posor_lab.arm_study.arm_budget_command import (
    ENDPOINT_FILE,
    FIGURES,
    JOINTS_FILE,
    THESIS,
    arm_budget,
    thesis_arm_path,
)
from posor_lab.thesis_budgets.chapter5 import root_sum_square
from posor_lab.thesis_data import URAD, data_path, parse_number, read_table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.numerics.array_types import FloatArray

CALIBRATION_ERROR = 50.0
"""Error of the calibration of the measuring system, section 9.3.3 [uin]."""


@cache
def five_axis_budgets() -> Mapping[str, Mapping[str, Any]]:
    """Return the budgets of the five-axis arm as ``arm_budget``, by configuration and by source of the accuracies.

    A single draw, because no row needs the Monte Carlo runs.

    Raises:
        PosorError: A file of the arm cannot be read.

    """
    return arm_budget(load_arm_file(thesis_arm_path()), draws=1)


def joint_contributions(configuration: Literal["extended", "bent"]) -> dict[str, list[Any]]:
    """Return names and contributions to the displacement [uin] of the joints, by the accuracies of 9.3.1."""
    parts = five_axis_budgets()[configuration][THESIS]["contributions"]
    return {"names": [part["name"] for part in parts], "displacements": [part[FIGURES[-1]] for part in parts]}


def printed_endpoint(section: str, name: str) -> Mapping[str, str]:
    """Return the printed digits of a section for a configuration, by column.

    Raises:
        DataFileError: The table cannot be read.

    """
    table = read_table(data_path(ENDPOINT_FILE), ["section", "configuration", "dX_uin", "total_uin", "alpha_X_urad"])
    return next(row for row in table if (row["section"], row["configuration"]) == (section, name))


def joint_accuracies() -> list[dict[str, Any]]:
    """Return the printed joints, each with ``large`` and ``small``: its accuracies by the formulas of 9.3.1 [rad].

    Raises:
        DataFileError: The table cannot be read.

    """
    table = read_table(data_path(JOINTS_FILE), ["joint", "posor_od_in", "distance_to_grip_in"])
    result = []
    for row in table:
        small, large = np.sqrt(np.diagonal(thesis_covariance(float(row["posor_od_in"]) * inch)))[[3, 5]].tolist()
        result.append({**row, "small": small, "large": large})
    return result


def extended_as_printed() -> FloatArray:
    """Return dX, dY, dZ [uin] of the extended arm with two terms along other axes, as the print seems to have them.

    Raises:
        DataFileError: The table cannot be read, or has an invalid number.

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
