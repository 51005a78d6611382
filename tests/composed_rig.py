# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The 1985 rig for tests: files with its paths, a composition of its nodes, and the program that runs it."""

from __future__ import annotations

from pathlib import Path
from string import Template

from posor_lab.harness.program import installed
from posor_lab.harness.rig_files import bag_path, calibration_path, urdf_path

COMPOSE = installed("posor_estimator", "compose")
NODES = ["/rig/chain_node", "/rig/joint1/posor_node", "/rig/joint1/driver_node"]
PATHS = {"urdf": urdf_path(), "calibration": calibration_path("printed"), "bag": bag_path("ymo")}


def filled(template: str) -> str:
    """Return a file beside this one with the paths of the rig put in."""
    return Template(Path(__file__).with_name(template).read_text(encoding="utf-8")).substitute(PATHS)


RIG = filled("rig_composition.yaml")


def write_composition(folder: Path, text: str) -> Path:
    path = folder / "nodes.yaml"
    path.write_text(text, encoding="utf-8")
    return path
