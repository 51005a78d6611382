"""Packaging of posor for colcon (ament_python)."""

from __future__ import annotations

import sys
from tempfile import TemporaryDirectory

from setuptools import find_packages, setup

PACKAGE = "posor"
SCRATCH = TemporaryDirectory()  # pip builds there: the source folder stays clean; colcon has a build folder
OPTIONS = {"build": {"build_base": SCRATCH.name}, "egg_info": {"egg_base": SCRATCH.name}}


setup(
    name=PACKAGE,
    version="0.1.0",
    description="Library of the POSOR stack: measurement model, estimator, chain, calibration files, bags; no ROS",
    license="Apache-2.0",
    maintainer="POSOR maintainers",
    maintainer_email="maintainers@posor.invalid",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed", "reporting/*.j2"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
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
    options={} if "develop" in sys.argv else OPTIONS,
    entry_points={
        "console_scripts": [
            "reprocess = posor.library_programs:reprocess",
            "recover = posor.library_programs:recover",
        ],
        "posor.sensors": [
            "gap_probes = posor.sensors.gap_probes:GapProbesCalibration",
            "diodes = posor.sensors.diodes:DiodesCalibration",
            "bumpy_ring = posor.sensors.bumpy_ring:BumpyRingCalibration",
        ],
    },
)
