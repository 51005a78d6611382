# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The keys of package.xml that rosdep resolves to Ubuntu 24.04, and the documented way to all other libraries."""

from __future__ import annotations

import re
from configparser import ConfigParser
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

ROOT = Path(__file__).resolve().parents[1]
# Keys that rosdep/python.yaml of ros/rosdistro resolves to packages of apt (August 2026). Not here: python3-bokeh-pip
# calls the pip of the system (refused, PEP 668); python3-pydantic is 1.10 there; python3-numba is not in 24.04.
APT_KEYS = {"jinja2", "numpy", "pytest", "rich", "scipy", "yaml"}
MANIFESTS = sorted([*ROOT.glob("ros2_ws/src/*/package.xml"), *ROOT.glob("lab/*/package.xml")])


@pytest.mark.parametrize("path", MANIFESTS, ids=lambda path: path.parent.name)
def test_every_python_key_has_a_package_of_ubuntu(path: Path) -> None:
    keys = {str(each.text) for each in ET.parse(path).getroot() if each.tag.endswith("depend")}  # noqa: S314
    assert {key for key in keys if key.startswith("python3-")} <= {f"python3-{name}" for name in APT_KEYS}


@pytest.mark.parametrize(
    "path", [each for each in MANIFESTS if (each.parent / "test").is_dir()], ids=lambda path: path.parent.name
)
def test_colcon_runs_the_tests_with_pytest(path: Path) -> None:
    """Without this extra ``colcon test`` calls unittest, which finds no test."""
    settings = ConfigParser()
    settings.read(path.parent / "setup.cfg")
    assert settings["options.extras_require"]["test"].split() == ["pytest"]


def test_every_other_library_is_among_those_of_pip() -> None:
    text = (ROOT / "requirements/base.in").read_text(encoding="utf-8")
    required = {name.lower() for name in re.findall(r"^([A-Za-z][A-Za-z0-9-]*)>=", text, re.MULTILINE)}
    assert {"pydantic", "numba", "bokeh", "viser", "rosbags", "pyarrow", "pyvisa", "pymodbus", "mcap"} <= required
