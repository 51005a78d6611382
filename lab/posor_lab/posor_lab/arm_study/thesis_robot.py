"""Printed data of the thesis' conceptual five-axis robot: its POSORs and the endpoint errors of section 9.3."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.errors import DataFileError
from scipy.constants import inch

from posor_lab.thesis_data import MICROINCH, URAD, parse_number, read_table

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from posor.numerics.array_types import FloatArray

JOINTS_FILE = "error_budget_five_axis_robot.csv"
ENDPOINT_FILE = "error_budget_robot_endpoint.csv"
SENSORS_ONLY = "9.3.1"  # section of the endpoint errors by the sensors alone
CONFIGURATIONS: Mapping[str, str] = {"extended": "fully extended", "bent": "bent wrist"}
"""Names of the configurations in the table."""


@dataclass(frozen=True)
class PrintedJoint:
    """A joint of the robot in section 9.3.1."""

    outside_diameter: float  # outside diameter of its POSOR [m]
    large: float  # accuracy of the large rotation [rad]
    small: float  # accuracy of the small rotations [rad]


@dataclass(frozen=True)
class PrintedEndpoint:
    """Printed root mean square errors of the endpoint."""

    orientation: FloatArray  # about X, Y, Z [rad], (3,)
    displacement: FloatArray  # along X, Y, Z [m], (3,)
    total: float  # printed root sum square of the displacements [m]


def read_joints(path: Path) -> dict[str, PrintedJoint]:
    """Return the joints by their names in the URDF, from base to wrist.

    Raises:
        DataFileError: The file cannot be read, lacks a column, or has an invalid number.

    """
    columns = ("posor_od_in", "large_dof_accuracy_urad", "small_dof_accuracy_urad")
    joints = {}
    for row in read_table(path, ["joint", *columns]):
        diameter, large, small = (parse_number(row, column, f"{path}, row '{row['joint']}'") for column in columns)
        joints[row["joint"].replace(" ", "_")] = PrintedJoint(diameter * inch, large * URAD, small * URAD)
    return joints


def read_endpoint(path: Path) -> dict[str, PrintedEndpoint]:
    """Return the endpoint errors by the sensors alone, by configuration.

    Raises:
        DataFileError: The file cannot be read, lacks a column or a configuration, or has an invalid number.

    """
    shifts, turns = ("dX_uin", "dY_uin", "dZ_uin"), ("alpha_X_urad", "alpha_Y_urad", "alpha_Z_urad")
    rows = read_table(path, ["section", "configuration", *shifts, "total_uin", *turns])
    printed = {}
    for name, printed_name in CONFIGURATIONS.items():
        row = next((r for r in rows if (r["section"], r["configuration"]) == (SENSORS_ONLY, printed_name)), None)
        if row is None:
            raise DataFileError(f"no row of section {SENSORS_ONLY} for '{printed_name}'", where=str(path))
        where = f"{path}, row '{printed_name}'"
        printed[name] = PrintedEndpoint(
            np.array([parse_number(row, column, where) for column in turns]) * URAD,
            np.array([parse_number(row, column, where) for column in shifts]) * MICROINCH,
            parse_number(row, "total_uin", where) * MICROINCH,
        )
    return printed
