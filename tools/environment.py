"""Where the workspace's parts are, and the environment variables its programs need.

The set-up builds, ``./run`` and the tests start programs; all of them take paths and variables from here. Standard
library only: this runs before anything is installed.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

PATH_LISTS = (
    "AMENT_PREFIX_PATH",
    "CMAKE_PREFIX_PATH",
    "COLCON_PREFIX_PATH",
    "LD_LIBRARY_PATH",
    "PATH",
    "PKG_CONFIG_PATH",
    "PYTHONPATH",
)
SHELL_OWN = ("_", "LC_CTYPE", "OLDPWD", "PWD", "SHLVL")
MARKER = "made-by-posor-setup"  # a file in every virtual environment of ours
NOT_INHERITED = ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")  # make's own, which would reach the makes that colcon starts
FOREIGN = ("COLCON_PREFIX_PATH", "LD_LIBRARY_PATH", "PYTHONHOME", "PYTHONPATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")


class SetupError(Exception):
    """The workspace cannot be made ready or used; the text is one sentence with the cure."""


@dataclass(frozen=True)
class Workspace:
    """The folders of one checkout."""

    root: Path

    @property
    def venv(self) -> Path:
        """Virtual environment."""
        return self.root / ".venv"

    @property
    def python(self) -> Path:
        """Interpreter that runs every program of the workspace."""
        return self.venv / "bin" / "python"

    @property
    def ros2(self) -> Path:
        """The colcon workspace."""
        return self.root / "ros2_ws"

    @property
    def install(self) -> Path:
        """Where colcon installs."""
        return self.ros2 / "install"

    @property
    def logs(self) -> Path:
        """Log files of the set-up."""
        return self.root / "build" / "setup"

    @property
    def environment_stamp(self) -> Path:
        """Written when the virtual environment is complete; gone with it."""
        return self.venv / "posor-setup.json"

    @property
    def build_stamp(self) -> Path:
        """Written when the build is complete; gone with it."""
        return self.install / "posor-setup.json"


THIS = Workspace(Path(__file__).resolve().parent.parent)


def read_stamp(path: Path) -> dict[str, Any]:
    """Return what a finished step has recorded, or nothing if it is unfinished or unreadable."""
    try:
        stamp = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return stamp if isinstance(stamp, dict) else {}


def write_stamp(path: Path, stamp: Mapping[str, Any]) -> None:
    """Record a finished step, in one indivisible move."""
    fresh = path.with_suffix(".new")
    fresh.write_text(json.dumps(stamp, indent=1) + "\n", encoding="utf-8")
    fresh.replace(path)


def official_ros(environ: Mapping[str, str]) -> bool:
    """Tell whether an installed ROS 2 Jazzy is sourced (as opposed to wheels in an environment of ours, or nothing).

    Raises:
        SetupError: Another distribution is sourced, or Jazzy only half.

    """
    distribution = environ.get("ROS_DISTRO", "")
    prefixes = [p for p in environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    if not distribution or any(Path(prefix, MARKER).is_file() for prefix in prefixes):
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


def ros_environment(workspace: Workspace, environ: Mapping[str, str], *, official: bool) -> dict[str, str]:
    """Return the variables under which ROS itself is found, before any of our packages is built."""
    base = {name: value for name, value in environ.items() if name not in NOT_INHERITED}
    base["PATH"] = os.pathsep.join([str(workspace.python.parent), environ.get("PATH", os.defpath)])
    if official:
        return base
    return {name: value for name, value in base.items() if name not in FOREIGN} | {
        "AMENT_PREFIX_PATH": str(workspace.venv),
        "CMAKE_PREFIX_PATH": str(workspace.venv),
        "ROS_DISTRO": "jazzy",
        "ROS_VERSION": "2",
        "ROS_PYTHON_VERSION": "3",
    }


def workspace_variables(
    workspace: Workspace, before: Mapping[str, str], sourced: Mapping[str, str]
) -> dict[str, dict[str, Any]]:
    """Extract from a sourced environment what belongs to this workspace.

    Args:
        workspace: The checkout.
        before: Environment before any ROS was there.
        sourced: The same after the workspace was sourced.

    Returns:
        ``prepend``: for each list of paths those that lie inside the checkout, in order; ``set``: new plain variables.

    """
    prepend: dict[str, list[str]] = {}
    plain: dict[str, str] = {}
    for name, value in sourced.items():
        if name in PATH_LISTS:
            own = [p for p in value.split(os.pathsep) if Path(p).is_relative_to(workspace.root)]
            if own:
                prepend[name] = list(dict.fromkeys(own))
        elif name not in before and name not in SHELL_OWN:
            plain[name] = value
    return {"prepend": prepend, "set": plain}


def workspace_environment(workspace: Workspace = THIS, environ: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the environment in which the workspace's programs run: the given one plus what the build recorded.

    Raises:
        SetupError: The workspace is not built.

    """
    environ = os.environ if environ is None else environ
    stamp = read_stamp(workspace.build_stamp)
    if not stamp:
        raise SetupError("the workspace is not built: call 'make setup'.")
    return with_variables(environ, stamp)


def with_variables(environ: Mapping[str, str], recorded: Mapping[str, Any]) -> dict[str, str]:
    """Return an environment plus the variables that ``workspace_variables`` found."""
    result = dict(environ)
    for name, own in recorded["prepend"].items():
        others = [p for p in environ.get(name, "").split(os.pathsep) if p and p not in own]
        result[name] = os.pathsep.join([*own, *others])
    result.update(recorded["set"])
    return result


def find_executable(package: str, name: str, environ: Mapping[str, str]) -> Path:
    """Return the installed executable of a ROS package, as ``ros2 run`` would find it.

    Args:
        package: ROS package name.
        name: Executable in the package's ``lib`` folder.
        environ: Environment of the sourced workspace.

    Raises:
        SetupError: No such package or executable; the sentence lists those there are.

    """
    prefixes = [Path(p) for p in environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    index = Path("share", "ament_index", "resource_index", "packages")
    home = next((p for p in prefixes if (p / index / package).is_file()), None)
    if home is None:
        ours = sorted(p.name for p in prefixes if list_executables(p / "lib" / p.name))
        raise SetupError(f"there is no package '{package}'; this workspace has: {', '.join(ours) or 'none'}.")
    there = list_executables(home / "lib" / package)
    if name not in there:
        raise SetupError(f"package '{package}' has no executable '{name}'; it has: {', '.join(there) or 'none'}.")
    return home / "lib" / package / name


def list_executables(folder: Path) -> list[str]:
    """Return the names of the executable files in a folder."""
    if not folder.is_dir():
        return []
    return sorted(entry.name for entry in folder.iterdir() if entry.is_file() and os.access(entry, os.X_OK))
