"""A starting instruments file for an arm: every reading of its calibrations, with example addresses to be replaced."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import yaml
from posor.calibration.calibration_file import load_calibration
from posor.errors import ParameterError
from posor.sensors.bumpy_ring import BumpyRingCalibration
from posor.sensors.diodes import DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration

from posor_drivers.instruments.instruments_file import READINGS, WHOLE_NUMBERS, device_classes

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.calibration.calibration_file import Calibration
    from posor.chain.arm_file import ArmFile

CONTACTS = "ABCD"
HEADING = """\
# Instruments file of {arm}, to be completed: replace addresses, rates, numbers of channels, and every scale of 1.0.
# `posor instruments list FILE` checks it, `posor instruments probe FILE` tries it.
"""


def format_starting_file(arm: ArmFile, kind: str, probes_kind: str) -> str:
    """Return the text of an instruments file with a device for each joint, and one more for its gap probes.

    Args:
        arm: The arm.
        kind: Kind of the devices.
        probes_kind: Kind of those of the gap probes; if it is the same, one device has all readings of a joint.

    Raises:
        CalibrationError: A calibration file is invalid.
        ParameterError: There is no such kind, or the device has not enough channels.

    """
    content: dict[str, Any] = {
        "format": "posor_instruments",
        "version": 1,
        "name": arm.name,
        "rate": {"value": 100, "unit": "Hz"},
        "latency": {"value": 0.05, "unit": "s"},
        "devices": {},
        "joints": {},
    }
    for joint, path in arm.calibrations.items():
        calibration = load_calibration(path)
        readings = _readings(calibration)
        gaps = {name: reading for name, reading in readings.items() if reading == "gap_voltages"}
        others = {name: reading for name, reading in readings.items() if name not in gaps}
        entry: dict[str, Any] = {"frame_id": calibration.frames.parent}
        if kind == probes_kind:
            _add_device(content, entry, joint, kind, readings)
        else:
            _add_device(content, entry, f"{joint}_probes", probes_kind, gaps)
            _add_device(content, entry, joint, kind, others)
        content["joints"][joint] = entry
    return HEADING.format(arm=arm.name) + yaml.safe_dump(content, sort_keys=False, width=120)


def _readings(calibration: Calibration) -> dict[str, str]:
    """Return the kind of each reading of a POSOR by the name of its channel, in the order of the calibration file."""
    readings: dict[str, str] = {}
    for sensor in calibration.sensors:
        if isinstance(sensor, GapProbesCalibration):
            readings |= {probe.name: "gap_voltages" for probe in sensor.probes}
        elif isinstance(sensor, BumpyRingCalibration):
            readings |= {probe.name: "ring_voltages" for probe in sensor.probes} | {"home": "home_mark"}
        elif isinstance(sensor, DiodesCalibration):
            names = [diode.name for diode in sensor.diodes]
            readings |= {f"{name}_{contact}": "diode_currents" for name in names for contact in CONTACTS}
            readings |= {f"{name}_source": "lit_sources" for name in names}
    return readings


def _add_device(
    content: dict[str, Any], entry: dict[str, Any], device: str, kind: str, readings: Mapping[str, str]
) -> None:
    """Add a device with channels for some readings, and these readings to a joint."""
    classes = device_classes()
    if kind not in classes:
        raise ParameterError(f"kind '{kind}'", where="instruments start", expected=f"one of {', '.join(classes)}")
    units = {name: READINGS[reading] for name, reading in readings.items()}
    settings = {"kind": kind, **classes[kind].starting_settings(units)}
    made = classes[kind](device, classes[kind].Settings.model_validate(settings))
    content["devices"][device] = settings
    units_of_device = {channel.name: channel.unit for channel in made.channels}
    for name, reading in readings.items():
        part: Any = {"channel": f"{device}/{name}"}
        if name not in units_of_device:
            if reading == "home_mark":
                continue
            if reading != "lit_sources":
                what = f"a {kind} has no channel for '{name}' of {device}"
                raise ParameterError(what, where="instruments start", expected="another --device or --probes")
            part = len(entry.get("lit_sources", []))
        elif reading not in WHOLE_NUMBERS and units_of_device[name] != READINGS[reading]:
            part["scale"] = {"value": 1.0, "unit": f"{READINGS[reading]}/{units_of_device[name]}"}
        if reading == "home_mark":
            entry[reading] = part
        else:
            entry.setdefault(reading, []).append(part)
