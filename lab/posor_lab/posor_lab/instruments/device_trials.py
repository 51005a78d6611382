"""The trials: for each kind of device a server over real sockets, the instruments file that fits, and its aims."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from posor_lab.device_servers.capancdt_server import CapaNcdtServer
from posor_lab.device_servers.labjack_server import LabJackServer
from posor_lab.device_servers.labjack_stream_server import LabJackStreamServer
from posor_lab.device_servers.scpi_server import FIRST_CHANNEL, ScpiServer
from posor_lab.device_servers.stream_server import LEAD, MAGIC, StreamServer
from posor_lab.instruments.least_delay import measure_least_delay

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from contextlib import ExitStack
    from threading import Event

    from posor_lab.instruments.simulated_readings import SimulatedReadings

ServerT = TypeVar("ServerT", bound=LabJackServer | ScpiServer)

HOST = "127.0.0.1"
RANGE_M = 5e-4
"""Measuring range of the capacitive sensors; in it the gap voltages of the test rig lie."""
SCALE_V_PER_M, OFFSET_V = 4e4, -10.0
"""From distance to the voltage of the simulated probe."""
CAPANCDT_SAMPLE_US = 256
STREAM_RATE, ASKED_RATE = 1000.0, 250.0
FEEDBACK_OHM = 1e5
"""Of the amplifiers that make voltages of the diode currents."""


@dataclass(frozen=True)
class Devices:
    """Running servers: entries of the instruments file, and how to stop their frames."""

    devices: dict[str, dict[str, Any]]
    joints: dict[str, dict[str, Any]]
    stalled: Event


@dataclass(frozen=True)
class DeviceTrial:
    """One trial.

    Attributes:
        name: For the figures.
        arm: Installed arm.
        rate: Scans per second.
        latency_s: From tick to publication.
        seconds: Of the measurement.
        slowness: Factor by which the arm moves slower than in its scenario.
        keeps_pace: Whether two processors can be expected to follow, with the servers beside the nodes.
        returns: Whether there must be poses soon after a stall; a ring must pass its home mark first.
        stamps_matter: Whether the arm is so fast that the uncertainty of the stamps counts, which no covariance has.
        serve: Starts the servers until the stack closes.

    """

    name: str
    arm: str
    rate: int
    latency_s: float
    seconds: float
    serve: Callable[[SimulatedReadings, ExitStack], Devices]
    slowness: float = 1.0
    returns: bool = True
    keeps_pace: bool = True
    stamps_matter: bool = False


def quantity(value: float, unit: str) -> dict[str, Any]:
    """Return an entry of a file."""
    return {"value": value, "unit": unit}


def _stream(
    readings: SimulatedReadings, joint: str, server: StreamServer, rate: float, delay_s: float
) -> dict[str, Any]:
    names = [channel.name for channel in readings.channels[joint]]
    return {
        "kind": "stream",
        "transport": "tcp",
        "host": HOST,
        "port": server.port,
        "rate": quantity(rate, "Hz"),
        "delay": quantity(delay_s, "s"),
        "format": f"{LEAD}{len(names)}d",
        "fields": ["magic", "counter", *names],
        "constants": {"magic": MAGIC},
        "channels": {channel.name: {"unit": channel.unit} for channel in readings.channels[joint]},
    }


def _direct(readings: SimulatedReadings, joint: str, device: str) -> dict[str, dict[str, Any]]:
    return {channel.name: {"channel": f"{device}/{channel.name}"} for channel in readings.channels[joint]}


def serve_streams(rates: Mapping[str, float]) -> Callable[[SimulatedReadings, ExitStack], Devices]:
    """Return what serves one stream for each joint, at frames per second by joint; clocks differ by 20 ppm."""

    def serve(readings: SimulatedReadings, stack: ExitStack) -> Devices:
        devices, joints, servers = {}, {}, []
        delay_s = measure_least_delay(STREAM_RATE)
        for n, joint in enumerate(readings.channels):
            rate = rates[joint]
            server = StreamServer(lambda t, joint=joint: readings.at(joint, t), rate, drift=20e-6 * n)  # type: ignore[misc]
            servers.append(stack.enter_context(server))
            devices[f"box_{joint}"] = _stream(readings, joint, server, rate, delay_s)
            joints[joint] = readings.joint_entry(joint, _direct(readings, joint, f"box_{joint}"))
        return Devices(devices, joints, servers[0].stalled)

    return serve


def serve_capancdt(readings: SimulatedReadings, stack: ExitStack) -> Devices:
    """Serve the gap probes as distances of a capaNCDT at its greatest rate, everything else as a stream."""
    return serve_with_probes(readings, stack)[1]


def serve_with_probes(readings: SimulatedReadings, stack: ExitStack) -> tuple[CapaNcdtServer, Devices]:
    """Serve as ``serve_capancdt``; return also the server of the probes, for faults."""
    delay_s = measure_least_delay(STREAM_RATE)
    (joint,) = readings.channels
    channels = readings.channels[joint]
    gaps = [n for n, channel in enumerate(channels) if channel.kind == "gap_voltages"]

    def distances(time_ns: int) -> list[float]:
        values = readings.at(joint, time_ns)
        return [(values[n] - OFFSET_V) / SCALE_V_PER_M for n in gaps]

    ranges = dict.fromkeys(range(1, len(gaps) + 1), RANGE_M)
    probes = CapaNcdtServer(distances, ranges, drift=50e-6)
    probes.packet_frames = 8
    stack.enter_context(probes)
    others = stack.enter_context(StreamServer(lambda t: readings.at(joint, t), STREAM_RATE))
    scale = {"scale": quantity(SCALE_V_PER_M, "V/m"), "offset": quantity(OFFSET_V, "V")}
    entries = _direct(readings, joint, "box")
    entries |= {channels[n].name: {"channel": f"probes/{channels[n].name}", **scale} for n in gaps}
    controller = {
        "kind": "capancdt_6200",
        "host": HOST,
        "command_port": probes.command_port,
        "data_port": probes.data_port,
        "rate": quantity(1e6 / CAPANCDT_SAMPLE_US, "Hz"),
        "delay": quantity(delay_s, "s"),
        "channels": {
            channels[n].name: {"number": k, "range": quantity(RANGE_M, "m")} for k, n in enumerate(gaps, start=1)
        },
    }
    devices = {"probes": controller, "box": _stream(readings, joint, others, STREAM_RATE, delay_s)}
    return probes, Devices(devices, {joint: readings.joint_entry(joint, entries)}, probes.stalled)


def _amplified(readings: SimulatedReadings, joint: str, device: str) -> dict[str, dict[str, Any]]:
    """Return the entries of readings that the device measures as voltages; a light source is fixed."""
    entries = _direct(readings, joint, device)
    for channel in readings.channels[joint]:
        if channel.unit == "A":
            entries[channel.name]["scale"] = quantity(1.0 / FEEDBACK_OHM, "A/V")
    return entries


def _analogue(readings: SimulatedReadings, joint: str) -> tuple[list[int], Callable[[int], list[float]]]:
    """Return the columns of the readings with a unit, and their voltages by the ROS time."""
    columns = [n for n, channel in enumerate(readings.channels[joint]) if channel.unit != "1"]
    gains = [FEEDBACK_OHM if readings.channels[joint][n].unit == "A" else 1.0 for n in columns]

    def voltages(time_ns: int) -> list[float]:
        values = readings.at(joint, time_ns)
        return [gain * values[n] for n, gain in zip(columns, gains, strict=True)]

    return columns, voltages


def _fixed_sources(readings: SimulatedReadings, joint: str, entry: dict[str, Any]) -> dict[str, Any]:
    """Return a joint whose light sources are fixed numbers, as those of the test rig are, and without a home mark."""
    channels, first = readings.channels[joint], readings.at(joint, 0)
    entry["lit_sources"] = [round(first[n]) for n, channel in enumerate(channels) if channel.kind == "lit_sources"]
    del entry["home_mark"]
    return entry


def serve_voltages(
    server_of: Callable[[Callable[[int], list[float]]], ServerT],
    settings_of: Callable[[ServerT, list[str]], dict[str, Any]],
) -> Callable[[SimulatedReadings, ExitStack], Devices]:
    """Return what serves all readings as voltages of one device.

    Args:
        server_of: Returns the server for the voltages by the ROS time [ns].
        settings_of: Returns the entry of the instruments file for a server and the names of the channels.

    """

    def serve(readings: SimulatedReadings, stack: ExitStack) -> Devices:
        (joint,) = readings.channels
        columns, voltages = _analogue(readings, joint)
        server = server_of(voltages)
        stack.enter_context(server)
        names = [readings.channels[joint][n].name for n in columns]
        entry = _fixed_sources(readings, joint, readings.joint_entry(joint, _amplified(readings, joint, "daq")))
        return Devices({"daq": settings_of(server, names)}, {joint: entry}, server.stalled)

    return serve


def _labjack(server: LabJackServer, names: list[str]) -> dict[str, Any]:
    channels = {name: {"input": n} for n, name in enumerate(names)}
    rate = quantity(ASKED_RATE, "Hz")
    return {"kind": "labjack", "host": HOST, "port": server.port, "rate": rate, "channels": channels}


def _labjack_stream(server: LabJackStreamServer, names: list[str]) -> dict[str, Any]:
    return {
        "kind": "labjack_stream",
        "host": HOST,
        "port": server.port,
        "stream_port": server.stream_port,
        "rate": quantity(STREAM_RATE, "Hz"),
        "delay": quantity(measure_least_delay(STREAM_RATE), "s"),
        "channels": {name: {"input": n} for n, name in enumerate(names)},
    }


def _scanner(server: ScpiServer, names: list[str]) -> dict[str, Any]:
    return {
        "kind": "scpi",
        "address": f"TCPIP::{HOST}::{server.port}::SOCKET",
        "dialect": "keysight_daq970a",
        "rate": quantity(5.0, "Hz"),
        "channels": {name: {"number": FIRST_CHANNEL + n, "unit": "V"} for n, name in enumerate(names)},
    }


FIVE_AXIS_RATES = {"base_swivel": 997.0, "shoulder": 1003.0, "elbow": 997.0, "wrist_roll": 1003.0, "wrist_yaw": 997.0}
LABJACK, STREAMED_LABJACK = (
    serve_voltages(LabJackServer, _labjack),
    serve_voltages(LabJackStreamServer, _labjack_stream),
)
SCANNER = serve_voltages(ScpiServer, _scanner)
TRIALS = (
    DeviceTrial("stream, 1 kHz", "test_rig", 250, 0.1, 10.0, serve_streams({"joint1": STREAM_RATE})),
    DeviceTrial("capaNCDT 3.9 kHz, 1 kHz scans", "test_rig", 1000, 0.1, 10.0, serve_capancdt, keeps_pace=False),
    DeviceTrial("LabJack stream, 1 kHz", "test_rig", 500, 0.1, 10.0, STREAMED_LABJACK),
    DeviceTrial("LabJack asked 250 times per second", "test_rig", 100, 0.1, 20.0, LABJACK, slowness=20.0),
    DeviceTrial("SCPI scanner, 5 Hz", "test_rig", 5, 0.7, 150.0, SCANNER, slowness=200.0),
    DeviceTrial(
        "five streams, full speed",
        "five_axis",
        50,
        0.1,
        20.0,
        serve_streams(FIVE_AXIS_RATES),
        returns=False,
        stamps_matter=True,
    ),
    DeviceTrial(
        "five streams, slow",
        "five_axis",
        50,
        0.1,
        20.0,
        serve_streams(FIVE_AXIS_RATES),
        slowness=20.0,
        returns=False,
    ),
)
