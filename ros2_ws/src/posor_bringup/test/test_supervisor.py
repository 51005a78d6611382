"""Real processes, installed in a small package of their own."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest
from posor_bringup import supervisor
from posor_bringup.supervisor import ProcessError, Program, Supervisor

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

SCRIPTS = {
    "obedient": 'trap "exit 0" INT; echo started; while :; do sleep 0.05; done',
    "sulking": 'trap "echo good bye; exit 3" INT; echo started; while :; do sleep 0.05; done',
    "young": 'trap "echo young: interrupted. >&2; exit 130" INT; echo started; while :; do sleep 0.05; done',
    "unborn": "echo started; while :; do sleep 0.05; done",
    "stubborn": 'trap "" INT; echo started; while :; do sleep 0.05; done',
    "brief": "echo done",
    "failing": 'echo working; echo "[ERROR] [1795235842.1] [some.node]: the sky is green; expected blue." >&2; exit 4',
    "crashing": "kill -SEGV $$",
    "echoing": 'printf "%s\\n" "$@"',
}


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Install the scripts as executables of a package."""
    marker = tmp_path / "share" / "ament_index" / "resource_index" / "packages" / "scripts"
    marker.parent.mkdir(parents=True)
    marker.touch()
    folder = tmp_path / "lib" / "scripts"
    folder.mkdir(parents=True)
    for name, script in SCRIPTS.items():
        (folder / name).write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
        (folder / name).chmod(0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}{os.pathsep}{os.environ['AMENT_PREFIX_PATH']}")
    return tmp_path


@pytest.fixture
def watched(programs: Path) -> Iterator[Supervisor]:
    with Supervisor(programs) as running:
        yield running


def program(name: str, *, ends: bool = False) -> Program:
    return Program(name, "scripts", name, ends=ends)


def wait_for_line(running: supervisor.RunningProgram, line: str) -> None:
    while line not in running.log.read_text(encoding="utf-8"):
        assert not running.has_ended


def test_a_program_is_ended_by_sigint(watched: Supervisor) -> None:
    running = watched.start(program("obedient"))
    wait_for_line(running, "started")
    watched.check()
    watched.end([running])
    assert running.process.returncode == 0


@pytest.mark.parametrize(("name", "code"), [("young", 130), ("unborn", -2)])
def test_a_program_that_breaks_off_while_it_starts_has_ended_as_asked(
    watched: Supervisor, name: str, code: int
) -> None:
    running = watched.start(program(name))
    wait_for_line(running, "started")
    watched.end([running])
    assert running.process.returncode == code


def test_leaving_ends_all(programs: Path) -> None:
    with Supervisor(programs) as watched:
        running = watched.start(program("obedient"))
        wait_for_line(running, "started")
    assert running.process.returncode == 0


def test_a_program_that_ends_when_its_work_is_done_is_no_failure(watched: Supervisor) -> None:
    running = watched.start(program("brief", ends=True))
    running.process.wait()
    watched.check()


def test_a_program_that_should_run_on_is_missed(watched: Supervisor) -> None:
    watched.start(program("brief")).process.wait()
    with pytest.raises(ProcessError, match=r"^brief: ended with exit code 0: done\.$"):
        watched.check()
    watched._running.clear()


def test_a_failed_program_is_reported_with_its_own_sentence(watched: Supervisor) -> None:
    watched.start(program("failing", ends=True)).process.wait()
    with pytest.raises(ProcessError) as caught:
        watched.check()
    assert str(caught.value) == "failing: ended with exit code 4: the sky is green; expected blue."
    watched._running.clear()


def test_a_crash_is_named_by_its_signal(watched: Supervisor) -> None:
    watched.start(program("crashing")).process.wait()
    with pytest.raises(ProcessError, match="crashing: was ended by SIGSEGV; until then: it wrote nothing"):
        watched.check()
    watched._running.clear()


def test_a_program_that_ends_badly_when_asked_is_reported(watched: Supervisor) -> None:
    running = watched.start(program("sulking"))
    wait_for_line(running, "started")
    with pytest.raises(ProcessError, match="sulking: ended with exit code 3: good bye"):
        watched.end([running])


def test_a_program_that_does_not_end_is_killed_and_reported(
    watched: Supervisor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supervisor, "END_TIMEOUT_S", 0.2)
    running = watched.start(program("stubborn"))
    wait_for_line(running, "started")
    with pytest.raises(ProcessError, match=r"stubborn: did not end within 0\.2 s of SIGINT and was killed"):
        watched.end([running])
    assert running.has_ended


def test_the_first_error_is_not_hidden_by_the_end(programs: Path) -> None:
    started = []

    def fail_with_a_program_running() -> None:
        with Supervisor(programs) as watched:
            started.append(watched.start(program("sulking")))
            wait_for_line(started[0], "started")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_with_a_program_running()
    assert started[0].has_ended


def test_killing_is_not_mistaken_for_a_failure(watched: Supervisor) -> None:
    running = watched.start(program("obedient"))
    watched.kill(running)
    assert running.has_ended
    watched.check()


def test_parameters_reach_ros_as_they_are(watched: Supervisor) -> None:
    parameters: dict[str, supervisor.Parameter] = {
        "path": "/a b/c: 'd'.yaml",
        "rate": 2.0,
        "depth": 0,
        "flag": True,
        "topics": ["/a", "/b"],
        "no": "no",
    }
    running = watched.start(
        Program("echoing", "scripts", "echoing", ("--own", "option"), "/joint1", parameters, ends=True)
    )
    running.process.wait()
    assert running.log.read_text(encoding="utf-8").splitlines() == [
        *("--own", "option", "--ros-args", "-r", "__ns:=/joint1"),
        *("-p", "path:=\"/a b/c: 'd'.yaml\"", "-p", "rate:=2.0", "-p", "depth:=0", "-p", "flag:=true"),
        *("-p", 'topics:=["/a", "/b"]', "-p", 'no:="no"'),
    ]


def test_what_is_not_installed_is_named(watched: Supervisor) -> None:
    with pytest.raises(ProcessError, match="ghost: package 'nowhere' is not installed; expected a built and sourced"):
        watched.start(Program("ghost", "nowhere", "ghost"))
    with pytest.raises(ProcessError, match="ghost: package 'scripts' has no executable 'ghost'; expected it at"):
        watched.start(Program("ghost", "scripts", "ghost"))
