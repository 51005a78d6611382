# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Launch files, as far as they can be checked without ``launch``, which is not on PyPI."""

from __future__ import annotations

import ast
import importlib
import inspect
import py_compile
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix
from posor_bringup.arm_programs import arm_programs
from posor_bringup.arms import check_arm, load_checked_arm
from posor_lab.harness.rig_files import BAGS, CALIBRATIONS, share

REPLAY, ARM = (share() / "launch" / f"{name}.launch.py" for name in ("replay_1985", "arm"))


def syntax_nodes(path: Path) -> list[ast.AST]:
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


@pytest.mark.parametrize("path", sorted((share() / "launch").glob("*.launch.py")), ids=lambda path: path.name)
def test_launch_file_compiles(path: Path, tmp_path: Path) -> None:
    assert py_compile.compile(str(path), cfile=str(tmp_path / "compiled.pyc"), doraise=True)


def test_replay_starts_installed_executables() -> None:
    nodes = [
        {keyword.arg: str(keyword.value.value) for keyword in call.keywords if isinstance(keyword.value, ast.Constant)}
        for call in syntax_nodes(REPLAY)
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "Node"
    ]
    assert [node["executable"] for node in nodes] == ["posor_node", "chain_node", "driver_node"]
    for node in nodes:
        assert Path(get_package_prefix(node["package"]), "lib", node["package"], node["executable"]).is_file()


def test_replay_offers_every_bag_and_calibration() -> None:
    lists = [
        [entry.value for entry in node.elts if isinstance(entry, ast.Constant)]
        for node in syntax_nodes(REPLAY)
        if isinstance(node, ast.List)
    ]
    assert list(BAGS) in lists
    assert list(CALIBRATIONS) in lists


def test_arm_launch_file_uses_existing_functions_and_attributes() -> None:
    nodes = syntax_nodes(ARM)
    imported = [
        (node.module, alias.name)
        for node in nodes
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("posor_")
        for alias in node.names
    ]
    assert {"GraphObserver", "check_arm", "parse_driver_parameters", "write_views"} <= {name for _, name in imported}
    for module, name in imported:
        assert hasattr(importlib.import_module(module), name)
    used = {node.attr for node in nodes if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "program"}
    assert used == {"package", "executable", "namespace", "parameters", "enclave", "ends"}
    (observer,) = (node for node in nodes if isinstance(node, ast.Call) and ast.unparse(node.func) == "GraphObserver")
    assert ast.unparse(observer.args[0]).startswith("enclave_of_arm(")
    (call,) = (node for node in nodes if isinstance(node, ast.Call) and ast.unparse(node.func) == "check_arm")
    assert {keyword.arg for keyword in call.keywords} <= set(inspect.signature(check_arm).parameters)
    for program in arm_programs(load_checked_arm("five_axis")):
        assert all(getattr(program, attribute) for attribute in used - {"ends"})
