# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""``posor arm new``: the files of a simulated arm, to be completed by the measured values of a real one."""

from __future__ import annotations

import math
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
import pinocchio as pin
from jinja2 import Environment, PackageLoader, StrictUndefined
from posor.calibration.designs import CONVERTER_BITS, LIGHT_RING_BITS, STANDOFF, converter_steps, design, sized_design
from posor.calibration.document_text import document_text
from posor.errors import OutputError
from posor.output_files import writing

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray

Axis = Literal["x", "y", "z"]
Sensors = Literal["light_ring", "bumpy_ring", "diodes"]
AXES: tuple[Axis, ...] = get_args(Axis)
SENSORS: tuple[Sensors, ...] = get_args(Sensors)
COMMON_AXES = "zyyxyx"  # of a six-joint arm; longer arms repeat them
PLATE_DIAMETER, PLATE_DIAMETER_1985 = 0.1524, 0.254  # [m]
PLATE_THICKNESS, DENSITY = 0.0127, 2700.0  # [m], [kg/m^3]
OUTER_DIAMETER, INNER_DIAMETER = 0.0508, 0.04445  # of the beams [m]
TURN, TURN_OF_DIODES = 0.3, 0.05  # largest angle of the simulated motion [rad]; two fixed diodes see no more
SHORTEST, LONGEST = 0.1, 3.0
"""Lengths of a beam for which its assumed section is sensible [m]."""

_ROTATIONS: dict[Axis, FloatArray] = {
    "x": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "z": np.eye(3),
}
"""Rotation of a receiving plate in the base, its Z along the axis of the joint, at the angle zero of all joints."""


@dataclass(frozen=True)
class NewJoint:
    """A joint and the beam that follows it; the texts are attributes of the URDF."""

    name: str
    axis: Axis  # of the base, at the angle zero of all joints
    length: float  # of the beam [m]
    sensors: Sensors
    after: Axis  # axis of the next joint; of the last one: of the endpoint's Z

    @property
    def diameter(self) -> float:
        """Outside diameter of the plates [m]."""
        return PLATE_DIAMETER_1985 if self.sensors == "diodes" else PLATE_DIAMETER

    @property
    def plate_mass(self) -> str:
        """Mass of one plate [kg]."""
        return f"{0.25 * math.pi * self.diameter**2 * PLATE_THICKNESS * DENSITY:.4g}"

    @property
    def turn(self) -> float:
        """Largest angle of the simulated motion [rad]."""
        return TURN_OF_DIODES if self.sensors == "diodes" else TURN

    @property
    def rpy(self) -> str:
        """Orientation of the receiving plate in the base."""
        return _rpy(_ROTATIONS[self.axis])

    @property
    def rpy_next(self) -> str:
        """Orientation of the next plate in the target plate."""
        return _rpy(_ROTATIONS[self.axis].T @ _ROTATIONS[self.after])

    @property
    def rpy_beam(self) -> str:
        """Orientation of a cylinder along the beam."""
        return "0 0 0" if self.axis == "x" else f"0 {0.5 * math.pi} 0"

    @property
    def xyz(self) -> str:
        """End of the beam in the target plate: along X of the base."""
        return _along(_ROTATIONS[self.axis].T[:, 0] * self.length)

    @property
    def xyz_middle(self) -> str:
        """Middle of the beam in the target plate."""
        return _along(0.5 * _ROTATIONS[self.axis].T[:, 0] * self.length)

    def calibration(self, arm: str) -> Calibration:
        """Return the design of the joint's POSOR."""
        frames, title = (f"{self.name}_receiving", f"{self.name}_target"), f"{arm}_{self.name}"
        if self.sensors == "diodes":
            return design("quad_diodes", motion=True, frames=frames).model_copy(update={"name": title})
        name: Literal["checked_light_ring", "checked_bumpy_ring"]
        name = "checked_light_ring" if self.sensors == "light_ring" else "checked_bumpy_ring"
        return sized_design(name, self.diameter, frames=frames, title=title)


def _rpy(rotation: FloatArray) -> str:
    return " ".join(f"{angle + 0.0:.17g}" for angle in pin.rpy.matrixToRpy(rotation))


def _along(vector: FloatArray) -> str:
    return " ".join(f"{each + 0.0:.9g}" for each in vector)


def new_joints(
    names: Sequence[str], axes: Sequence[Axis], lengths: Sequence[float], sensors: Sequence[Sensors]
) -> list[NewJoint]:
    """Return the joints of an arm from the base on; all sequences have one entry for each joint."""
    after: list[Axis] = [*axes[1:], "z"]
    return [NewJoint(*joint) for joint in zip(names, axes, lengths, sensors, after, strict=True)]


def arm_texts(name: str, joints: Sequence[NewJoint], folder: str) -> dict[str, str]:
    """Return the texts of all files by their paths in the folder of the arm; ``folder``: its path, for comments."""
    templates = Environment(
        loader=PackageLoader("posor_bringup", "arm_template"),
        undefined=StrictUndefined,
        keep_trailing_newline=True,
        autoescape=False,  # noqa: S701  names of ROS need no escapes
    )
    has_dark_scans = any(joint.sensors == "light_ring" for joint in joints)
    bits = LIGHT_RING_BITS if has_dark_scans else CONVERTER_BITS
    values = {
        "name": name,
        "folder": folder,
        "joints": joints,
        "bits": bits,
        "has_dark_scans": has_dark_scans,
        "thickness": PLATE_THICKNESS,
        "outer_diameter": OUTER_DIAMETER,
        "inner_diameter": INNER_DIAMETER,
    }
    files = {"arm.yaml": "arm.yaml", f"{name}.urdf": "arm.urdf", "beams.yaml": "beams.yaml"}
    files["scenario.yaml"] = "scenario.yaml"
    texts = {path: templates.get_template(f"{template}.j2").render(values) for path, template in files.items()}
    for joint in joints:
        content = joint.calibration(name).model_dump(mode="json") | {"converter": converter_steps(bits)}
        content["sensors"][0]["target_plane"]["point"]["value"][2] = STANDOFF  # so that nominal plates coincide
        comment = (
            "Made by posor arm new: an assumed design. Replace it by the calibration of your POSOR with the same\n"
            "# frames, see `posor calibrate list`. SI units throughout."
        )
        texts[f"calibrations/{joint.name}.yaml"] = document_text(content, comment)
    return texts


def write_arm(folder: Path, texts: dict[str, str]) -> None:
    """Write the files of an arm into a folder that is new or empty, all or none.

    Raises OutputError: the folder holds something, or cannot be written.
    """
    with writing(folder):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise OutputError("exists already", where=str(folder), expected="another name, or --folder")
        folder.parent.mkdir(parents=True, exist_ok=True)
        unfinished = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}-"))
        try:
            unfinished.chmod(0o755)
            for name, text in texts.items():
                path = unfinished / name
                path.parent.mkdir(exist_ok=True)
                path.write_text(text, encoding="utf-8")
            unfinished.rename(folder)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
