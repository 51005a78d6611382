"""Packaging of posor_drivers for colcon (ament_python)."""

from __future__ import annotations

import sys
from tempfile import TemporaryDirectory

from setuptools import find_packages, setup

PACKAGE = "posor_drivers"
SCRATCH = TemporaryDirectory()  # pip builds there: the source folder stays clean; colcon has a build folder
OPTIONS = {"build": {"build_base": SCRATCH.name}, "egg_info": {"egg_base": SCRATCH.name}}

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Driver node of a POSOR, the sources it reads scans from, and the bag recorder",
    license="Apache-2.0",
    maintainer="POSOR maintainers",
    maintainer_email="maintainers@posor.invalid",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed", "instruments/scpi_dialects/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    python_requires=">=3.11",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    options={} if "develop" in sys.argv else OPTIONS,
    entry_points={
        "console_scripts": [
            "driver_node = posor_drivers.driver_programs:driver_node",
            "instruments = posor_drivers.driver_programs:instruments",
            "record = posor_drivers.driver_programs:record",
        ],
        "posor_estimator.nodes": ["driver_node = posor_drivers.driver_node:DriverNode"],
        "posor_drivers.sources": [
            "bag = posor_drivers.sources.bag_source:BagSource",
            "instruments = posor_drivers.sources.instrument_source:InstrumentSource",
            "looped = posor_drivers.sources.looped_source:LoopedSource",
            "simulated = posor_drivers.sources.simulated_source:SimulatedSource",
            "table = posor_drivers.sources.table_source:TableSource",
        ],
        "posor_drivers.devices": [
            "capancdt_6200 = posor_drivers.instruments.capancdt_device:CapaNcdtDevice",
            "labjack = posor_drivers.instruments.labjack_device:LabJackDevice",
            "labjack_stream = posor_drivers.instruments.labjack_stream_device:LabJackStreamDevice",
            "nidaqmx = posor_drivers.instruments.nidaqmx_device:NiDevice",
            "scpi = posor_drivers.instruments.scpi_device:ScpiDevice",
            "stream = posor_drivers.instruments.stream_device:StreamDevice",
        ],
    },
)
