# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Packaging of posor_draw_wire for colcon (ament_python); the entry point is all that makes it a sensor type."""

from __future__ import annotations

import sys
from tempfile import TemporaryDirectory

from setuptools import setup

PACKAGE = "posor_draw_wire"
SCRATCH = TemporaryDirectory()  # pip builds there: the source folder stays clean; colcon has a build folder
OPTIONS = {"build": {"build_base": SCRATCH.name}, "egg_info": {"egg_base": SCRATCH.name}}
ENTRY_POINTS = {"posor.sensors": ["draw_wire = posor_draw_wire.draw_wire:DrawWireCalibration"]}

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Example of a POSOR sensor type in a package of its own: draw-wire length sensors",
    license="Apache-2.0",
    maintainer="POSOR maintainers",
    maintainer_email="maintainers@posor.invalid",
    packages=[PACKAGE],
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", ["config/triad_draw_wire.yaml"]),
    ],
    python_requires=">=3.11",
    install_requires=["setuptools"],
    zip_safe=False,
    options={} if "develop" in sys.argv else OPTIONS,
    entry_points=ENTRY_POINTS,
)
