"""Packaging of posor_bringup for colcon (ament_python)."""

from __future__ import annotations

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "posor_bringup"


def files(folder: str) -> list[str]:
    """Return the data files of a folder of this package, in a fixed order."""
    return sorted(str(path) for path in Path(folder).glob("*.*"))


def folders(folder: str) -> list[str]:
    """Return a folder of this package and all below it, in a fixed order."""
    return sorted({str(path.parent) for path in Path(folder).rglob("*.*")})


setup(
    name=PACKAGE,
    version="0.1.0",
    description="The 1985 rig and simulated arms: demos, reports, launch files, URDF and calibration files",
    license="Apache-2.0",
    maintainer="POSOR maintainers",
    maintainer_email="maintainers@posor.invalid",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *((f"share/{PACKAGE}/bags/{test}", files(f"bags/{test}")) for test in ("ymo", "yzmo", "zmo")),
        *((f"share/{PACKAGE}/{folder}", files(folder)) for folder in folders("arms")),
        (f"share/{PACKAGE}/config", files("config")),
        (f"share/{PACKAGE}/data", files("data")),
        (f"share/{PACKAGE}/launch", files("launch")),
        (f"share/{PACKAGE}/urdf", files("urdf")),
    ],
    python_requires=">=3.11",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "arm = posor_bringup.programs:arm",
            "arm_budget = posor_bringup.programs:arm_budget",
            "bringup = posor_bringup.programs:bringup",
            "budgets = posor_bringup.programs:budgets",
            "calibrate_demo = posor_bringup.programs:calibrate_demo",
            "demo = posor_bringup.programs:demo",
            "zero_drift_1985 = posor_bringup.programs:zero_drift_1985",
        ],
    },
)
