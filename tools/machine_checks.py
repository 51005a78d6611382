# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Check the machine before the set-up starts anything. Each error is one sentence with the remedy."""

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

TOOLS = (  # what, environment variable that names it, usual names, remedy
    ("C compiler", "CC", ("cc", "gcc", "clang"), "sudo apt install gcc"),
    ("C++ compiler", "CXX", ("c++", "g++", "clang++"), "sudo apt install g++"),
    ("cmake", None, ("cmake",), "sudo apt install cmake"),
    ("make", None, ("make", "gmake"), "sudo apt install make"),
)


def check_machine(workspace: Workspace, environ: Mapping[str, str], *, official: bool) -> None:
    """Check the folder, Python, compilers, CMake, make and ROS.

    Args:
        workspace: The checkout.
        environ: Environment of the caller.
        official: Whether an installed Jazzy is sourced.

    Raises:
        SetupError: A requirement is not met.

    """
    if any(character.isspace() for character in str(workspace.root)):
        raise SetupError(
            f"the folder '{workspace.root}' has a space in its path, which colcon's scripts do not support: move it."
        )
    check_python()
    for tool in TOOLS:
        check_tool(environ, *tool)
    if official:
        check_rclpy(environ)
    elif sys.platform != "linux" or platform.machine() != "x86_64":
        raise SetupError(
            f"the ROS 2 Jazzy wheels are for Linux on x86-64 and this is {sys.platform} on {platform.machine()}: "
            f"source an installed ROS 2 Jazzy and call again."
        )


def check_python() -> None:
    """Check that this interpreter can make virtual environments and build extensions."""
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    for module in ("venv", "ensurepip"):
        if importlib.util.find_spec(module) is None:
            raise SetupError(
                f"{sys.executable} has no module '{module}': install it, e.g. sudo apt install python{version}-venv."
            )
    header = Path(sysconfig.get_path("include"), "Python.h")
    if not header.is_file():
        raise SetupError(
            f"Python's C header {header} is missing: install it, e.g. sudo apt install python{version}-dev."
        )


def check_tool(
    environ: Mapping[str, str], what: str, variable: str | None, usual_names: tuple[str, ...], remedy: str
) -> None:
    """Check that a program is on the PATH, under the name in its variable or under a usual name."""
    named = environ.get(variable, "").split()[:1] if variable else []
    names = named or list(usual_names)
    if any(shutil.which(name, path=environ.get("PATH", os.defpath)) for name in names):
        return
    source = f"{variable}={named[0]}" if named else f"looked for {', '.join(names)} on the PATH"
    raise SetupError(f"no {what} was found ({source}): install it, e.g. {remedy}.")


def check_rclpy(environ: Mapping[str, str]) -> None:
    """Check that the sourced Jazzy was built for this interpreter."""
    probe = subprocess.run([sys.executable, "-c", "import rclpy"], env=dict(environ), capture_output=True, check=False)
    if probe.returncode:
        raise SetupError(
            f"a ROS 2 Jazzy is sourced but {sys.executable} cannot import its rclpy: name the Python it was built for, "
            f"e.g. make PYTHON=/usr/bin/python3, or call from a shell without ROS to get it as Python wheels."
        )
