# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Run an installed executable in the environment of the workspace, as ``ros2 run`` does.

The executable replaces this process, so that signals reach it.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from environment import (
    THIS,
    SetupError,
    exit_with,
    is_official_ros_sourced,
    run_commands,
    split_paths,
    workspace_environment,
)
from setup_state import reasons_to_set_up

if TYPE_CHECKING:
    from collections.abc import Mapping

USAGE = "usage: ./run PACKAGE EXECUTABLE [arguments]"
LAZY_PACKAGES = (
    *("posor", "posor_bringup", "posor_calibration", "posor_design", "posor_drivers", "posor_estimator", "posor_lab"),
)
"""Packages whose programs may start with SIGINT and SIGTERM blocked: they allow both when they have their handlers
(``posor.lazy_program``). A signal before that would end Python itself with a traceback."""


def find_executable(package: str, name: str, environ: Mapping[str, str]) -> Path:
    """Return the installed executable of a ROS package.

    Args:
        package: ROS package name.
        name: Executable in the ``lib`` folder of the package.
        environ: Environment of the sourced workspace.

    Raises:
        SetupError: The package or the executable does not exist; the message lists the existing ones.

    """
    prefixes = [Path(path) for path in split_paths(environ.get("AMENT_PREFIX_PATH", ""))]
    index = Path("share", "ament_index", "resource_index", "packages")
    prefix = next((prefix for prefix in prefixes if (prefix / index / package).is_file()), None)
    if prefix is None:
        ours = sorted(prefix.name for prefix in prefixes if list_executables(prefix / "lib" / prefix.name))
        raise SetupError(f"there is no package '{package}'; this workspace has: {', '.join(ours) or 'none'}.")
    names = list_executables(prefix / "lib" / package)
    if name not in names:
        raise SetupError(f"package '{package}' has no executable '{name}'; it has: {', '.join(names) or 'none'}.")
    return prefix / "lib" / package / name


def list_executables(folder: Path) -> list[str]:
    """Return the names of the executable files in a folder."""
    if not folder.is_dir():
        return []
    return sorted(entry.name for entry in folder.iterdir() if entry.is_file() and os.access(entry, os.X_OK))


def main() -> int:
    """Set the workspace up if necessary and replace this process by the executable; return only after an error."""
    try:
        package, name, *arguments = sys.argv[1:]
    except ValueError:
        sys.stderr.write(f"{USAGE}\n")
        return 2
    try:
        if any(reasons_to_set_up(THIS, os.environ, official=is_official_ros_sourced(os.environ))):
            tools = Path(__file__).parent
            command = [tools / "python.sh", tools / "setup_workspace.py"]
            code = run_commands(command, stdout=sys.stderr)
            if code:
                return code
        environ = workspace_environment()
        executable = find_executable(package, name, environ)
    except OSError as error:
        sys.stderr.write(f"posor run: {error.filename}: {error.strerror}.\n")
        return 2
    ros2 = shutil.which("ros2")
    program = [ros2, "run", package, name] if ros2 else [str(executable)]
    if package in LAZY_PACKAGES and not ros2:
        signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    return os.execve(program[0], [*program, *arguments], environ)  # noqa: S606  no shell needed


if __name__ == "__main__":
    exit_with("posor run", main)
