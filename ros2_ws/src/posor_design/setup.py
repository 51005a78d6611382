"""Packaging of posor_design for colcon (ament_python)."""

from __future__ import annotations

import sys
from tempfile import TemporaryDirectory

from setuptools import find_packages, setup

PACKAGE = "posor_design"
SCRATCH = TemporaryDirectory()  # pip builds there: the source folder stays clean; colcon has a build folder
OPTIONS = {"build": {"build_base": SCRATCH.name}, "egg_info": {"egg_base": SCRATCH.name}}

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Search for the layout of a POSOR, allotment of an arm, error budgets and design calculators",
    license="Apache-2.0",
    maintainer="POSOR maintainers",
    maintainer_email="maintainers@posor.invalid",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    python_requires=">=3.11",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    options={} if "develop" in sys.argv else OPTIONS,
    entry_points={
        "console_scripts": [
            "budget = posor_design.design_programs:budget",
            "design = posor_design.design_programs:design",
        ],
    },
)
