# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Folders of the workspace and environment variables of its programs.

The set-up, ``./run`` and the test runner use this module before any library is installed: standard library only.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

PATH_LISTS = (
    "AMENT_PREFIX_PATH",
    "CMAKE_PREFIX_PATH",
    "COLCON_PREFIX_PATH",
    "LD_LIBRARY_PATH",
    "PATH",
    "PKG_CONFIG_PATH",
    "PYTHONPATH",
)
SHELL_VARIABLES = ("_", "LC_CTYPE", "OLDPWD", "PWD", "SHLVL")
VENV_MARKER = "made-by-posor-setup"  # a file in every virtual environment that the set-up has made
MAKE_VARIABLES = ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")  # would reach the makes that colcon starts
OTHER_ROS_VARIABLES = (
    *("COLCON_PREFIX_PATH", "LD_LIBRARY_PATH", "PYTHONHOME", "PYTHONPATH"),
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
)
INTERRUPTIONS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
END_S = 20.0  # time that a command has to end after an interruption of its tool [s]

NO_BYTECODE = "PYTHONDONTWRITEBYTECODE"
"""The set-up leaves the bytecode of the libraries to their first import. A start without it takes twice as long, and so
do the many programs of the colcon build: the set-up and all programs of the workspace ignore this variable."""


class SetupError(Exception):
    """The workspace cannot be set up or used. The message is one sentence with the remedy."""


class Workspace:
    """Folders and stamp files of one checkout.

    A stamp is written when the virtual environment or the build is complete, and disappears with its folder.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.venv = root / ".venv"
        self.python = self.venv / "bin" / "python"
        self.ros2 = root / "ros2_ws"
        self.install = self.ros2 / "install"
        self.wheel_packages = root / "tools" / "wheel_packages"  # that an official Jazzy has and the wheels lack
        self.logs = root / "build" / "setup"
        self.environment_stamp = self.venv / "posor-setup.json"
        self.build_stamp = self.install / "posor-setup.json"


THIS = Workspace(Path(__file__).resolve().parent.parent)


def read_stamp(path: Path) -> dict[str, Any]:
    """Return the content of a stamp, empty if the stamp is missing or unreadable."""
    try:
        stamp = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return stamp if isinstance(stamp, dict) else {}


def write_stamp(path: Path, stamp: Mapping[str, Any]) -> None:
    """Write a stamp by one atomic rename."""
    unfinished = path.with_suffix(".new")
    unfinished.write_text(json.dumps(stamp, indent=1) + "\n", encoding="utf-8")
    unfinished.replace(path)


def is_official_ros_sourced(environ: Mapping[str, str]) -> bool:
    """Return whether an installed ROS 2 Jazzy is sourced, as opposed to our own wheels or no ROS at all.

    Raises:
        SetupError: Another distribution is sourced, or Jazzy is sourced incompletely.

    """
    distribution = environ.get("ROS_DISTRO", "")
    prefixes = split_paths(environ.get("AMENT_PREFIX_PATH", ""))
    if not distribution or any(Path(prefix, VENV_MARKER).is_file() for prefix in prefixes):
        return False
    if distribution != "jazzy":
        raise SetupError(
            f"ROS_DISTRO is '{distribution}' but this project is for 'jazzy': "
            f"source a Jazzy, or call from a shell without ROS to get it as Python wheels."
        )
    if not prefixes:
        raise SetupError(
            "ROS_DISTRO is 'jazzy' but AMENT_PREFIX_PATH is empty: source Jazzy's setup.bash, or unset ROS_DISTRO."
        )
    return True


def split_paths(value: str) -> list[str]:
    """Return the paths in a list such as PATH."""
    return [path for path in value.split(os.pathsep) if path]


def ros_environment(workspace: Workspace, environ: Mapping[str, str], *, official: bool) -> dict[str, str]:
    """Return the environment in which ROS itself is found, without the packages of this workspace."""
    result = {name: value for name, value in environ.items() if name not in MAKE_VARIABLES}
    result["PATH"] = os.pathsep.join([str(workspace.python.parent), environ.get("PATH", os.defpath)])
    if official:
        return result
    return {name: value for name, value in result.items() if name not in OTHER_ROS_VARIABLES} | {
        "AMENT_PREFIX_PATH": str(workspace.venv),
        "CMAKE_PREFIX_PATH": str(workspace.venv),
        "ROS_DISTRO": "jazzy",
        "ROS_VERSION": "2",
        "ROS_PYTHON_VERSION": "3",
    }


def added_variables(
    workspace: Workspace, before: Mapping[str, str], sourced: Mapping[str, str]
) -> dict[str, dict[str, Any]]:
    """Extract the variables that this workspace has added to an environment.

    Args:
        workspace: The checkout.
        before: Environment without ROS.
        sourced: The same environment after the workspace was sourced.

    Returns:
        ``prepend``: for each list of paths the paths inside the checkout, in order; ``set``: new plain variables.

    """
    prepend: dict[str, list[str]] = {}
    plain: dict[str, str] = {}
    for name, value in sourced.items():
        if name in PATH_LISTS:
            own = [path for path in split_paths(value) if Path(path).is_relative_to(workspace.root)]
            if own:
                prepend[name] = list(dict.fromkeys(own))
        elif name not in before and name not in SHELL_VARIABLES:
            plain[name] = value
    return {"prepend": prepend, "set": plain}


def workspace_environment(workspace: Workspace = THIS, environ: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the environment for programs of the workspace: the given environment plus the variables of the build.

    Raises:
        SetupError: The workspace is not built.

    """
    stamp = read_stamp(workspace.build_stamp)
    if not stamp:
        raise SetupError("the workspace is not built: call 'make setup'.")
    return with_variables(os.environ if environ is None else environ, stamp)


def with_variables(environ: Mapping[str, str], added: Mapping[str, Any]) -> dict[str, str]:
    """Return an environment plus the result of ``added_variables``; Python may store bytecode in it."""
    result = {name: value for name, value in environ.items() if name != NO_BYTECODE}
    for name, own in added["prepend"].items():
        others = [path for path in split_paths(environ.get(name, "")) if path not in own]
        result[name] = os.pathsep.join([*own, *others])
    result.update(added["set"])
    return result


def run_commands(*commands: Sequence[str | Path], **options: Any) -> int:
    """Run commands at the same time, with options of Popen; return the first exit code that is not 0, or 0.

    Each command has a session of its own. An interruption of the tool ends all processes of the sessions, by SIGTERM,
    after ``END_S`` by SIGKILL. An interruption during the start waits until all have started.
    """
    with contextlib.ExitStack() as stack:
        start = partial(subprocess.Popen, start_new_session=True, **options)
        delayed: list[int] = []
        handled = [number for number in INTERRUPTIONS if signal.getsignal(number) != signal.SIG_IGN]
        handlers = {number: signal.signal(number, lambda number, _: delayed.append(number)) for number in handled}
        processes = [stack.enter_context(start(command)) for command in commands]
        try:
            for number, handler in handlers.items():
                signal.signal(number, handler)
            for received in delayed:
                signal.raise_signal(received)
            return next(filter(None, [process.wait() for process in processes]), 0)
        except KeyboardInterrupt:
            for process in processes:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGTERM)
            for process in processes:
                try:
                    process.wait(END_S)
                except subprocess.TimeoutExpired:
                    os.killpg(process.pid, signal.SIGKILL)
            raise


def exit_with(name: str, main: Callable[[], int]) -> NoReturn:
    """Run the function of a tool and end the process with its exit code.

    A SetupError is one sentence, exit code 2. SIGINT, SIGTERM and, without ``nohup``, SIGHUP end the tool with one line
    and exit code 130, also in a background job of a shell, which starts with SIGINT ignored, as do the programs that it
    starts (``posor.lazy_program.handle_interrupts``, which tools cannot import before the set-up).

    Args:
        name: Name of the tool, for messages.
        main: Returns the exit code.

    """
    is_nohup = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    for number in INTERRUPTIONS[: 2 if is_nohup else 3]:
        signal.signal(number, signal.default_int_handler)
    try:
        code = main()
    except SetupError as error:
        sys.stderr.write(f"{name}: {error}\n")
        code = 2
    except KeyboardInterrupt:
        sys.stderr.write(f"{name}: interrupted.\n")
        code = 130
    sys.exit(code)
