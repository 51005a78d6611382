"""Every installed program, interrupted during its imports."""

from __future__ import annotations

import os
import signal
from importlib.metadata import entry_points
from typing import TYPE_CHECKING

import pytest
from posor_estimator.lazy_program import LazyProgram
from posor_estimator.testing.program import Program, installed

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint
    from pathlib import Path

PACKAGES = ("posor_bringup", "posor_drivers", "posor_estimator", "posor_validation")
PROGRAMS = [
    program for program in entry_points(group="console_scripts") if program.module.partition(".")[0] in PACKAGES
]
ENDLESS_LIBRARY = """\
import signal

print("loading", flush=True)
while True:
    try:
        signal.pause()
    except BaseException:
        pass
"""
"""Substitute for a library of every program: its import never ends and catches every exception."""


@pytest.fixture
def path(tmp_path: Path) -> str:
    """Return a module path that begins with that library."""
    (tmp_path / "numpy.py").write_text(ENDLESS_LIBRARY, encoding="utf-8")
    return os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])


def test_every_package_has_programs() -> None:
    assert {program.module.partition(".")[0] for program in PROGRAMS} == set(PACKAGES)


@pytest.mark.long
@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_an_interrupted_import_ends_with_one_line(path: str, program: EntryPoint) -> None:
    lazy_program = program.load()
    assert isinstance(lazy_program, LazyProgram)
    assert lazy_program.name == program.name
    package = program.module.partition(".")[0]
    number = signal.SIGTERM if program.name in ("chain_node", "record", "demo") else signal.SIGINT
    with Program(installed(package, program.name), {"PYTHONPATH": path}) as running:
        running.wait_for_line("loading")
        assert running.end(number) == 130
        assert running.stderr == [f"{program.name}: interrupted."]
