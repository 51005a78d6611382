"""The trials: for each kind of device a server over real sockets, the instruments file that fits, and its aims."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from posor_lab.device_servers.capancdt_server import CapaNcdtServer
from posor_lab.device_servers.labjack_server import LabJackServer
from posor_lab.device_servers.labjack_stream_server import LabJackStreamServer
from posor_lab.device_servers.scpi_server import FIRST_CHANNEL, ScpiServer
from posor_lab.device_servers.stream_server import LEAD, MAGIC, StreamServer
from posor_lab.instruments.least_delay import measure_least_delay
from posor_lab.instruments.simulated_readings import quantity

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import ExitStack
    from threading import Event

    from posor_lab.instruments.simulated_readings import SimulatedReadings

HOST = "127.0.0.1"
RANGE_M = 5e-4
"""Measuring range of the capacitive sensors; in it the gap voltages of the test rig lie."""
SCALE_V_PER_M, OFFSET_V = 4e4, -10.0
"""Voltage of the simulated probe by distance."""
CAPANCDT_SAMPLE_US = 256
STREAM_RATE, ASKED_RATE = 1000.0, 250.0
FEEDBACK_OHM = 1e5
"""Feedback of the amplifiers that turn diode currents into voltages."""


@dataclass(frozen=True)
class Devices:
    """Running servers: entries of the instruments file, and how to stop their frames."""

    devices: dict[str, dict[str, Any]]
    joints: dict[str, dict[str, Any]]
    stalled: Event


@dataclass(frozen=True)
class DeviceTrial:
    """One trial."""

    name: str  # for the figures
    arm: str  # installed arm
    rate: int  # scans per second
    latency_s: float  # from tick to publication
    seconds: float  # of the measurement
    serve: Callable[[SimulatedReadings, ExitStack], Devices]  # starts the servers until the stack closes
    slowness: float = 1.0  # factor by which the arm moves slower than in its scenario
    returns: bool = True  # whether poses must come soon after a stall; a ring must pass its home mark first
    keeps_pace: bool = True  # whether two processors can be expected to follow, with the servers beside the nodes
    stamps_matter: bool = (
        False  # whether the arm is so fast that the uncertainty of the stamps, in no covariance, counts
    )


def _stream(
    readings: SimulatedReadings, joint: str, server: StreamServer, rate: float, delay_s: float
) -> dict[str, Any]:
    channels = readings.channels[joint]
    return {
        "kind": "stream",
        "transport": "tcp",
        "host": HOST,
        "port": server.port,
        "rate": quantity(rate, "Hz"),
        "delay": quantity(delay_s, "s"),
        "format": f"{LEAD}{len(channels)}d",
        "fields": ["magic", "counter", *(channel.name for channel in channels)],
        "constants": {"magic": MAGIC},
        "channels": {channel.name: {"unit": channel.unit} for channel in channels},
    }


def _direct(readings: SimulatedReadings, joint: str, device: str) -> dict[str, dict[str, Any]]:
    return {channel.name: {"channel": f"{device}/{channel.name}"} for channel in readings.channels[joint]}


def serve_streams(readings: SimulatedReadings, stack: ExitStack, *, rates: tuple[float, ...]) -> Devices:
    """Serve one stream for each joint, at frames per second for the joints in turn; clocks differ by 20 ppm."""
    devices, joints, servers = {}, {}, []
    delay_s = measure_least_delay(STREAM_RATE)
    for n, joint in enumerate(readings.channels):
        rate = rates[n % len(rates)]
        servers.append(stack.enter_context(StreamServer(partial(readings.at, joint), rate, drift=20e-6 * n)))
        devices[f"box_{joint}"] = _stream(readings, joint, servers[-1], rate, delay_s)
        joints[joint] = readings.joint_entry(joint, _direct(readings, joint, f"box_{joint}"))
    return Devices(devices, joints, servers[0].stalled)


def serve_with_probes(readings: SimulatedReadings, stack: ExitStack) -> tuple[CapaNcdtServer, Devices]:
    """Serve the gap probes as distances of a capaNCDT at its greatest rate, everything else as a stream.

    Returns:
        The server of the probes, for faults, and all devices.

    """
    delay_s = measure_least_delay(STREAM_RATE)
    (joint,) = readings.channels
    gaps = {n: each.name for n, each in enumerate(readings.channels[joint]) if each.kind == "gap_voltages"}

    def distances(time_ns: int) -> list[float]:
        values = readings.at(joint, time_ns)
        return [(values[n] - OFFSET_V) / SCALE_V_PER_M for n in gaps]

    probes = CapaNcdtServer(distances, dict.fromkeys(range(1, len(gaps) + 1), RANGE_M), drift=50e-6)
    probes.packet_frames = 8
    stack.enter_context(probes)
    others = stack.enter_context(StreamServer(partial(readings.at, joint), STREAM_RATE))
    scale = {"scale": quantity(SCALE_V_PER_M, "V/m"), "offset": quantity(OFFSET_V, "V")}
    entries = _direct(readings, joint, "box") | {name: {"channel": f"probes/{name}", **scale} for name in gaps.values()}
    controller = {
        "kind": "capancdt_6200",
        "host": HOST,
        "command_port": probes.command_port,
        "data_port": probes.data_port,
        "rate": quantity(1e6 / CAPANCDT_SAMPLE_US, "Hz"),
        "delay": quantity(delay_s, "s"),
        "channels": {
            name: {"number": number, "range": quantity(RANGE_M, "m")} for number, name in enumerate(gaps.values(), 1)
        },
    }
    devices = {"probes": controller, "box": _stream(readings, joint, others, STREAM_RATE, delay_s)}
    return probes, Devices(devices, {joint: readings.joint_entry(joint, entries)}, probes.stalled)


def serve_voltages(
    readings: SimulatedReadings,
    stack: ExitStack,
    *,
    server_class: type[LabJackServer | ScpiServer],
    settings_of: Callable[[Any, list[str]], dict[str, Any]],
) -> Devices:
    """Serve all readings with a unit as voltages of one device; light sources are fixed numbers, as in the test rig.

    Args:
        readings: The readings.
        stack: Ends the server.
        server_class: Class of the server, which takes a function that returns the voltages by the ROS time [ns].
        settings_of: Returns the entry of the instruments file for a server and the names of the channels.

    """
    (joint,) = readings.channels
    channels, first = readings.channels[joint], readings.at(joint, 0)
    gains = {n: FEEDBACK_OHM if each.unit == "A" else 1.0 for n, each in enumerate(channels) if each.unit != "1"}

    def voltages(time_ns: int) -> list[float]:
        values = readings.at(joint, time_ns)
        return [gain * values[n] for n, gain in gains.items()]

    server = server_class(voltages)
    stack.enter_context(server)
    entries = _direct(readings, joint, "daq")
    for channel in channels:
        if channel.unit == "A":
            entries[channel.name]["scale"] = quantity(1.0 / FEEDBACK_OHM, "A/V")
    entry = readings.joint_entry(joint, entries)
    entry["lit_sources"] = [round(first[n]) for n, channel in enumerate(channels) if channel.kind == "lit_sources"]
    del entry["home_mark"]
    settings = settings_of(server, [channels[n].name for n in gains])
    return Devices({"daq": settings}, {joint: entry}, server.stalled)


def _labjack(server: LabJackServer, names: list[str]) -> dict[str, Any]:
    channels, rate = {name: {"input": n} for n, name in enumerate(names)}, quantity(ASKED_RATE, "Hz")
    return {"kind": "labjack", "host": HOST, "port": server.port, "rate": rate, "channels": channels}


def _labjack_stream(server: LabJackStreamServer, names: list[str]) -> dict[str, Any]:
    rate, delay = quantity(STREAM_RATE, "Hz"), quantity(measure_least_delay(STREAM_RATE), "s")
    return _labjack(server, names) | {
        "kind": "labjack_stream",
        "stream_port": server.stream_port,
        "rate": rate,
        "delay": delay,
    }


def _scanner(server: ScpiServer, names: list[str]) -> dict[str, Any]:
    return {
        "kind": "scpi",
        "address": f"TCPIP::{HOST}::{server.port}::SOCKET",
        "dialect": "keysight_daq970a",
        "rate": quantity(5.0, "Hz"),
        "channels": {name: {"number": FIRST_CHANNEL + n, "unit": "V"} for n, name in enumerate(names)},
    }


_STREAM = partial(serve_streams, rates=(STREAM_RATE,))
_FIVE_STREAMS = partial(serve_streams, rates=(997.0, 1003.0))
_LABJACK = partial(serve_voltages, server_class=LabJackServer, settings_of=_labjack)
_LABJACK_STREAM = partial(serve_voltages, server_class=LabJackStreamServer, settings_of=_labjack_stream)
_SCANNER = partial(serve_voltages, server_class=ScpiServer, settings_of=_scanner)
_RIG, _FIVE = "test_rig", "five_axis"
TRIALS = (
    DeviceTrial("stream, 1 kHz", _RIG, 250, 0.1, 10.0, _STREAM),
    DeviceTrial(
        "capaNCDT 3.9 kHz, 1 kHz scans", _RIG, 1000, 0.1, 10.0, lambda *of: serve_with_probes(*of)[1], keeps_pace=False
    ),
    DeviceTrial("LabJack stream, 1 kHz", _RIG, 500, 0.1, 10.0, _LABJACK_STREAM),
    DeviceTrial("LabJack asked 250 times per second", _RIG, 100, 0.1, 20.0, _LABJACK, slowness=20.0),
    DeviceTrial("SCPI scanner, 5 Hz", _RIG, 5, 0.7, 150.0, _SCANNER, slowness=200.0),
    DeviceTrial("five streams, full speed", _FIVE, 50, 0.1, 20.0, _FIVE_STREAMS, returns=False, stamps_matter=True),
    DeviceTrial("five streams, slow", _FIVE, 50, 0.1, 20.0, _FIVE_STREAMS, slowness=20.0, returns=False),
)
