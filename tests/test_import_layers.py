"""Imports between modules: without cycles, only from higher layers to lower ones, and ROS only where nodes live."""

from __future__ import annotations

from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("posor_estimator", "posor_drivers", "posor_bringup", "posor_lab")
LAYERS = (  # lowest first; packages of one line may import each other
    ("errors", "input_text", "lazy_program", "estimator_programs", "reporting", "ros_names"),
    ("numerics", "compilation"),
    ("model",),
    ("calibration", "sensors", "node_parameters", "parameter_model"),
    ("estimation",),
    ("chain",),
    ("identification", "uncertainty"),
    ("bags", "design", "warm_up"),
    ("__init__",),  # the public Python API
    ("ros",),
    ("testing",),
    ("posor_drivers",),
    ("posor_bringup",),
    ("posor_lab",),
)
LEVELS = {name: level for level, names in enumerate(LAYERS) for name in names}
ROS_LIBRARIES = {"rclpy", "ament_index_python", "launch", "rosidl_parser", "rosidl_runtime_py", "tf2_msgs"}
ROS_PACKAGES = {"ros", "testing"}  # the only parts of posor_estimator that may import rclpy


def build_graph(*, for_type_checkers: bool) -> grimp.ImportGraph:
    """Return every import of our packages, also those inside functions."""
    return grimp.build_graph(
        *PACKAGES,
        include_external_packages=True,
        exclude_type_checking_imports=not for_type_checkers,
        cache_dir=None,
    )


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    """Every import but those for type checkers only."""
    return build_graph(for_type_checkers=False)


def own_modules(graph: grimp.ImportGraph) -> list[str]:
    return sorted(module for module in graph.modules if module.partition(".")[0] in PACKAGES)


def layer_of(module: str) -> str:
    """Return the name in ``LAYERS`` that a module belongs to."""
    package, *inner = module.split(".")
    if package != "posor_estimator":
        return package
    return inner[0] if inner else "__init__"


def describe_import(graph: grimp.ImportGraph, importer: str, imported: str) -> str:
    detail = graph.get_import_details(importer=importer, imported=imported)[0]
    return f"{importer}, line {detail['line_number']}: {detail['line_contents']}"


def test_every_module_has_a_layer(graph: grimp.ImportGraph) -> None:
    assert {layer_of(module) for module in own_modules(graph)} <= set(LEVELS)


def test_no_import_cycles() -> None:
    graph = build_graph(for_type_checkers=True)
    own = set(own_modules(graph))
    TopologicalSorter({module: graph.find_modules_directly_imported_by(module) & own for module in own}).prepare()


def test_imports_go_from_higher_layers_to_lower_ones(graph: grimp.ImportGraph) -> None:
    upwards = [
        describe_import(graph, importer, imported)
        for importer in own_modules(graph)
        for imported in sorted(graph.find_modules_directly_imported_by(importer))
        if imported.partition(".")[0] in PACKAGES and LEVELS[layer_of(imported)] > LEVELS[layer_of(importer)]
    ]
    assert not upwards, "\n".join(upwards)


def test_only_nodes_import_ros(graph: grimp.ImportGraph) -> None:
    offenders = [
        describe_import(graph, importer, imported)
        for importer in own_modules(graph)
        if importer.startswith("posor_estimator") and layer_of(importer) not in ROS_PACKAGES
        for imported in sorted(graph.find_modules_directly_imported_by(importer) & ROS_LIBRARIES)
    ]
    assert not offenders, "\n".join(offenders)


def test_file_names_are_unique() -> None:
    """Two files of one name cannot be distinguished in a search, an editor's tab or a traceback."""
    required_by_frameworks = {"__init__.py", "conftest.py", "setup.py"}
    folders = [ROOT / name for name in ("bags", "data", "examples", "tests", "tools")]
    folders += [ROOT / "ros2_ws" / "src" / package for package in PACKAGES]
    names = Counter(path.name for folder in folders for path in folder.rglob("*.py"))
    assert not {name for name, count in names.items() if count > 1} - required_by_frameworks
