# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Packaging for colcon and pip; ``setup.cfg`` describes the package, and this file lists its data files."""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from setuptools import setup

SCRATCH = TemporaryDirectory()  # pip builds there: the source folder stays clean; colcon has a build folder
OPTIONS = {"build": {"build_base": SCRATCH.name}, "egg_info": {"egg_base": SCRATCH.name}}


def data_files(*roots: str) -> list[tuple[str, list[str]]]:
    """Return the data files of folders and their subfolders, by folder of installation, sorted; no broken links."""
    folders = sorted({path.parent for root in roots for path in Path(root).rglob("*.*")})
    files = {folder: [str(path) for path in folder.glob("*.*") if path.exists()] for folder in folders}
    return [(f"share/posor_bringup/{folder}", sorted(paths)) for folder, paths in files.items()]


setup(
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/posor_bringup"]),
        ("share/posor_bringup", ["package.xml"]),
        *data_files("arms", "bags", "config", "launch", "security", "urdf"),
    ],
    python_requires=">=3.11",
    options={} if "develop" in sys.argv else OPTIONS,
)
