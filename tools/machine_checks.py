"""What the set-up needs of the machine, checked before anything is started: one sentence with the cure for each."""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import TYPE_CHECKING

from environment import SetupError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from environment import Workspace


def check_machine(workspace: Workspace, environ: Mapping[str, str], *, official: bool) -> None:
    """Check Python, compiler, CMake and make.

    Args:
        workspace: The checkout to be set up.
        environ: The caller's environment.
        official: Whether an installed Jazzy is sourced.

    Raises:
        SetupError: Something is missing; names it and the cure.

    """
    check_place(workspace)
    check_python()
    check_tool(environ, "C compiler", "CC", ("cc", "gcc", "clang"), "sudo apt install gcc")
    check_tool(environ, "C++ compiler", "CXX", ("c++", "g++", "clang++"), "sudo apt install g++")
    check_tool(environ, "cmake", "", ("cmake",), "sudo apt install cmake")
    check_tool(environ, "make", "", ("make", "gmake"), "sudo apt install make")
    if official:
        check_rclpy(environ)
    elif sys.platform != "linux" or platform.machine() != "x86_64":
        raise SetupError(
            f"the ROS 2 Jazzy wheels are for Linux on x86-64 and this is {sys.platform} on {platform.machine()}: "
            f"source an installed ROS 2 Jazzy and call again."
        )


def check_place(workspace: Workspace) -> None:
    """Refuse a path that the first line of a script cannot hold."""
    if any(c.isspace() for c in str(workspace.root)):
        raise SetupError(
            f"the folder '{workspace.root}' has a space in its path, which colcon's scripts cannot: move it elsewhere."
        )


def check_python() -> None:
    """Check that this interpreter can make virtual environments and build extensions."""
    minor = f"{sys.version_info.major}.{sys.version_info.minor}"
    for module in ("venv", "ensurepip"):
        if importlib.util.find_spec(module) is None:
            raise SetupError(
                f"{sys.executable} has no module '{module}': install it, e.g. sudo apt install python{minor}-venv."
            )
    header = Path(sysconfig.get_path("include"), "Python.h")
    if not header.is_file():
        raise SetupError(f"Python's C header {header} is missing: install it, e.g. sudo apt install python{minor}-dev.")


def check_tool(environ: Mapping[str, str], what: str, variable: str, names: tuple[str, ...], cure: str) -> None:
    """Check that a program is on the PATH, or where its variable says."""
    chosen = environ.get(variable, "").split()[:1] if variable else []
    wanted = chosen or list(names)
    if any(shutil.which(name, path=environ.get("PATH", os.defpath)) for name in wanted):
        return
    source = f"{variable}={chosen[0]}" if chosen else f"looked for {', '.join(wanted)} on the PATH"
    raise SetupError(f"no {what} was found ({source}): install it, e.g. {cure}.")


def check_rclpy(environ: Mapping[str, str]) -> None:
    """Check that this interpreter is the one the sourced Jazzy was built for."""
    probe = subprocess.run([sys.executable, "-c", "import rclpy"], env=dict(environ), capture_output=True, check=False)
    if probe.returncode:
        raise SetupError(
            f"a ROS 2 Jazzy is sourced but {sys.executable} cannot import its rclpy: name the Python it was built for, "
            f"e.g. make PYTHON=/usr/bin/python3, or call from a shell without ROS to get it as Python wheels."
        )
