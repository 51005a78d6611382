"""Where the files of the 1985 rig are that this package installs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ament_index_python.packages import get_package_share_directory

if TYPE_CHECKING:
    from posor_bringup.expectations import Bag, CalibrationName

JOINT = "joint1"
"""The rig's only joint, as the URDF names it."""


def share() -> Path:
    """Return the package's share folder."""
    return Path(get_package_share_directory("posor_bringup"))


def bag_path(bag: Bag) -> Path:
    """Return the folder of a recorded motion test."""
    return share() / "bags" / bag


def calibration_path(name: CalibrationName) -> Path:
    """Return a calibration file."""
    return share() / "config" / f"slocum1985_{name}.yaml"


def urdf_path() -> Path:
    """Return the rig's URDF."""
    return share() / "urdf" / "slocum1985_rig.urdf"


def data_path(name: str) -> Path:
    """Return a table of the thesis."""
    return share() / "data" / name
