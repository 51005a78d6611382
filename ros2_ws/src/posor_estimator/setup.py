"""Packaging of posor_estimator for colcon (ament_python)."""

from __future__ import annotations

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "posor_estimator"


def files(folder: str) -> list[str]:
    """Return the data files of a folder of this package, in a fixed order."""
    return sorted(str(path) for path in Path(folder).glob("*.*"))


setup(
    name=PACKAGE,
    version="0.1.0",
    description="Sensor models, estimator, chain and calibration of the POSOR stack, and their ROS 2 nodes",
    license="Apache-2.0",
    maintainer="POSOR maintainers",
    maintainer_email="maintainers@posor.invalid",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", files("config")),
    ],
    python_requires=">=3.11",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "posor_node = posor_estimator.posor_node:main",
            "chain_node = posor_estimator.chain_node:main",
            "compose = posor_estimator.ros.compose:main",
            "budget = posor_estimator.budget.command:main",
            "calibrate = posor_estimator.calibrate.command:main",
            "golden = posor_estimator.golden:main",
            "accuracy = posor_estimator.accuracy.report:main",
            "reprocess = posor_estimator.reprocess.command:main",
            "bench_core = posor_estimator.accuracy.bench_core:main",
        ],
        "posor_estimator.nodes": [
            "chain_node = posor_estimator.chain_node:ChainNode",
            "posor_node = posor_estimator.posor_node:PosorEstimatorNode",
        ],
        "posor_estimator.sensors": [
            "gap_probes = posor_estimator.core.sensors.gap_probes:GapProbesCalibration",
            "diodes = posor_estimator.core.sensors.diodes:DiodesCalibration",
            "bumpy_ring = posor_estimator.core.sensors.bumpy_ring:BumpyRingCalibration",
        ],
    },
)
