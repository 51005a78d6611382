# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Imports: down the rooms and layers only, without cycles, and ROS only where nodes live."""

from __future__ import annotations

import re
import sys
from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest
from draw_rooms import FLOOR, PACKAGES, PICTURE, build_graph, count_imports, room_of

ROOT = Path(__file__).resolve().parents[1]
WITHOUT_ROS = {"posor", "posor_calibration", "posor_design"}
ROS_LIBRARIES = {"posor_msgs", "rclpy", "ament_index_python", "launch", "rosidl_parser", "tf2_msgs"}
LAYERS_OF_POSOR = (  # lowest first; parts of one line may import each other
    (
        *("arm_names", "claim", "errors", "input_text", "lazy_program", "library_programs", "optional_library"),
        *("output_files", "plugins", "reporting", "ros_names"),
    ),
    ("numerics",),
    ("model",),
    ("calibration", "sensors", "node_parameters", "parameter_model"),
    ("estimation",),
    ("chain",),
    ("uncertainty",),
    ("messages",),
    ("bags", "tables", "certificates", "kernel_build", "kernel_examples"),
    ("correction",),
    ("",),  # posor itself: the public Python API
)
LAYER = {f"posor.{part}".rstrip("."): layer for layer, parts in enumerate(LAYERS_OF_POSOR) for part in parts}


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    """Every import but those for type checkers only."""
    return build_graph(for_type_checkers=False)


def layer_of(module: str) -> int:
    """Return the layer of a module of ``posor``."""
    return LAYER[".".join(module.split(".")[:2])]


def own_imports(graph: grimp.ImportGraph) -> list[tuple[str, str]]:
    """Return pairs of our modules: the importer and the imported one."""
    own = [module for module in graph.modules if room_of(module) in PACKAGES]
    return [(a, b) for a in sorted(own) for b in sorted(graph.find_modules_directly_imported_by(a)) if b in own]


def describe_import(graph: grimp.ImportGraph, importer: str, imported: str) -> str:
    detail = graph.get_import_details(importer=importer, imported=imported)[0]
    return f"{importer}, line {detail['line_number']}: {detail['line_contents']}"


def test_every_part_of_the_library_has_a_layer(graph: grimp.ImportGraph) -> None:
    parts = {".".join(module.split(".")[:2]) for module in graph.modules if room_of(module) == "posor"}
    assert parts == set(LAYER)


def test_no_import_cycles() -> None:
    imports: dict[str, set[str]] = {}
    for importer, imported in own_imports(build_graph(for_type_checkers=True)):
        imports.setdefault(importer, set()).add(imported)
    TopologicalSorter(imports).prepare()


def goes_up(importer: str, imported: str) -> bool:
    room, other = room_of(importer), room_of(imported)
    if room != other:
        return FLOOR[other] <= FLOOR[room]
    return room == "posor" and layer_of(imported) > layer_of(importer)


def test_imports_go_down_the_rooms_and_the_layers_of_the_library(graph: grimp.ImportGraph) -> None:
    wrong = [describe_import(graph, *pair) for pair in own_imports(graph) if goes_up(*pair)]
    assert not wrong, "\n".join(wrong)


def test_the_picture_of_the_rooms_shows_every_arrow() -> None:
    drawn = re.findall(r"<title>(\w+) imports (\w+)</title>", PICTURE.read_text(encoding="utf-8"))
    assert set(drawn) == set(count_imports(build_graph(for_type_checkers=True))), "call 'make rooms'"


def test_only_rooms_of_nodes_import_ros(graph: grimp.ImportGraph) -> None:
    wrong = [
        describe_import(graph, importer, imported)
        for importer in sorted(graph.modules)
        if room_of(importer) in WITHOUT_ROS
        for imported in sorted(graph.find_modules_directly_imported_by(importer))
        if imported in ROS_LIBRARIES or room_of(imported) == "posor_ros"
    ]
    assert not wrong, "\n".join(wrong)


def test_the_independent_truth_shares_no_code() -> None:
    graph, inside = build_graph(for_type_checkers=True), "posor_lab.independent"
    truth = [module for module in graph.modules if module.startswith(inside)]
    assert len(truth) > 5
    imported = {other for module in truth for other in graph.find_modules_directly_imported_by(module)}
    others = {module for module in imported if not module.startswith(inside) and module != "posor_lab"}
    assert {module.partition(".")[0] for module in others} <= {
        "numpy",
        "pinocchio",
        "scipy",
        "yaml",
        *sys.stdlib_module_names,
    }


def test_file_names_are_unique() -> None:
    """Two files of one name cannot be distinguished in a search, an editor's tab or a traceback."""
    required_by_frameworks = {"__init__.py", "conftest.py", "setup.py"}
    folders = [ROOT / name for name in ("bags", "data", "examples", "lab", "tests", "tools")]
    folders += [ROOT / "ros2_ws" / "src" / room for room in PACKAGES if room != "posor_lab"]
    names = Counter(path.name for folder in folders for path in folder.rglob("*.py"))
    assert not {name for name, count in names.items() if count > 1} - required_by_frameworks
