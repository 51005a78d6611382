# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""``./run`` starts the right program in the environment of the workspace, and passes signals and the exit code."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

import pytest
from environment import workspace_environment

from tests.miniature import Miniature


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Miniature:
    """A small checkout, set up by its first ``./run``."""
    miniature = Miniature(tmp_path_factory.mktemp("checkout"))
    miniature.fill()
    first = miniature.run("miniature", "tell")
    assert first.returncode == 0, first.stderr
    assert first.stdout.startswith("arguments\n"), "the report of the set-up must not reach the output of the program"
    assert "set-up: colcon build of ros2_ws" in first.stderr
    return miniature


@pytest.mark.long
def test_arguments_entry_points_and_environment(checkout: Miniature) -> None:
    done = checkout.run("miniature", "tell", "--ros-args", "-p", "a:='b c'")
    assert (done.returncode, done.stderr) == (0, "")
    arguments, things, prefixes = done.stdout.splitlines()
    assert arguments == "arguments --ros-args -p a:='b c'"
    assert things == "things 42"
    assert prefixes.split()[1].split(":")[0] == str(checkout.install / "miniature")


@pytest.mark.parametrize("how", [pytest.param("through a link", marks=pytest.mark.long), "nested"])
def test_calls_from_elsewhere_are_the_same(checkout: Miniature, tmp_path: Path, how: str) -> None:
    command, environ = checkout.root / "run", checkout.environ()
    if how == "nested":
        environ = workspace_environment(checkout, environ)
    else:
        command = tmp_path / "posor-run"
        command.symlink_to(checkout.root / "run")
    call = [str(command), "miniature", "tell"]
    done = subprocess.run(call, cwd=tmp_path, env=environ, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert "things 42" in done.stdout


def test_signal_reaches_the_program(checkout: Miniature) -> None:
    command = [str(checkout.root / "run"), "miniature", "wait"]
    with subprocess.Popen(command, env=checkout.environ(), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert int(process.stdout.readline()) == process.pid
        process.send_signal(signal.SIGINT)
    assert process.returncode == 7


def test_programs_store_their_bytecode(checkout: Miniature) -> None:
    environ = checkout.environ() | {"PYTHONDONTWRITEBYTECODE": "1"}
    assert "PYTHONDONTWRITEBYTECODE" not in workspace_environment(checkout, environ)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nowhere", "tell"), "posor run: there is no package 'nowhere'; this workspace has: miniature.\n"),
        (("miniature", "sing"), "posor run: package 'miniature' has no executable 'sing'; it has: tell, wait.\n"),
        (("miniature",), "usage: ./run PACKAGE EXECUTABLE [arguments]\n"),
    ],
)
def test_wrong_call(checkout: Miniature, arguments: tuple[str, ...], message: str) -> None:
    done = checkout.run(*arguments)
    assert done.returncode == 2
    assert done.stderr == message
    assert done.stdout == ""


def test_an_installed_ros2_is_called(checkout: Miniature, tmp_path: Path) -> None:
    ros2 = tmp_path / "ros2"
    ros2.write_text('#!/bin/sh\necho "$@"\necho "$AMENT_PREFIX_PATH"\n')
    ros2.chmod(0o755)
    done = checkout.run("miniature", "tell", "--once", PATH=f"{tmp_path}:{os.environ['PATH']}")
    call, prefixes = done.stdout.splitlines()
    assert call == "run miniature tell --once"
    assert prefixes.split(":")[0] == str(checkout.install / "miniature")
