"""The 1985 rig as a composition file, and the error lines of its program."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_bringup.installed import bag_path, calibration_path, urdf_path
from posor_lab.harness.program import installed

if TYPE_CHECKING:
    from pathlib import Path

COMPOSE = installed("posor_estimator", "compose")
NODES = ["/rig/chain_node", "/rig/joint1/posor_node", "/rig/joint1/driver_node"]
RIG = f"""\
format: posor_composition
version: 1
nodes:
  - node: chain_node
    namespace: /rig
    parameters: {{urdf: {urdf_path()}}}
  - node: posor_node
    namespace: /rig/joint1
    parameters: {{calibration: {calibration_path("printed")}, session: ymo}}
  - node: driver_node
    namespace: /rig/joint1
    parameters: {{source: bag, bag: {{path: {bag_path("ymo")}}}, loop: true, restamp: true}}
"""


def write_composition(folder: Path, text: str) -> Path:
    path = folder / "nodes.yaml"
    path.write_text(text, encoding="utf-8")
    return path
