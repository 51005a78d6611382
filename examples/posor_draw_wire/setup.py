"""Packaging of posor_draw_wire for colcon (ament_python); the entry point is all that makes it a sensor type."""

from __future__ import annotations

from setuptools import setup

PACKAGE = "posor_draw_wire"
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
    entry_points=ENTRY_POINTS,
)
