"""Packaging of posor_ros2_control for colcon (ament_python): configuration only."""

from __future__ import annotations

import sys
from tempfile import TemporaryDirectory

from setuptools import setup

PACKAGE = "posor_ros2_control"
SCRATCH = TemporaryDirectory()  # pip builds there: the source folder stays clean; colcon has a build folder
OPTIONS = {"build": {"build_base": SCRATCH.name}, "egg_info": {"egg_base": SCRATCH.name}}

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Configuration that brings the measured joint angles into ros2_control",
    license="Apache-2.0",
    maintainer="POSOR maintainers",
    maintainer_email="maintainers@posor.invalid",
    packages=[],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", ["config/five_axis.ros2_control.xacro", "config/controllers.yaml"]),
    ],
    zip_safe=False,
    options={} if "develop" in sys.argv else OPTIONS,
)
