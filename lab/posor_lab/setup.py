"""Packaging of posor_lab for colcon (ament_python)."""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from setuptools import find_packages, setup

PACKAGE = "posor_lab"
SCRATCH = TemporaryDirectory()  # pip builds there: the source folder stays clean; colcon has a build folder
OPTIONS = {"build": {"build_base": SCRATCH.name}, "egg_info": {"egg_base": SCRATCH.name}}


def files(folder: str) -> list[str]:
    """Return the data files of a folder of this package, in a fixed order."""
    return sorted(str(path) for path in Path(folder).glob("*.*"))


setup(
    name=PACKAGE,
    version="0.1.0",
    description="Comparison with 1985, simulated campaigns, accuracy, thesis budgets, arm study and benchmark",
    license="Apache-2.0",
    maintainer="POSOR maintainers",
    maintainer_email="maintainers@posor.invalid",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/data", files("data")),
    ],
    python_requires=">=3.11",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    options={} if "develop" in sys.argv else OPTIONS,
    entry_points={
        "console_scripts": [
            "accuracy = posor_lab.lab_programs:accuracy",
            "arm = posor_lab.lab_programs:arm",
            "arm_budget = posor_lab.lab_programs:arm_budget",
            "bench = posor_lab.lab_programs:bench",
            "bench_core = posor_lab.lab_programs:bench_core",
            "budgets = posor_lab.lab_programs:budgets",
            "calibrate_demo = posor_lab.lab_programs:calibrate_demo",
            "demo = posor_lab.lab_programs:demo",
            "faults = posor_lab.lab_programs:faults",
            "fuzz = posor_lab.lab_programs:fuzz",
            "golden = posor_lab.lab_programs:golden",
            "instruments_trials = posor_lab.lab_programs:instruments_trials",
            "soak = posor_lab.lab_programs:soak",
            "thesis = posor_lab.lab_programs:thesis",
            "zero_drift_1985 = posor_lab.lab_programs:zero_drift_1985",
        ],
    },
)
