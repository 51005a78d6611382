"""Packaging of posor_ros2_control for colcon (ament_python): configuration only."""

from __future__ import annotations

from setuptools import setup

PACKAGE = "posor_ros2_control"

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
)
