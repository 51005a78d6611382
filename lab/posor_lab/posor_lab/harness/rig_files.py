# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Paths of the installed files of the 1985 rig."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

from ament_index_python.packages import get_package_share_directory

Bag = Literal["ymo", "yzmo", "zmo"]  # recorded motion tests of 1985
CalibrationName = Literal["printed", "section84"]  # calibration files of the 1985 rig
BAGS: tuple[Bag, ...] = get_args(Bag)
CALIBRATIONS: tuple[CalibrationName, ...] = get_args(CalibrationName)
JOINT = "joint1"  # name of the rig's only joint in the URDF


def share() -> Path:
    """Return the share folder of posor_bringup."""
    return Path(get_package_share_directory("posor_bringup"))


def bag_path(bag: Bag) -> Path:
    """Return the folder of a recorded motion test."""
    return share() / "bags" / bag


def calibration_path(name: CalibrationName) -> Path:
    """Return the path of a calibration file."""
    return share() / "config" / f"slocum1985_{name}.yaml"


def urdf_path() -> Path:
    """Return the path of the URDF."""
    return share() / "urdf" / "slocum1985_rig.urdf"
