"""launch is not on PyPI: what can be checked without it."""

from __future__ import annotations

import ast
import importlib
import inspect
import py_compile
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix
from posor_bringup.arm_programs import arm_programs
from posor_bringup.arms import checked_arm
from posor_bringup.command_line import parameters_in
from posor_bringup.expectations import BAGS, CALIBRATIONS
from posor_bringup.installed import share
from posor_estimator.errors import ParameterError

LAUNCH = share() / "launch" / "replay_1985.launch.py"
ARM = share() / "launch" / "arm.launch.py"


def test_the_launch_file_compiles(tmp_path: Path) -> None:
    assert py_compile.compile(str(LAUNCH), cfile=str(tmp_path / "compiled.pyc"), doraise=True)


def test_the_launch_file_starts_what_is_installed() -> None:
    calls = [node for node in ast.walk(ast.parse(LAUNCH.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    nodes = [
        {keyword.arg: str(keyword.value.value) for keyword in call.keywords if isinstance(keyword.value, ast.Constant)}
        for call in calls
        if isinstance(call.func, ast.Name) and call.func.id == "Node"
    ]
    assert [node["executable"] for node in nodes] == ["posor_node", "chain_node", "driver_node"]
    for node in nodes:
        assert Path(get_package_prefix(node["package"]), "lib", node["package"], node["executable"]).is_file()


def test_the_launch_file_offers_every_test_and_calibration() -> None:
    lists = [
        [entry.value for entry in node.elts if isinstance(entry, ast.Constant)]
        for node in ast.walk(ast.parse(LAUNCH.read_text(encoding="utf-8")))
        if isinstance(node, ast.List)
    ]
    assert list(BAGS) in lists
    assert list(CALIBRATIONS) in lists


def test_the_arms_launch_file_compiles(tmp_path: Path) -> None:
    assert py_compile.compile(str(ARM), cfile=str(tmp_path / "compiled.pyc"), doraise=True)


def test_the_arms_launch_file_uses_what_there_is() -> None:
    tree = ast.parse(ARM.read_text(encoding="utf-8"))
    imported = [
        (node.module, alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("posor_")
        for alias in node.names
    ]
    assert sorted(name for _, name in imported) == ["arm_programs", "checked_arm", "parameters_in"]
    for module, name in imported:
        assert hasattr(importlib.import_module(module), name)
    used = {
        node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "program"
    }
    assert used == {"package", "executable", "namespace", "parameters"}
    called = [
        node for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func) == "arm_programs"
    ]
    keywords = {keyword.arg for keyword in called[0].keywords}
    assert keywords <= set(inspect.signature(arm_programs).parameters)
    for program in arm_programs(checked_arm("five_axis")):
        assert all(getattr(program, attribute) for attribute in used)


def test_drivers_of_a_launched_arm_take_parameters() -> None:
    given = parameters_in("simulated.sag:=false  simulated.cycles:=2")
    assert given == {"simulated.sag": False, "simulated.cycles": 2}
    drivers = [p for p in arm_programs(checked_arm("five_axis"), driver_parameters=given) if p.ends]
    assert [driver.parameters["simulated.sag"] for driver in drivers] == [False] * 5
    assert parameters_in("") == {}
    with pytest.raises(ParameterError) as caught:
        parameters_in("simulated.sag=false")
    assert str(caught.value) == (
        "launch argument 'driver_parameters': 'simulated.sag=false' is no parameter, name:=value."
    )
