# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Each node of an arm starts from a dump of its parameters, in the format of ``ros2 param dump``."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from posor_bringup.arm_programs import arm_programs, full_name
from posor_bringup.arms import check_arm, load_checked_arm
from posor_lab.harness.graph import Graph
from posor_lab.harness.program import Program
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.parameter import parameter_value_to_python

if TYPE_CHECKING:
    from array import array
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from posor_bringup.supervisor import Parameter, ProgramCommand

OF_NODES: dict[str, tuple[str, dict[str, Parameter]]] = {
    "chain_node": ("chain_node", {"frame_prefix": "cell1/", "max_wait": 2}),
    "posor_node": ("posor_node", {"encoder.sigma": 1e-3, "false_alarm": 1e-5}),
    "simulated": ("driver_node", {"simulated.noise": False, "simulated.rate": 50.0}),
    "bag": ("driver_node", {"source": "bag", "bag.path": "bags/ymo"}),
    "looped": ("driver_node", {"source": "looped", "looped.path": "bags/ymo", "looped.rate": 100}),
    "table": ("driver_node", {"source": "table", "table.path": "scans.csv", "table.map": "map.yaml"}),
    "instruments": (
        "driver_node",
        {"source": "instruments", "instruments.file": "devices.yaml", "instruments.joint": "a"},
    ),
}
"""A parameter of each kind, given as users do: whole numbers for floats and the other way round."""
WITHOUT_DATA = {"bag", "looped", "table", "instruments"}
"""Sources whose files do not exist: their nodes stay unconfigured."""
LONG = {"bag", "looped", "table", "instruments"}
"""Sources with parameters of the kinds that the others have."""


def values_of_node(command: Sequence[str], name: str, state: str) -> dict[str, Any]:
    """Start a node, wait until it is in a state, and return the values of all its parameters."""
    with Program(command) as node, Graph() as graph:
        graph.watch_diagnostics()
        graph.wait_for_status(f"{name}: lifecycle", state)
        names = graph.call(ListParameters, f"{name}/list_parameters", ListParameters.Request()).result.names
        values = graph.call(GetParameters, f"{name}/get_parameters", GetParameters.Request(names=names)).values
        assert node.end() == 0
    return dict(zip(names, map(plain, map(parameter_value_to_python, values)), strict=True))


def plain(value: object | array[Any]) -> object:
    return value if isinstance(value, bool | int | float | str) or value is None else list(value)  # type: ignore[call-overload]


def dump(name: str, values: Mapping[str, Any]) -> str:
    """Return a parameter file as ``ros2 param dump`` writes it: names are nested at their points."""
    nested: dict[str, Any] = {}
    for full, value in sorted(values.items()):
        *groups, last = full.split(".")
        place = nested
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = value
    return yaml.dump({name: {"ros__parameters": nested}}, default_flow_style=False)


def program_of(kind: str) -> ProgramCommand:
    executable, given = OF_NODES[kind]
    programs = {each.executable: each for each in arm_programs(load_checked_arm("test_rig"))}
    program = programs[executable]
    kept = {} if "source" in given else program.parameters
    return replace(program, parameters={**kept, **given, "autostart": kind not in WITHOUT_DATA})


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize("kind", [pytest.param(kind, marks=[pytest.mark.long] * (kind in LONG)) for kind in OF_NODES])
def test_a_node_starts_from_a_dump_of_its_parameters(kind: str, tmp_path: Path) -> None:
    program, file = program_of(kind), tmp_path / "dump.yaml"
    name, state = full_name(program), "unconfigured" if kind in WITHOUT_DATA else "active"
    values = values_of_node(program.command(), name, state)
    assert OF_NODES[kind][1].items() <= values.items()
    assert [each for each in values.values() if each is None] == []
    file.write_text(dump(name, values), encoding="utf-8")
    loaded = [*replace(program, parameters={}).command(), "--params-file", str(file)]
    assert values_of_node(loaded, name, state) == values
    if kind not in WITHOUT_DATA:
        (checked,) = (
            each for each in check_arm("test_rig", parameter_files=[file]).programs if full_name(each) == name
        )
        assert checked.parameters.items() >= values.items()
