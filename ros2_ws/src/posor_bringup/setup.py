"""Packaging of posor_bringup for colcon (ament_python)."""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from setuptools import find_packages, setup

PACKAGE = "posor_bringup"
SCRATCH = TemporaryDirectory()  # pip builds there: the source folder stays clean; colcon has a build folder
OPTIONS = {"build": {"build_base": SCRATCH.name}, "egg_info": {"egg_base": SCRATCH.name}}


def data_files(*roots: str) -> list[tuple[str, list[str]]]:
    """Return the data files of folders and their subfolders, by folder of installation, sorted."""
    folders = sorted({path.parent for root in roots for path in Path(root).rglob("*.*")})
    return [(f"share/{PACKAGE}/{folder}", sorted(map(str, folder.glob("*.*")))) for folder in folders]


setup(
    name=PACKAGE,
    version="0.1.0",
    description="What a user starts: bringup, launch files, arms, and the 1985 rig",
    license="Apache-2.0",
    maintainer="POSOR maintainers",
    maintainer_email="maintainers@posor.invalid",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *data_files("arms", "bags", "config", "launch", "security", "urdf"),
    ],
    python_requires=">=3.11",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    options={} if "develop" in sys.argv else OPTIONS,
    entry_points={
        "console_scripts": [
            "bringup = posor_bringup.bringup_programs:bringup",
            "view = posor_bringup.bringup_programs:view",
            "posor = posor_bringup.bringup_programs:posor",
        ],
    },
)
