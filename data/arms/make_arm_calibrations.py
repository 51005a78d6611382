# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Make the calibration files of the simulated arms from the estimator's designs.

Usage, with the Python of the workspace: ``python data/arms/make_arm_calibrations.py [OUTPUT_FOLDER]``. Writes
``<arm>/calibrations/<joint>.yaml`` for each arm, the same bytes on every run. The provenance in each file states the
source of its numbers.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from posor.calibration.designs import SizedDesignName, design, sized_design
from posor.calibration.document_text import document_text

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration

HERE = Path(__file__).resolve().parent
DEFAULT_OUTPUT = HERE.parents[1] / "ros2_ws/src/posor_bringup/arms"
INCH = 0.0254
NAME = "data/arms/make_arm_calibrations.py"

FIVE_AXIS = {"base_swivel": 8.0, "shoulder": 8.0, "elbow": 6.0, "wrist_roll": 5.0, "wrist_yaw": 4.0}
"""Outside diameters [inch] of the conceptual robot of the thesis, section 9.3.1."""
FIVE_AXIS_CHECKED = {joint: 1.2 * diameter for joint, diameter in FIVE_AXIS.items()}
"""Larger, assumed: on the same errors of probes a larger circle gives a smaller tilt and turn."""
SIX_AXIS = {"base_turn": 8.0, "shoulder": 8.0, "elbow": 6.0, "wrist_roll": 5.0, "wrist_pitch": 5.0, "tool_roll": 4.0}
"""Outside diameters [inch], assumed."""
TEST_RIG = "joint1"

SIZED: dict[str, tuple[SizedDesignName, dict[str, float]]] = {
    "five_axis": ("triad_bumpy_ring", FIVE_AXIS),
    "five_axis_checked": ("checked_bumpy_ring", FIVE_AXIS_CHECKED),
    "six_axis": ("checked_light_ring", SIX_AXIS),
}


def frames(joint: str) -> tuple[str, str]:
    """Return the names of the receiving and the target plate of a joint in the URDFs."""
    return f"{joint}_receiving", f"{joint}_target"


def calibrations() -> dict[str, Calibration]:
    """Return all calibrations by the paths of their files in the folder of the arms."""
    sized = {
        f"{arm}/calibrations/{joint}.yaml": sized_design(
            stack, diameter * INCH, frames=frames(joint), title=f"{arm}_{joint}"
        )
        for arm, (stack, diameters) in SIZED.items()
        for joint, diameter in diameters.items()
    }
    rig = design("triad_diodes", motion=True, converter=True, frames=frames(TEST_RIG)).model_copy(
        update={"name": "test_rig_joint1"}
    )
    return {**sized, f"test_rig/calibrations/{TEST_RIG}.yaml": rig}


def write(path: Path, calibration: Calibration) -> None:
    """Write one calibration file."""
    content = calibration.model_dump(mode="json")
    content["provenance"]["method"] += f", written by {NAME}"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(document_text(content, f"Made by {NAME}; SI units throughout."), encoding="utf-8")


def main(output: Path) -> None:
    """Write all files into the folder of the arms."""
    for name, calibration in calibrations().items():
        write(output / name, calibration)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else DEFAULT_OUTPUT)
