"""What the thesis printed about its conceptual five-axis robot: its POSORs, and the endpoint errors of section 9.3."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor_estimator.core.design_parts import INCH
from posor_estimator.errors import DataFileError

from posor_bringup.thesis import URAD, read_table

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from posor_estimator.core.types import FloatArray

JOINTS_FILE = "error_budget_five_axis_robot.csv"
ENDPOINT_FILE = "error_budget_robot_endpoint.csv"
SENSORS_ONLY = "9.3.1"
"""Section whose endpoint errors come of the sensors only."""
CONFIGURATIONS: Mapping[str, str] = {"extended": "fully extended", "bent": "bent wrist"}
"""Configurations by what the table calls them."""

MICROINCH = 1e-6 * INCH


@dataclass(frozen=True)
class PrintedJoint:
    """A joint of the robot as section 9.3.1 has it.

    Attributes:
        outside_diameter: Of its POSOR [m].
        large: Accuracy of its large rotation [rad].
        small: Accuracy of its small rotations [rad].

    """

    outside_diameter: float
    large: float
    small: float


@dataclass(frozen=True)
class PrintedEndpoint:
    """Root mean square errors of the endpoint as printed.

    Attributes:
        orientation: About X, Y, Z [rad], (3,).
        displacement: Along X, Y, Z [m], (3,).
        total: Root sum square of the displacements [m], as printed.

    """

    orientation: FloatArray
    displacement: FloatArray
    total: float


def read_joints(path: Path) -> dict[str, PrintedJoint]:
    """Return the joints by their names in the URDF, base to wrist.

    Raises:
        DataFileError: The file cannot be read, lacks a column, or has a cell that is no number.

    """
    columns = ("posor_od_in", "large_dof_accuracy_urad", "small_dof_accuracy_urad")
    joints = {}
    for row in read_table(path, ["joint", *columns]):
        diameter, large, small = (_number(row, column, path, row["joint"]) for column in columns)
        joints[row["joint"].replace(" ", "_")] = PrintedJoint(diameter * INCH, large * URAD, small * URAD)
    return joints


def read_endpoint(path: Path) -> dict[str, PrintedEndpoint]:
    """Return the endpoint's errors that come of the sensors only, by configuration.

    Raises:
        DataFileError: The file cannot be read, lacks a column or a configuration, or has a cell that is no number.

    """
    shifts, turns = ("dX_uin", "dY_uin", "dZ_uin"), ("alpha_X_urad", "alpha_Y_urad", "alpha_Z_urad")
    rows = read_table(path, ["section", "configuration", *shifts, "total_uin", *turns])
    printed = {}
    for name, said in CONFIGURATIONS.items():
        row = next((r for r in rows if (r["section"], r["configuration"]) == (SENSORS_ONLY, said)), None)
        if row is None:
            raise DataFileError(f"no row of section {SENSORS_ONLY} for '{said}'", where=str(path))
        printed[name] = PrintedEndpoint(
            np.array([_number(row, column, path, said) for column in turns]) * URAD,
            np.array([_number(row, column, path, said) for column in shifts]) * MICROINCH,
            _number(row, "total_uin", path, said) * MICROINCH,
        )
    return printed


def _number(row: Mapping[str, str], column: str, path: Path, name: str) -> float:
    try:
        return float(row[column])
    except ValueError:
        raise DataFileError(
            f"'{row[column]}' is no number", where=f"{path}, row '{name}', column '{column}'", expected="a number"
        ) from None
