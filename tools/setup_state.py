# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Find the parts of the workspace that are missing or out of date, from files only: this runs before every program."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from environment import Workspace, read_stamp

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

SETUP_VERSION = 1  # increase it when the set-up changes its results: each checkout is then set up anew
NAMED_LISTS = ("build.in", "base.in", "dev.in")  # libraries to add to an installed Jazzy if they are missing
NAMED_LOCKS = ("build.txt", "base.txt", "dev.txt")
SYSTEM_LOCK = "noble.txt"  # beside an installed Jazzy, its versions take the place of those of NAMED_LOCKS
WHEEL_LOCKS = (*NAMED_LOCKS, "ros-jazzy.txt", "typing.txt")
BUILD_FILES = {"CMakeLists.txt", "package.xml", "setup.cfg", "setup.py"}
INTERFACE_SUFFIXES = {".action", ".idl", ".msg", ".srv"}
SOURCES_CHANGED = "sources changed"
KERNEL_FILES = tuple(
    f"src/posor/posor/{pattern}"
    for pattern in (
        "kernel_*.py",
        *(f"{folder}/[!.#]*.py" for folder in ("numerics", "model", "estimation", "chain", "messages")),
    )
)  # as in posor.numerics.kernel_library


def environment_inputs(workspace: Workspace, *, official: bool) -> str:
    """Return a hash of everything that determines the content of the virtual environment."""
    names = (*NAMED_LISTS, *NAMED_LOCKS, SYSTEM_LOCK) if official else WHEEL_LOCKS
    digest = hashlib.sha256(f"{SETUP_VERSION} {workspace.root} official={official}".encode())
    for name in names:
        digest.update((workspace.root / "requirements" / name).read_bytes())
    return digest.hexdigest()


def build_inputs(workspace: Workspace, *, official: bool) -> str:
    """Return a hash of everything that determines the installed workspace.

    Python modules and data files are installed as links into the source tree: only their names count. The build
    makes the library of the kernels: the content of their files counts.
    """
    digest = hashlib.sha256(f"{SETUP_VERSION}".encode())
    packages = source_packages(workspace, official=official)
    for file in sorted(path for package in packages for path in package_files(package)):
        digest.update(f"{file.relative_to(workspace.root)}\0".encode())
        if file.suffix in INTERFACE_SUFFIXES or file.name in BUILD_FILES:
            digest.update(file.read_bytes())
    for file in kernel_files(workspace):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def kernel_files(workspace: Workspace) -> list[Path]:
    """Return the files with the functions that are compiled after the build, and with their constants."""
    return sorted(file for pattern in KERNEL_FILES for file in workspace.ros2.glob(pattern))


def source_packages(workspace: Workspace, *, official: bool) -> list[Path]:
    """Return the folders of the ROS packages. The name of each folder is the name of its package."""
    folders = [workspace.ros2 / "src", workspace.root / "lab", *([] if official else [workspace.wheel_packages])]
    return [manifest.parent for folder in folders for manifest in sorted(folder.glob("*/package.xml"))]


def is_installed_as_links(workspace: Workspace, package: Path) -> bool:
    """Return whether a package is installed by links into the source tree, as the set-up does it."""
    return (workspace.install / package.name / "share" / package.name / "package.xml").is_symlink()


def package_files(package: Path) -> Iterator[Path]:
    """Yield the files that a build reads: its own at the top, and those of all folders but Python package and tests."""
    for folder, folders, names in os.walk(package):
        here = Path(folder)
        excluded = {package.name, "test", "build"} if here == package else set()
        folders[:] = [name for name in folders if name not in excluded and not is_leftover(name)]
        sources = BUILD_FILES.intersection(names) if here == package else names
        yield from (here / name for name in sources if not is_leftover(name))


def is_leftover(name: str) -> bool:
    """Return whether a file or folder is a cache, a copy of an editor or of a patch, or a result of pip or build."""
    ending = ("~", ".egg-info", ".orig", ".rej", ".bak", ".kate-swp")
    return name in {"__pycache__", "dist"} or name.isdigit() or name.startswith((".", "#")) or name.endswith(ending)


def reasons_to_set_up(workspace: Workspace, environ: Mapping[str, str], *, official: bool) -> tuple[str, str]:
    """Return why the virtual environment and the build have to be made; an empty string for a complete part.

    Reads files only and starts no process.
    """
    inputs = environment_inputs(workspace, official=official)
    reason = reason_to_make_environment(workspace, environ, inputs)
    if reason:
        return reason, "new environment"
    build_stamp = read_stamp(workspace.build_stamp)
    if not build_stamp or not (workspace.ros2 / "build").is_dir():
        return "", "none yet or unfinished"
    packages = source_packages(workspace, official=official)
    if not all(is_installed_as_links(workspace, package) for package in packages):
        return "", "incomplete, or by a plain colcon build"
    if build_stamp.get("environment") != inputs:
        return "", "new environment"
    if build_stamp.get("inputs") != build_inputs(workspace, official=official):
        return "", SOURCES_CHANGED
    return "", ""


def reason_to_make_environment(workspace: Workspace, environ: Mapping[str, str], inputs: str) -> str:
    """Return why the virtual environment has to be made, or an empty string."""
    stamp = read_stamp(workspace.environment_stamp)
    if not workspace.venv.exists():
        return "none yet"
    if not stamp or not workspace.python.exists():
        return "unfinished or damaged"
    if stamp.get("inputs") != inputs:
        return "requirements or location changed"
    if environ.get("PYTHON") and stamp.get("interpreter") != interpreter_identity():
        return "another Python is requested"
    return ""


def interpreter_identity() -> list[str]:
    """Return the installation and the version of the running Python."""
    return [sys.base_prefix, sys.version.split()[0]]
