# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""instruments: lists the devices of an instruments file, tries them, shows live values, prints a first file."""

from __future__ import annotations

import math
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from posor.arm_names import describe_argument
from posor.calibration.calibration_file import load_calibration
from posor.calibration.save import save_calibration
from posor.chain.arm_file import ArmFile, load_arm_file
from posor.errors import ParameterError
from posor.output_files import writing
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors
from posor.tables.table_map import READINGS

from posor_drivers.instruments.calibrated_readings import readings_of
from posor_drivers.instruments.device import DeviceError, device_class, device_kinds
from posor_drivers.instruments.device_reader import DeviceReader
from posor_drivers.instruments.instruments_file import WHOLE_NUMBERS, InstrumentsFile, load_instruments
from posor_drivers.instruments.reading_noise import calibration_in_motion, noise_in_motion

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Mapping, Sequence

PROBE_S = 5.0
"""Time in which a device must deliver frames whose clock is known."""
POLL_S = 0.05
WATCH_S = 1.0
HEADING = """\
# Instruments file of {arm}, to be completed: replace addresses, rates, numbers of channels, and every scale of 1.0.
# `posor instruments list FILE` checks it, `posor instruments probe FILE` tries it.
"""


def _parse_options(arguments: Sequence[str] | None) -> Namespace:
    parser = CommandLineParser(prog="posor instruments", description="Show the devices of an instruments file.")
    actions = parser.add_subparsers(dest="action", required=True, parser_class=CommandLineParser)
    for name, summary in (
        ("list", "devices, channels and the readings made of them; connects to nothing"),
        ("probe", f"connect to every device and read frames for at most {PROBE_S:g} s"),
        ("watch", "show the newest value of every channel once a second until Ctrl-C"),
    ):
        action = actions.add_parser(name, help=summary, description=summary)
        action.add_argument("file", type=Path, metavar="FILE", help="instruments file (YAML)")
    summary = "print an instruments file for an arm, to be completed"
    start = actions.add_parser("start", help=summary, description=summary)
    start.add_argument("file", metavar="ARM", help=describe_argument())
    start.add_argument("--device", default="stream", metavar="KIND", help="kind of the devices (default: stream)")
    start.add_argument("--probes", metavar="KIND", help="kind of the devices of the gap probes (default: as --device)")
    summary = "noise of the readings while the arm moves: that of the calibrations and the interpolation error"
    noise = actions.add_parser("noise", help=summary, description=summary)
    noise.add_argument("file", type=Path, metavar="FILE", help="instruments file (YAML)")
    noise.add_argument("arm", metavar="ARM", help=describe_argument())
    noise.add_argument("--output", type=Path, metavar="FOLDER", help="write calibrations that state this noise")
    return parser.parse_args(arguments)


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if every device works."""
    options = _parse_options(arguments)
    if options.action == "start":
        print(
            _format_starting_file(load_arm_file(options.file), options.device, options.probes or options.device), end=""
        )
        return 0
    file = load_instruments(options.file)
    if options.action == "list":
        _list(file)
        return 0
    if options.action == "noise":
        _state_noise(file, load_arm_file(options.arm), options.output)
        return 0
    with ExitStack() as stack:
        readers = [DeviceReader(device) for device in file.new_devices().values()]
        for reader in readers:
            reader.start()
            stack.callback(reader.stop)
        if options.action == "probe":
            _probe(readers)
        else:
            _watch(readers)
    return 0


def _list(file: InstrumentsFile) -> None:
    """Print the devices and what their channels are used for."""
    uses: dict[str, list[str]] = {}
    for joint, readings in file.joints.items():
        for _, (name, *index), entry in readings.entries():
            uses.setdefault(entry.channel, []).append(f"{joint} {name}" + "".join(f"[{n}]" for n in index))
    print(f"kinds of devices: {', '.join(device_kinds())}")
    for name, device in file.new_devices().items():
        print(f"{name}: {device.settings.kind} at {device.address}, {device.frame_rate:g} frames per second")
        for channel, offset_s in zip(device.channels, device.exposures.offsets_s, strict=True):
            use = ", ".join(uses.get(f"{name}/{channel.name}", ["not used"]))
            exposure = (
                "read at an unknown time" if math.isnan(offset_s) else f"read {1e6 * offset_s:+g} us from its frame"
            )
            print(f"  {channel.name} [{channel.unit}]: {use}" + (f"; {exposure}" if offset_s else ""))


def _state_noise(file: InstrumentsFile, arm: ArmFile, output: Path | None) -> None:
    """Print the noise of the readings in motion, and write the calibrations that state it.

    Raises:
        PosorError: A calibration is invalid, or the folder cannot be made or has such a calibration.

    """
    for joint in file.joints:
        if joint not in arm.calibrations:
            raise ParameterError(f"joint '{joint}'", where=str(arm.path), expected=", ".join(arm.calibrations))
    if output is not None:
        with writing(output):
            output.mkdir(parents=True, exist_ok=True)
    for joint in file.joints:
        path = arm.calibrations[joint]
        noises = noise_in_motion(file, joint, load_calibration(path))
        for each in noises:
            print(f"{joint} {each}")
        if output is not None:
            save_calibration(output / f"{joint}.yaml", calibration_in_motion(path, noises))


def _probe(readers: Sequence[DeviceReader]) -> None:
    """Wait for the frames of all devices and print what they say.

    Raises:
        DeviceError: A device does not deliver frames.

    """
    end_s = time.monotonic() + PROBE_S
    while time.monotonic() < end_s and any(reader.state.fault for reader in readers):
        time.sleep(POLL_S)
    faults = []
    for reader in readers:
        state, name = reader.state, reader.device.name
        if state.fault:
            print(f"{name}: FAULT")
            faults.append(reader.take_state().fault)  # a device that has just connected again has another one
            continue
        values = state.values
        print(
            f"{name}: {state.text}; {values['frame_rate']:.4f} frames per second, stamps within "
            f"{1e6 * values['clock_uncertainty']:.1f} us (1 sigma) beside its least delay, {values['frames_lost']} lost"
        )
        print(_channel_line(reader))
    if faults:
        raise DeviceError("; ".join(fault.rstrip(".") for fault in faults), where="instruments probe")


def _channel_line(reader: DeviceReader) -> str:
    """Return the newest value of every channel."""
    values = reader.newest_values()
    if values is None:
        return f"  {reader.state.fault}"
    pairs = zip(reader.device.channels, values, strict=True)
    return "  " + ", ".join(f"{channel.name} {value:.6g} {channel.unit}" for channel, value in pairs)


def _watch(readers: Sequence[DeviceReader]) -> None:
    """Print the newest values once a second until Ctrl-C."""
    try:
        while True:
            time.sleep(WATCH_S)
            for reader in readers:
                print(f"{reader.device.name}: {_channel_line(reader).strip()}", flush=True)
    except KeyboardInterrupt:
        return


def _format_starting_file(arm: ArmFile, kind: str, probes_kind: str) -> str:
    """Return the text of an instruments file with every reading of an arm's calibrations and example addresses.

    Each joint has a device, and one more for its gap probes if that is of another kind.

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
        readings = readings_of(calibration)
        entry = content["joints"][joint] = {"frame_id": calibration.frames.parent}
        if kind != probes_kind:
            gaps = {name: readings.pop(name) for name in [*readings] if readings[name] == "gap_voltages"}
            _add_device(content, entry, f"{joint}_probes", probes_kind, gaps)
        _add_device(content, entry, joint, kind, readings)
    return HEADING.format(arm=arm.name) + yaml.safe_dump(content, sort_keys=False, width=120)


def _add_device(
    content: dict[str, Any], entry: dict[str, Any], device: str, kind: str, readings: Mapping[str, str]
) -> None:
    """Add a device with channels for some readings, and these readings to a joint."""
    if kind not in (kinds := device_kinds()):
        raise ParameterError(f"kind '{kind}'", where="instruments start", expected=f"one of {', '.join(kinds)}")
    device_type = device_class(kind)
    units = {name: READINGS[reading] for name, reading in readings.items()}
    settings = {"kind": kind, **device_type.starting_settings(units)}
    made = device_type(device, device_type.Settings.model_validate(settings))
    content["devices"][device] = settings
    units_of_device = {channel.name: channel.unit for channel in made.channels}
    for name, reading in readings.items():
        part: Any = {"channel": f"{device}/{name}"}
        if name not in units_of_device:
            if reading in {"home_mark", "light"}:
                continue
            if reading != "lit_sources":
                what = f"a {kind} has no channel for '{name}' of {device}"
                raise ParameterError(what, where="instruments start", expected="another --device or --probes")
            part = len(entry.get("lit_sources", []))
        elif reading not in WHOLE_NUMBERS and units_of_device[name] != READINGS[reading]:
            part["scale"] = {"value": 1.0, "unit": f"{READINGS[reading]}/{units_of_device[name]}"}
        if reading in {"home_mark", "light", "reference_voltage"}:
            entry[reading] = part
        else:
            entry.setdefault(reading, []).append(part)
