"""Printed data of the thesis' conceptual five-axis robot: its POSORs and the endpoint errors of section 9.3."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.errors import DataFileError
from scipy.constants import inch

from posor_lab.thesis_data import URAD, parse_number, read_table

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from posor.numerics.array_types import FloatArray

JOINTS_FILE = "error_budget_five_axis_robot.csv"
ENDPOINT_FILE = "error_budget_robot_endpoint.csv"
SENSORS_ONLY = "9.3.1"  # section of the endpoint errors by the sensors alone
CONFIGURATIONS: Mapping[str, str] = {"extended": "fully extended", "bent": "bent wrist"}
"""Names of the configurations in the table."""
MICROINCH = 1e-6 * inch


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
    columns = {"posor_od_in": inch, "large_dof_accuracy_urad": URAD, "small_dof_accuracy_urad": URAD}
    return {
        row["joint"].replace(" ", "_"): PrintedJoint(
            *(parse_number(row, name, f"{path}, row '{row['joint']}'") * unit for name, unit in columns.items())
        )
        for row in read_table(path, ["joint", *columns])
    }


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
        *angles, x, y, z, total = (parse_number(row, column, where) for column in (*turns, *shifts, "total_uin"))
        printed[name] = PrintedEndpoint(np.array(angles) * URAD, np.array([x, y, z]) * MICROINCH, total * MICROINCH)
    return printed
