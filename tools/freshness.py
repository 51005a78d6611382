"""Tell what the set-up has still to make, by reading files only: this runs before every program."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from environment import Workspace, read_stamp

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

RECIPE = 1  # counted up when the set-up changes what it makes: everything is then made again
NAMED_LISTS = ("build.in", "base.in", "dev.in")  # what is added to an installed Jazzy, as far as it is missing
NAMED_LOCKS = ("build.txt", "base.txt", "dev.txt")
WHEEL_LOCKS = (*NAMED_LOCKS, "ros-jazzy.txt", "typing.txt")
BUILD_FILES = {"CMakeLists.txt", "package.xml", "setup.cfg", "setup.py"}
SOURCES_CHANGED = "sources changed"
KERNELS = "src/posor_estimator/posor_estimator/core/kernels/*.py"
COMPILER = "src/posor_estimator/posor_estimator/core/compiled.py"
INTERFACES = {".action", ".idl", ".msg", ".srv"}


def environment_inputs(workspace: Workspace, *, official: bool) -> str:
    """Return the hash of all that decides what the virtual environment holds."""
    names = NAMED_LISTS + NAMED_LOCKS if official else WHEEL_LOCKS
    digest = hashlib.sha256(f"{RECIPE} {workspace.root} official={official}".encode())
    for name in names:
        digest.update((workspace.root / "requirements" / name).read_bytes())
    return digest.hexdigest()


def build_inputs(workspace: Workspace) -> str:
    """Return the hash of all that decides what colcon installs.

    Python modules and data files are installed as links into the source tree, so of those only the names count; but
    the kernels are compiled once after the build, so that no node has to wait for it.
    """
    digest = hashlib.sha256(f"{RECIPE}".encode())
    for file in sorted(path for package in source_packages(workspace) for path in package_files(package)):
        digest.update(f"{file.relative_to(workspace.ros2)}\0".encode())
        if file.suffix in INTERFACES or file.name in BUILD_FILES:
            digest.update(file.read_bytes())
    for pattern in (COMPILER, KERNELS):
        for file in sorted(workspace.ros2.glob(pattern)):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def source_packages(workspace: Workspace) -> list[Path]:
    """Return the folders of the ROS packages, each named as its package."""
    return [manifest.parent for manifest in sorted(workspace.ros2.glob("src/*/package.xml"))]


def installed_as_links(workspace: Workspace, package: Path) -> bool:
    """Tell whether a package is installed, and by links into the source tree as the set-up does it."""
    return (workspace.install / package.name / "share" / package.name / "package.xml").is_symlink()


def package_files(package: Path) -> Iterator[Path]:
    """Yield the source files of a ROS package that are not inside its Python package or its tests."""
    inside = {package / package.name, package / "test"}
    for folder, folders, names in os.walk(package):
        here = Path(folder)
        folders[:] = sorted(name for name in folders if name != "__pycache__" and here / name not in inside)
        yield from (here / name for name in names)


def what_is_missing(workspace: Workspace, environ: Mapping[str, str], *, official: bool) -> tuple[str, str]:
    """Tell why the virtual environment and the build have to be made, an empty string for each that need not.

    Reads files only; starts no process.
    """
    inputs = environment_inputs(workspace, official=official)
    stamp = read_stamp(workspace.environment_stamp)
    if not workspace.venv.exists():
        reason = "none yet"
    elif not stamp or not workspace.python.exists():
        reason = "unfinished or damaged"
    elif stamp.get("inputs") != inputs:
        reason = "requirements or place changed"
    elif environ.get("PYTHON") and stamp.get("interpreter") != interpreter():
        reason = "another Python is asked for"
    else:
        reason = ""
    built = read_stamp(workspace.build_stamp)
    if reason:
        return reason, "new environment"
    if not built or not (workspace.ros2 / "build").is_dir():
        return "", "none yet or unfinished"
    if not all(installed_as_links(workspace, package) for package in source_packages(workspace)):
        return "", "incomplete, or by a plain colcon build"
    if built.get("environment") != inputs:
        return "", "new environment"
    if built.get("inputs") != build_inputs(workspace):
        return "", SOURCES_CHANGED
    return "", ""


def interpreter() -> list[str]:
    """Return what identifies the Python that runs this."""
    return [sys.base_prefix, sys.version.split()[0]]
