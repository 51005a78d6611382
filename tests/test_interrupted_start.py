# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Installed programs that are interrupted while they start, or started with low limits of the process."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path

import pytest
from posor.lazy_program import LazyProgram, interrupts_blocked
from posor_lab.harness.program import Program, in_background, installed, script

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("posor_bringup", "posor_drivers", "posor_estimator", "posor_lab")
PROGRAMS = [
    program
    for program in entry_points(group="console_scripts")
    if program.module.partition(".")[0] in PACKAGES and program.name != "posor"  # it only starts the others
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


@pytest.mark.parametrize(
    "program",
    [each for each in entry_points(group="console_scripts") if each.module.startswith("posor")],
    ids=lambda program: program.name,
)
def test_every_program_can_be_loaded_by_its_name(program: EntryPoint) -> None:
    lazy_program = program.load()
    assert isinstance(lazy_program, LazyProgram)
    assert lazy_program.name == program.name
    assert find_spec(lazy_program.module) is not None


@pytest.mark.long
@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_an_interrupted_import_ends_with_one_line(path: str, program: EntryPoint) -> None:
    package = program.module.partition(".")[0]
    number = signal.SIGTERM if program.name in ("chain_node", "record", "demo") else signal.SIGINT
    with Program(installed(package, program.name), {"PYTHONPATH": path}) as running:
        running.wait_for_line("loading")
        assert running.end(number) == 130
        assert running.stderr == [f"{program.name}: interrupted."]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_an_interrupt_during_the_start_of_python_waits_for_the_program(path: str, number: signal.Signals) -> None:
    with interrupts_blocked():
        running = Program(installed("posor_estimator", "chain_node"), {"PYTHONPATH": path})
    with running:
        assert running.end(number) == 130
        assert running.stderr == ["chain_node: interrupted."]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_background_job_is_interrupted_but_does_not_hang_up(path: str, number: signal.Signals) -> None:
    with Program(in_background(installed("posor_estimator", "chain_node")), {"PYTHONPATH": path}) as running:
        running.wait_for_line("loading")
        running.process.send_signal(signal.SIGHUP)
        assert running.end(number) == 130
        assert running.stderr == ["chain_node: interrupted."]


def test_a_script_in_the_background_is_interruptible() -> None:
    code = "import signal; print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)"
    with Program(in_background([*script(ROOT / "tools" / "in_workspace.py"), "-c", code])) as running:
        running.wait_for_line("True")


@pytest.mark.parametrize("start", [list, in_background])
def test_an_interrupt_while_run_replaces_itself_waits_for_the_program(start: Callable[[list[str]], list[str]]) -> None:
    with Program(start([str(ROOT / "run"), "posor_estimator", "chain_node"])) as running:
        command = Path(f"/proc/{running.process.pid}/cmdline")
        while b"lib/posor_estimator/chain_node" not in command.read_bytes():
            assert running.process.poll() is None
        assert running.end() == 130
        assert running.stderr == ["chain_node: interrupted."]


def run_with_limit(limit: str, command: list[str]) -> list[str]:
    """Run a program that fails with exit code 1; return the lines of standard error."""
    with Program(["sh", "-c", f'ulimit {limit}; exec "$@"', "sh", *command]) as running:
        assert running.wait() == 1
        return running.stderr


@pytest.mark.parametrize(
    ("limit", "sentence"),
    [
        ("-n 16", "16 files open at a time (ulimit -n); expected at least 64"),
        ("-v 200000", "204800000 bytes of address space (ulimit -v counts kilobytes); expected at least 2147483648"),
    ],
)
def test_a_limit_that_is_too_low_is_one_sentence(limit: str, sentence: str) -> None:
    lines = run_with_limit(limit, installed("posor_estimator", "posor_node"))
    assert lines == [f"posor_node: the process is limited to {sentence}."]


GREEDY_PROGRAM = """\
import sys
from posor.lazy_program import LazyProgram

def main():
    files, buffers = [], []
    while sys.argv[1] == "files":
        files.append(open("/dev/null"))
    while True:
        buffers.append(bytearray(2**28))

sys.exit(LazyProgram("greedy", "__main__")())
"""


@pytest.mark.parametrize(
    ("what", "limit", "sentence"),
    [
        ("files", "-n 64", "/dev/null: too many open files; expected a higher limit (ulimit -n)"),
        ("buffers", "-v 2200000", "cannot allocate memory; expected more memory, or a higher limit (ulimit -v)"),
    ],
)
def test_a_shortage_of_a_running_program_is_one_sentence(tmp_path: Path, what: str, limit: str, sentence: str) -> None:
    (tmp_path / "greedy.py").write_text(GREEDY_PROGRAM, encoding="utf-8")
    lines = run_with_limit(limit, [*script(tmp_path / "greedy.py"), what])
    assert lines == [f"greedy: {sentence}."]


WRITING_PROGRAM = """\
import os
import sys
from posor.lazy_program import LazyProgram

def main():
    if sys.argv[1] == "other":
        reader, writer = os.pipe()
        os.close(reader)
        os.write(writer, b"0")
    for number in range(int(sys.argv[1])):
        print(number)
    return 0

sys.exit(LazyProgram("writing", "__main__")())
"""


@pytest.mark.parametrize(("lines", "error"), [("1", ""), ("100000", ""), ("other", "BrokenPipeError")])
def test_a_program_whose_output_nobody_reads_ends_without_a_traceback(tmp_path: Path, lines: str, error: str) -> None:
    (tmp_path / "writing.py").write_text(WRITING_PROGRAM, encoding="utf-8")
    reader, writer = os.pipe()
    command = [*script(tmp_path / "writing.py"), lines]
    with os.fdopen(reader) as end, os.fdopen(writer, "w") as output:
        if not error:
            end.close()
        done = subprocess.run(command, stdout=output, stderr=subprocess.PIPE, text=True, check=False, timeout=60)
    assert done.returncode == 1
    assert error in done.stderr if error else not done.stderr
