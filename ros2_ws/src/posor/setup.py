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
    package_data={PACKAGE: ["py.typed", "reporting/*.j2"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", files("config")),
    ],
    python_requires=">=3.11",
    # The lower bounds of requirements/base.in. colcon does not install them: there they come from rosdep or pip.
    install_requires=[
        "numpy>=1.26",
        "scipy>=1.11",
        "numba>=0.60",
        "pin>=3.4",
        "rosbags>=0.11",
        "pydantic>=2.7",
        "PyYAML>=6.0",
        "rich>=13.7",
    ],
    extras_require={
        "reports": ["Jinja2>=3.1", "bokeh>=3.4", "matplotlib>=3.6"],  # HTML pages of budget and calibrate
        "tables": ["pandas>=2.1", "pyarrow>=17"],  # to_dataframe, to_arrow, reprocess --format parquet or csv
        "test": ["pytest"],
    },
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "posor_node = posor_estimator.estimator_programs:posor_node",
            "chain_node = posor_estimator.estimator_programs:chain_node",
            "compose = posor_estimator.estimator_programs:compose",
            "budget = posor_estimator.estimator_programs:budget",
            "calibrate = posor_estimator.estimator_programs:calibrate",
            "design = posor_estimator.estimator_programs:design",
            "reprocess = posor_estimator.estimator_programs:reprocess",
            "recover = posor_estimator.estimator_programs:recover",
        ],
        "posor_estimator.nodes": [
            "chain_node = posor_estimator.chain_node:ChainNode",
            "posor_node = posor_estimator.posor_node:PosorEstimatorNode",
        ],
        "posor.sensors": [
            "gap_probes = posor.sensors.gap_probes:GapProbesCalibration",
            "diodes = posor.sensors.diodes:DiodesCalibration",
            "bumpy_ring = posor.sensors.bumpy_ring:BumpyRingCalibration",
        ],
    },
)
