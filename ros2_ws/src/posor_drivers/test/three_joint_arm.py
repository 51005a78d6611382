# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A simulated arm for tests: three joints, on disk as a user's arm is."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from posor.calibration.designs import SizedDesignName, sized_design
from posor.chain.arm_file import load_arm_file
from posor.errors import CalibrationError
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.imperfections import Imperfections
from posor_lab.harness.beams import beams_content, plate, quantity, tube, uncertainty
from posor_lab.harness.case_tables import refusal

SCENARIO = Path(__file__).parent / "scenarios" / "three_joints.yaml"
JOINTS = ("base", "shoulder", "elbow")
N = 800
TICKS = np.arange(N)
FAR = 172_800_000_000  # a tick of today: 54 years at 100 Hz; a whole number of cycles
DESIGNS: dict[str, tuple[SizedDesignName, float]] = {
    "base": ("triad_bumpy_ring", 0.2032),
    "shoulder": ("triad_light_ring", 0.2032),
    "elbow": ("triad_bumpy_ring", 0.1524),
}
PROVENANCE = {"source": "a test", "method": "by hand", "date": "none"}

BEAMS = (
    # name, parent, child, origin of the child, roll-pitch-yaw
    ("column", "base", "base_receiving", "0 0 0.4", "0 0 0"),
    ("riser", "base_target", "shoulder_receiving", "0 0 0.2", "-1.5707963267948966 0 0"),
    ("upper_arm", "shoulder_target", "elbow_receiving", "0.6 0 0", "0 0 0"),
    ("forearm", "elbow_target", "endpoint", "0.5 0 0.05", "0 0 0"),
)
LENGTHS = {"upper_arm": 0.6, "forearm": float(np.hypot(0.5, 0.05))}
URDF = "\n".join(
    [
        '<robot name="three_joints"><link name="base"/><link name="endpoint"/>',
        *(
            f'<link name="{joint}_receiving"/><link name="{joint}_target"/><joint name="{joint}" type="floating">'
            f'<parent link="{joint}_receiving"/><child link="{joint}_target"/><origin xyz="0 0 0.000735"/></joint>'
            for joint in JOINTS
        ),
        *(
            f'<joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/></joint>'
            for name, parent, child, xyz, rpy in BEAMS
        ),
        "</robot>",
    ]
)


def _sag(length: float) -> dict[str, Any]:
    return {
        "tube": tube(0.0508, 0.04445),
        "gimbals": quantity([0.2 * length, 0.8 * length], "m"),
        "plates": [plate("first", 0.0, 1.0)],
        "uncertainty": quantity(0.01, "1"),
    }


def _beams() -> dict[str, Any]:
    known = {"uncertainty": uncertainty([2e-7] * 3, [2e-7] * 3)}
    return beams_content(
        *(
            {"joint": name, **known} | ({"sag": _sag(LENGTHS[name])} if name in LENGTHS else {})
            for name, *_ in BEAMS[1:]
        )
    )


def scenario(changes: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the scenario with other values at some key paths, such as ``motion.1.at``; None removes the entry."""
    content: dict[str, Any] = yaml.load(SCENARIO.read_text(encoding="utf-8"), Loader=yaml.CSafeLoader)
    for path, value in (changes or {}).items():
        *parents, last = [int(part) if part.isdigit() else part for part in path.split(".")]
        entry: Any = content
        for part in parents:
            entry = entry[part]
        if value is None:
            del entry[last]
        else:
            entry[last] = value
    return content


def perfect(content: dict[str, Any]) -> dict[str, Any]:
    """Return a scenario with perfect mechanics: no play, no steps, no error motions, rigid links."""
    content = deepcopy(content)
    content["joints"] = {joint: {} for joint in content["joints"]}
    return content


def write_arm(folder: Path, content: dict[str, Any] | None = None) -> Path:
    (folder / "arm.urdf").write_text(URDF, encoding="utf-8")
    for joint in JOINTS:
        (folder / f"{joint}.yaml").write_text(_calibration(joint), encoding="utf-8")
    _write(folder / "beams.yaml", _beams())
    _write(folder / "scenario.yaml", scenario() if content is None else content)
    arm = {
        "format": "posor_arm",
        "version": 1,
        "name": "arm",
        "provenance": PROVENANCE,
        "urdf": "arm.urdf",
        "beams": "beams.yaml",
        "joints": {joint: {"calibration": f"{joint}.yaml"} for joint in JOINTS},
        "driver": {"source": "simulated"},
        "scenario": "scenario.yaml",
    }
    _write(folder / "arm.yaml", arm)
    return folder / "arm.yaml"


@cache
def _calibration(joint: str) -> str:
    frames = (f"{joint}_receiving", f"{joint}_target")
    return _text(sized_design(*DESIGNS[joint], frames=frames, title=joint).model_dump(mode="json", exclude_none=True))


def _text(content: object) -> str:
    return str(yaml.dump(content, Dumper=yaml.CSafeDumper, sort_keys=False))


def _write(path: Path, content: object) -> None:
    path.write_text(_text(content), encoding="utf-8")


def simulation(
    folder: Path, switches: Imperfections | None = None, content: dict[str, Any] | None = None
) -> ArmSimulation:
    return ArmSimulation(load_arm_file(write_arm(folder, content)), switches)


def refused(folder: Path, content: dict[str, Any]) -> CalibrationError:
    return refusal(CalibrationError, simulation, folder, content=content)
