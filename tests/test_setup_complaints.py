# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of the set-up: one sentence with the remedy, and no unfinished part that counts as complete."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from setup_state import reasons_to_set_up

from tests.miniature import BASE_PYTHON, Miniature

SETUP_PROGRAMS = ("cc", "c++", "cmake", "dirname", "make", "readlink", "sh")


@pytest.fixture
def checkout(tmp_path: Path) -> Miniature:
    miniature = Miniature(tmp_path / "checkout")
    miniature.fill()
    return miniature


def path_without(folder: Path, *missing: str) -> str:
    """Return a PATH with only the programs that the set-up uses, except the missing ones."""
    folder.mkdir()
    for name in SETUP_PROGRAMS:
        program = shutil.which(name)
        if program and name not in missing:
            (folder / name).symlink_to(program)
    return str(folder)


def error_message(done: subprocess.CompletedProcess[str]) -> str:
    """Return the error message after checking that it is the only output and one line."""
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.startswith("posor set-up: ")
    assert done.stderr.endswith(".\n")
    assert done.stderr.count("\n") == 1
    return done.stderr


@pytest.mark.parametrize(
    ("missing", "package", "what"),
    [
        ("cc", "gcc", "C compiler"),
        ("c++", "g++", "C++ compiler"),
        ("cmake", "cmake", "cmake"),
        ("make", "make", "make"),
    ],
)
def test_missing_tool(checkout: Miniature, tmp_path: Path, missing: str, package: str, what: str) -> None:
    message = error_message(checkout.set_up(PATH=path_without(tmp_path / "bin", missing), CC="", CXX=""))
    assert f"no {what} was found" in message
    assert f"sudo apt install {package}" in message
    assert not checkout.venv.exists()


@pytest.mark.parametrize(
    ("variables", "words"),
    [
        ({"CXX": "nowhere-g++ -O2"}, "no C++ compiler was found (CXX=nowhere-g++)"),
        (
            {"ROS_DISTRO": "humble", "AMENT_PREFIX_PATH": "/opt/ros/humble"},
            "ROS_DISTRO is 'humble' but this project is for 'jazzy'",
        ),
        ({"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": ""}, "AMENT_PREFIX_PATH is empty: source Jazzy's setup.bash"),
        ({"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": "/usr", "PYTHONPATH": ""}, "cannot import its rclpy"),
    ],
    ids=["chosen compiler", "another ROS", "half-sourced Jazzy", "Jazzy of another Python"],
)
def test_wrong_environment(checkout: Miniature, variables: dict[str, str], words: str) -> None:
    assert words in error_message(checkout.set_up(**variables))
    assert not checkout.venv.exists()


@pytest.fixture
def unsupported_python() -> Path:
    """An unsupported Python 3 of this machine."""
    beside = Path(sys.base_prefix).parent.glob("*/bin/python3")
    on_path = (shutil.which(f"python3.{minor}") for minor in (8, 9, 10, 13, 14))
    ask = "import sys; print(sys.version_info[:2] in [(3, 11), (3, 12)])"
    for candidate in [*sorted(beside), *(Path(found) for found in on_path if found)]:
        if subprocess.run([candidate, "-c", ask], capture_output=True, check=False).stdout == b"False\n":
            return candidate
    pytest.skip("this machine has no other Python 3 than 3.11 and 3.12")


def test_unsupported_python(checkout: Miniature, unsupported_python: Path) -> None:
    message = error_message(checkout.set_up(PYTHON=str(unsupported_python)))
    for words in ("needs Python 3.11 or 3.12", f"found {unsupported_python} is 3.", "make PYTHON=/path/to/python3.12"):
        assert words in message


def test_no_python(checkout: Miniature, tmp_path: Path) -> None:
    message = error_message(checkout.set_up(PATH=path_without(tmp_path / "bin"), PYTHON=""))
    assert "found none (looked for python3, python3.12, python3.11)" in message


def test_supported_python_is_found_behind_an_unsupported_one(
    checkout: Miniature, tmp_path: Path, unsupported_python: Path
) -> None:
    path = path_without(tmp_path / "bin", "cmake")
    Path(path, "python3").symlink_to(unsupported_python)
    Path(path, BASE_PYTHON.name).symlink_to(BASE_PYTHON)
    assert "no cmake was found" in error_message(checkout.set_up(PATH=path, PYTHON=""))


@pytest.mark.long
def test_no_network(checkout: Miniature) -> None:
    with socket.socket() as closed:  # bound but not listening: refuses connections
        closed.bind(("127.0.0.1", 0))
        index = f"http://127.0.0.1:{closed.getsockname()[1]}/simple"
        done = checkout.set_up(
            PIP_CONFIG_FILE="/dev/null", PIP_NO_INDEX="0", PIP_FIND_LINKS="", PIP_RETRIES="1", PIP_INDEX_URL=index
        )
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last.startswith("posor set-up: the Python package index cannot be reached: check the network")
    assert "build/setup/pip.log" in last
    assert "Traceback" not in done.stderr
    assert reasons_to_set_up(checkout, {}, official=False) == ("unfinished or damaged", "new environment")


@pytest.mark.long
def test_index_without_a_pinned_library(checkout: Miniature) -> None:
    checkout.write("requirements/dev.in", "no-such-library\n")
    checkout.write("requirements/dev.txt", "no-such-library==1.0\n")
    done = checkout.set_up()
    last = done.stderr.splitlines()[-1]
    assert last.startswith("posor set-up: pip's package index has no no-such-library==1.0 for this Python")


@pytest.mark.long
def test_failed_build_prints_the_end_of_its_log(checkout: Miniature) -> None:
    (checkout.ros2 / "src" / "miniature" / "config" / "numbers.txt").unlink()
    done = checkout.set_up()
    assert done.returncode == 1
    assert "numbers.txt" in done.stderr
    assert done.stderr.splitlines()[-1].startswith("posor set-up: colcon could not build ros2_ws (exit code ")
    assert not checkout.build_stamp.exists()


def test_foreign_environment_is_kept(checkout: Miniature) -> None:
    foreign = checkout.write(".venv/foreign.txt", "kept\n")
    done = checkout.set_up()
    assert done.returncode == 1
    assert "was not made by this set-up: move it away" in done.stderr
    assert foreign.read_text() == "kept\n"


def test_path_with_a_space(tmp_path: Path) -> None:
    checkout = Miniature(tmp_path / "my checkout")
    checkout.fill()
    assert "has a space in its path" in error_message(checkout.set_up())


def test_incomplete_checkout(checkout: Miniature) -> None:
    (checkout.root / "requirements" / "base.txt").unlink()
    assert "requirements/base.txt: No such file or directory" in error_message(checkout.set_up())
