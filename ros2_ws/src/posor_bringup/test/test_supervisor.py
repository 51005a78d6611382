# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Real processes: shell scripts installed as executables of a package."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from posor_bringup import supervisor as module
from posor_bringup.supervisor import ProcessError, ProgramCommand, RunningProgram, Supervisor
from posor_lab.harness.case_tables import refusal
from posor_lab.harness.program import in_background, wait_until

LOOP = "echo started; while :; do sleep 0.05; done"
SCRIPTS = {
    "ends_on_sigint": f'trap "exit 0" INT; {LOOP}',
    "fails_on_sigint": f'trap "echo good bye; exit 3" INT; {LOOP}',
    "interrupted_at_start": f'trap "echo interrupted. >&2; exit 130" INT; {LOOP}',
    "killed_by_sigint": LOOP,
    "ignores_sigint": f'trap "" INT; {LOOP}',
    "ends": "echo done",
    "fails": 'echo working; echo "[ERROR] [1795235842.1] [some.node]: the sky is green; expected blue." >&2; exit 4',
    "crashes": "kill -SEGV $$",
    "raises": 'printf "Traceback:\\nValueError: the sky is green\\nin node /arm/driver_node\\n"; exit 1',
    "ends_by_36": "kill -36 $$",
    "prints_arguments": 'printf "%s\\n" "$@"',
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    marker = tmp_path / "share" / "ament_index" / "resource_index" / "packages" / "scripts"
    marker.parent.mkdir(parents=True)
    marker.touch()
    executables = tmp_path / "lib" / "scripts"
    executables.mkdir(parents=True)
    for name, script in SCRIPTS.items():
        (executables / name).write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
        (executables / name).chmod(0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}{os.pathsep}{os.environ['AMENT_PREFIX_PATH']}")
    return tmp_path


@pytest.fixture
def supervisor(folder: Path) -> Iterator[Supervisor]:
    with Supervisor(folder) as running:
        yield running


def program(name: str, *, ends: bool = False) -> ProgramCommand:
    return ProgramCommand(name, "scripts", name, ends=ends)


def start(supervisor: Supervisor, name: str) -> RunningProgram:
    """Start a script and wait until it has set its trap."""
    running = supervisor.start(program(name))
    while "started" not in running.log.read_text(encoding="utf-8"):
        assert not running.has_ended
    return running


@pytest.mark.parametrize(
    ("name", "code"), [("ends_on_sigint", 0), ("interrupted_at_start", 130), ("killed_by_sigint", -2)]
)
def test_end_accepts_exit_codes_of_interrupted_programs(supervisor: Supervisor, name: str, code: int) -> None:
    running = start(supervisor, name)
    supervisor.check()
    supervisor.end([running])
    assert running.process.returncode == code


def test_leaving_the_block_ends_all(folder: Path) -> None:
    with Supervisor(folder) as supervisor:
        running = start(supervisor, "ends_on_sigint")
    assert running.process.returncode == 0


@pytest.mark.parametrize(
    ("started", "message"),
    [
        (program("ends", ends=True), ""),
        (program("ends"), "ends: ended with exit code 0: done."),
        (program("fails", ends=True), "fails: ended with exit code 4: the sky is green; expected blue."),
        (program("raises"), "raises: ended with exit code 1: in node /arm/driver_node: ValueError: the sky is green."),
        (program("crashes"), "crashes: was ended by SIGSEGV; log: it wrote nothing."),
        (program("ends_by_36"), "ends_by_36: was ended by signal 36; log: it wrote nothing."),
    ],
)
def test_check_reports_a_program_that_failed_or_ended_early(
    supervisor: Supervisor, started: ProgramCommand, message: str
) -> None:
    supervisor.start(started).process.wait()
    if message:
        assert str(refusal(ProcessError, supervisor.check)) == message
    else:
        supervisor.check()
    supervisor._running.clear()


FAIL_ON_A_FULL_DISK = """\
import sys
from pathlib import Path
from posor_bringup.supervisor import ProcessError, ProgramCommand, Supervisor
with Supervisor(Path(sys.argv[1])) as supervisor:
    supervisor.start(ProgramCommand("record", "", sys.argv[2])).process.wait()
    try:
        supervisor.end(supervisor._running)
    except ProcessError as error:
        print(error)
"""
IN_A_NAMESPACE = ("/usr/bin/unshare", "-rm", "/bin/sh", "-c")
"""Runs a shell command that may mount file systems, which no other process sees."""


def test_a_full_disk_of_the_log_is_named(tmp_path: Path) -> None:
    disk, script, failing = tmp_path / "disk", tmp_path / "script.py", tmp_path / "failing.py"
    disk.mkdir()
    script.write_text(FAIL_ON_A_FULL_DISK, encoding="utf-8")
    failing.write_text("raise SystemExit('no space for the recording')", encoding="utf-8")
    mount = f"mount -t tmpfs -o size=16k none {disk}"
    if subprocess.run([*IN_A_NAMESPACE, mount], check=False).returncode:
        pytest.skip("this host lets no test mount a file system")
    fill = f"head -c 16k /dev/zero > {disk}/zeros"
    command = f"{mount} && {fill} && exec {sys.executable} {script} {disk} {failing}"
    output = subprocess.run([*IN_A_NAMESPACE, command], check=True, capture_output=True, text=True).stdout
    assert output == f"record: ended with exit code 1: it wrote nothing, the disk of {disk} is full.\n"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("fails_on_sigint", "fails_on_sigint: ended with exit code 3: good bye."),
        ("ignores_sigint", "ignores_sigint: did not end within 0.5 s of SIGINT and was killed."),
    ],
)
def test_end_reports_a_program_that_does_not_end_well(
    supervisor: Supervisor, name: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "END_TIMEOUT_S", 0.5)
    running = start(supervisor, name)
    assert str(refusal(ProcessError, supervisor.end, [running])) == message
    assert running.has_ended


SUPERVISE = """\
import sys
from pathlib import Path
from posor.lazy_program import LazyProgram
from posor_bringup.supervisor import ProgramCommand, Supervisor

def main():
    with Supervisor(Path(sys.argv[1])) as supervisor:
        child = supervisor.start(ProgramCommand("child", "", sys.argv[2]))
        while "started" not in child.log.read_text():
            assert not child.has_ended
    print(child.process.returncode)
    return 0

sys.exit(LazyProgram("supervise", "__main__")())
"""


def test_programs_of_a_supervisor_in_the_background_end_on_sigint(tmp_path: Path) -> None:
    (tmp_path / "supervise.py").write_text(SUPERVISE, encoding="utf-8")
    (tmp_path / "child.py").write_text("import signal\nprint('started', flush=True)\nsignal.pause()\n")
    command = [sys.executable, str(tmp_path / "supervise.py"), str(tmp_path), str(tmp_path / "child.py")]
    done = subprocess.run(in_background(command), check=True, capture_output=True, text=True)
    assert done.stdout == "-2\n"


def test_programs_end_orderly_when_their_supervisor_is_killed(tmp_path: Path) -> None:
    (tmp_path / "supervise.py").write_text(SUPERVISE, encoding="utf-8")
    (tmp_path / "child.py").write_text(
        "import os, signal, sys\n"
        "signal.signal(signal.SIGINT, lambda *_: sys.exit(print('closed', flush=True)))\n"
        "os.kill(os.getppid(), signal.SIGKILL)\nsignal.pause()\n"
    )
    command = [sys.executable, str(tmp_path / "supervise.py"), str(tmp_path), str(tmp_path / "child.py")]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    wait_until(lambda: "closed" in (tmp_path / "child.log").read_text(encoding="utf-8"), "the end", lambda: None)


def test_end_of_the_programs_does_not_replace_the_first_error(folder: Path) -> None:
    started = []

    def fail_with_a_program_running() -> None:
        with Supervisor(folder) as supervisor:
            started.append(start(supervisor, "fails_on_sigint"))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_with_a_program_running()
    assert started[0].has_ended


def test_killed_program_is_not_reported(supervisor: Supervisor) -> None:
    running = start(supervisor, "ends_on_sigint")
    supervisor.kill(running)
    assert running.has_ended
    supervisor.check()


def test_parameters_reach_ros_unchanged(supervisor: Supervisor) -> None:
    parameters: dict[str, module.Parameter] = {
        "path": "/a b/c: 'd'.yaml",
        "rate": 2.0,
        "depth": 0,
        "flag": True,
        "topics": ["/a", "/b"],
        "no": "no",
    }
    name = "prints_arguments"
    running = supervisor.start(
        ProgramCommand(name, "scripts", name, ("--own", "option"), "/joint1", parameters, ends=True)
    )
    running.process.wait()
    assert running.log.read_text(encoding="utf-8").splitlines() == [
        *("--own", "option", "--ros-args", "-r", "__ns:=/joint1"),
        *("-p", "path:=\"/a b/c: 'd'.yaml\"", "-p", "rate:=2.0", "-p", "depth:=0", "-p", "flag:=true"),
        *("-p", 'topics:=["/a", "/b"]', "-p", 'no:="no"'),
    ]


@pytest.mark.parametrize(
    ("package", "message"),
    [
        ("nowhere", "ghost: package 'nowhere' is not installed; expected a built and sourced"),
        ("scripts", "ghost: package 'scripts' has no executable 'ghost'; expected it at"),
        ("", "ghost: there is no file ghost; expected a Python program"),
    ],
)
def test_program_that_is_not_installed(supervisor: Supervisor, package: str, message: str) -> None:
    assert message in str(refusal(ProcessError, supervisor.start, ProgramCommand("ghost", package, "ghost")))
