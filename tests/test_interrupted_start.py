"""Every installed program, interrupted while its libraries are being loaded."""

from __future__ import annotations

import os
import signal
from importlib.metadata import entry_points
from typing import TYPE_CHECKING

import pytest
from posor_estimator.starting import Starter
from posor_estimator.testing.program import Program, installed

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint
    from pathlib import Path

PACKAGES = ("posor_bringup", "posor_drivers", "posor_estimator")
PROGRAMS = [
    program for program in entry_points(group="console_scripts") if program.module.partition(".")[0] in PACKAGES
]
LIBRARY = """\
import signal

print("loading", flush=True)
while True:
    try:
        signal.pause()
    except BaseException:
        pass
"""
"""Stands for one that every program needs; never has done with loading, and catches whatever is raised in it."""


@pytest.fixture
def path(tmp_path: Path) -> str:
    """Return a path of modules that begins with that library."""
    (tmp_path / "numpy.py").write_text(LIBRARY, encoding="utf-8")
    return os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])


def test_every_package_has_programs() -> None:
    assert {program.module.partition(".")[0] for program in PROGRAMS} == set(PACKAGES)


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_it_says_so_in_one_line(path: str, program: EntryPoint) -> None:
    starter = program.load()
    assert isinstance(starter, Starter)
    assert starter.name == program.name
    package = program.module.partition(".")[0]
    number = signal.SIGTERM if program.name in ("chain_node", "record", "demo") else signal.SIGINT
    with Program(installed(package, program.name), {"PYTHONPATH": path}) as running:
        running.wait_for_line("loading")
        assert running.end(number) == 130
        assert running.stderr == [f"{program.name}: interrupted."]
