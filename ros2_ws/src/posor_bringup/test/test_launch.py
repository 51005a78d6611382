"""launch is not on PyPI: what can be checked without it."""

from __future__ import annotations

import ast
import py_compile
from pathlib import Path

from ament_index_python.packages import get_package_prefix
from posor_bringup.expectations import BAGS, CALIBRATIONS
from posor_bringup.installed import share

LAUNCH = share() / "launch" / "replay_1985.launch.py"


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
