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
            "posor_node = posor_estimator.programs:posor_node",
            "chain_node = posor_estimator.programs:chain_node",
            "compose = posor_estimator.programs:compose",
            "budget = posor_estimator.programs:budget",
            "calibrate = posor_estimator.programs:calibrate",
            "golden = posor_estimator.programs:golden",
            "accuracy = posor_estimator.programs:accuracy",
            "reprocess = posor_estimator.programs:reprocess",
            "bench_core = posor_estimator.programs:bench_core",
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
