# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Run tests with Python 3.12 and the libraries of Ubuntu 24.04: ``make test-noble [TESTS='path ...']``.

``build/noble/checkout`` is a checkout of the tracked files as they are here, with a virtual environment and a build of
its own. Its lock files have the versions of ``requirements/noble.txt``. Wheels stand for the packages of ROS and for
pinocchio. Without paths, the tests of all packages in ``ros2_ws/src`` run. Standard library only.
"""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

from environment import THIS, SetupError, Workspace, exit_with, run_commands
from setup_state import WHEEL_LOCKS

if TYPE_CHECKING:
    from pathlib import Path

NOBLE_PYTHON = (3, 12)
SYSTEM = "noble"
CHECKOUT = THIS.root / "build" / SYSTEM / "checkout"
PRODUCT = "ros2_ws/src"


def git(*arguments: str, folder: Path = THIS.root) -> str:
    """Run git in a folder and return its output."""
    done = subprocess.run(["git", *arguments], cwd=folder, stdout=subprocess.PIPE, text=True, check=True)  # noqa: S607
    return done.stdout.strip()


def check_out() -> None:
    """Bring the tracked files, with changes that are not committed, into the checkout; results of its build stay."""
    CHECKOUT.mkdir(parents=True, exist_ok=True)
    git("init", "--quiet", folder=CHECKOUT)
    state = git("stash", "create") or git("rev-parse", "HEAD")
    git("fetch", "--quiet", "--depth=1", str(THIS.root), state, folder=CHECKOUT)
    git("checkout", "--quiet", "--force", "--detach", "FETCH_HEAD", folder=CHECKOUT)
    git("clean", "--quiet", "--force", "-d", folder=CHECKOUT)


def read_pins(path: Path) -> dict[str, str]:
    """Return the lines of a lock file that pin a library, by its name."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return {line.partition("==")[0].lower(): line for line in lines if "==" in line}


def replace_pins(folder: Path) -> None:
    """Replace the pins of all lock files of a folder by those of Ubuntu 24.04."""
    own = read_pins(folder / f"{SYSTEM}.txt")
    for name in WHEEL_LOCKS:
        pins = read_pins(folder / name)
        pins |= {library: own[library] for library in pins.keys() & own.keys()}
        (folder / name).write_text("".join(f"{pin}\n" for pin in pins.values()), encoding="utf-8")


def main() -> int:
    """Set the checkout up, run its tests, and return the exit code."""
    if sys.version_info[:2] != NOBLE_PYTHON:
        raise SetupError("needs Python 3.12, the one of Ubuntu 24.04: make test-noble PYTHON=/path/to/python3.12.")
    check_out()
    replace_pins(CHECKOUT / "requirements")
    python = Workspace(CHECKOUT).python
    options = {"cwd": CHECKOUT, "env": os.environ | {"PYTHON": sys.executable}}
    set_up = [sys.executable, "tools/setup_workspace.py", "--without-build"]
    run_tests = [str(python), "-E", "tools/run_tests.py", *(sys.argv[1:] or [PRODUCT])]
    return run_commands(set_up, **options) or run_commands(run_tests, **options)


if __name__ == "__main__":
    exit_with("make test-noble", main)
