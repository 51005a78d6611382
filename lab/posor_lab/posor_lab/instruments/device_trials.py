# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The trials: for each kind of device a server over real sockets, and the instruments file that fits.

``device_trials.yaml`` lists them. The clock of a device cannot show its least delay, so an instruments file states it:
measured on this host as a user measures a device, by a channel whose motion is known.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from posor.errors import TopicError
from posor.numerics.stamps import NS
from posor_drivers.instruments.device_reader import DeviceReader
from posor_drivers.instruments.stream_device import StreamDevice, StreamSettings

from posor_lab.device_servers.capancdt_server import CapaNcdtServer
from posor_lab.device_servers.labjack_server import LabJackServer, LabJackStreamServer
from posor_lab.device_servers.scpi_server import FIRST_CHANNEL, ScpiServer
from posor_lab.device_servers.stream_server import LEAD, MAGIC, StreamServer
from posor_lab.harness.beams import quantity

if TYPE_CHECKING:
    from collections.abc import Mapping
    from contextlib import ExitStack
    from threading import Event

    from posor_lab.instruments.simulated_readings import SimulatedReadings

SECONDS, TIMEOUT_S = 3.0, 10.0
STEP_S, AGE_NS = 0.005, NS // 10
CYCLE_NS = 100 * NS


def measure_least_delay(rate: float) -> float:
    """Return how much the stamps of frames from a server are late [s], at frames per second."""
    with StreamServer(_seconds, rate) as server:
        settings = {
            "kind": "stream",
            "transport": "tcp",
            "host": "127.0.0.1",
            "port": server.port,
            "rate": quantity(rate, "Hz"),
            "format": f"{LEAD}d",
            "fields": ["magic", "counter", "time"],
            "channels": {"time": {"unit": "s"}},
        }
        reader = DeviceReader(StreamDevice("clock", StreamSettings.model_validate(settings)))
        reader.start()
        try:
            return float(np.median(_late_s(reader)))
        finally:
            reader.stop()


def _seconds(time_ns: int) -> list[float]:
    return [time_ns % CYCLE_NS / NS]


def _late_s(reader: DeviceReader) -> list[float]:
    """Return by how much the values are older than the times that they were asked for [s]."""
    late: list[float] = []
    start_s = time.monotonic()
    while len(late) < SECONDS / STEP_S:
        if time.monotonic() - start_s > TIMEOUT_S:
            raise TopicError(f"no frames within {TIMEOUT_S:g} s", where="least delay", expected="a server that sends")
        time.sleep(STEP_S)
        at_ns = time.time_ns() - AGE_NS
        if (values := reader.values_at(at_ns)) is not None:
            late.append(_seconds(at_ns)[0] - float(values[0]))
    return late


Entries = dict[str, dict[str, Any]]
RANGE_M = 5e-4  # measuring range of the capacitive sensors; in it the gap voltages of the test rig lie
SCALE_V_PER_M, OFFSET_V = 4e4, -10.0  # voltage of the simulated probe by distance
STREAM_RATE = 1000.0
FRAME_NS = {"labjack": 900_000, "labjack_stream": 900_000, "scpi": 100_000_000}
"""Time within which the channels of a frame are read, less than from frame to frame [ns]."""
FEEDBACK_OHM = 1e5  # feedback of the amplifiers that turn diode currents into voltages
VOLTAGE_SERVERS: Mapping[str, type[LabJackServer | ScpiServer]] = {
    "labjack": LabJackServer,
    "labjack_stream": LabJackStreamServer,
    "scpi": ScpiServer,
}
_CONTENT = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Devices:
    """Running servers: entries of the instruments file, and how to stop their frames."""

    devices: Entries
    joints: Entries
    stalled: Event


@dataclass(frozen=True)
class DeviceTrial:
    """One trial; ``device_trials.yaml`` explains the fields."""

    name: str
    arm: str
    rate: int
    latency_s: float
    seconds: float
    device: str
    slowness: float = 1.0
    rates: tuple[float, ...] = (STREAM_RATE,)  # frames per second of the streams of the joints in turn
    returns: bool = True
    keeps_pace: bool = True
    stamps_matter: bool = False

    def serve(self, readings: SimulatedReadings, stack: ExitStack) -> Devices:
        """Start the servers until the stack closes."""
        if self.device in VOLTAGE_SERVERS:
            return serve_voltages(self.device, readings, stack)
        if self.device == "stream":
            return serve_streams(self.rates, readings, stack)
        return serve_with_probes(readings, stack)[1]


TRIALS = tuple(DeviceTrial(**{**row, "rates": tuple(row.get("rates", [STREAM_RATE]))}) for row in _CONTENT["trials"])


def _entry(kind: str, **settings: Any) -> dict[str, Any]:
    return {**_CONTENT["devices"][kind], **settings}


def _delay() -> dict[str, Any]:
    return quantity(measure_least_delay(STREAM_RATE), "s")


def _stream(readings: SimulatedReadings, joint: str, server: StreamServer, delay: dict[str, Any], rate: float) -> Any:
    channels = readings.channels[joint]
    return _entry(
        "stream",
        port=server.port,
        rate=quantity(rate, "Hz"),
        delay=delay,
        format=f"{LEAD}{len(channels)}d",
        fields=["magic", "counter", *(channel.name for channel in channels)],
        constants={"magic": MAGIC},
        channels={channel.name: {"unit": channel.unit} for channel in channels},
    )


def _direct(readings: SimulatedReadings, joint: str, device: str) -> Entries:
    return {channel.name: {"channel": f"{device}/{channel.name}"} for channel in readings.channels[joint]}


def serve_streams(rates: tuple[float, ...], readings: SimulatedReadings, stack: ExitStack) -> Devices:
    """Serve one stream for each joint, at frames per second for the joints in turn; clocks differ by 20 ppm."""
    devices, joints, servers, delay = {}, {}, [], _delay()
    for n, joint in enumerate(readings.channels):
        rate = rates[n % len(rates)]
        servers.append(stack.enter_context(StreamServer(partial(readings.at, joint), rate, drift=20e-6 * n)))
        devices[f"box_{joint}"] = _stream(readings, joint, servers[-1], delay, rate)
        joints[joint] = readings.joint_entry(joint, _direct(readings, joint, f"box_{joint}"))
    return Devices(devices, joints, servers[0].stalled)


def serve_with_probes(readings: SimulatedReadings, stack: ExitStack) -> tuple[CapaNcdtServer, Devices]:
    """Serve the gap probes as distances of a capaNCDT at its greatest rate, everything else as a stream.

    Returns the server of the probes, for faults, and all devices.
    """
    delay, (joint,) = _delay(), readings.channels
    gaps = {n: each.name for n, each in enumerate(readings.channels[joint]) if each.kind == "gap_voltages"}

    def distances(time_ns: int) -> list[float]:
        values = readings.at(joint, time_ns)
        return [(values[n] - OFFSET_V) / SCALE_V_PER_M for n in gaps]

    probes = CapaNcdtServer(distances, dict.fromkeys(range(1, len(gaps) + 1), RANGE_M), drift=50e-6)
    probes.packet_frames = 8
    stack.enter_context(probes)
    others = stack.enter_context(StreamServer(partial(readings.at, joint), STREAM_RATE))
    scale = {"scale": quantity(SCALE_V_PER_M, "V/m"), "offset": quantity(OFFSET_V, "V")}
    entries = _direct(readings, joint, "box")
    entries |= {name: {"channel": f"probes/{name}", **scale} for name in gaps.values()}
    channels = {name: {"number": n, "range": quantity(RANGE_M, "m")} for n, name in enumerate(gaps.values(), 1)}
    ports = {"command_port": probes.command_port, "data_port": probes.data_port}
    controller = _entry("capancdt_6200", **ports, delay=delay, channels=channels)
    devices = {"probes": controller, "box": _stream(readings, joint, others, delay, STREAM_RATE)}
    return probes, Devices(devices, {joint: readings.joint_entry(joint, entries)}, probes.stalled)


def serve_voltages(kind: str, readings: SimulatedReadings, stack: ExitStack) -> Devices:
    """Serve all readings with a unit as voltages of one device; light sources are fixed numbers, as in the test rig."""
    (joint,) = readings.channels
    channels, first = readings.channels[joint], readings.at(joint, 0)
    gains = {n: FEEDBACK_OHM if each.unit == "A" else 1.0 for n, each in enumerate(channels) if each.unit != "1"}

    def voltages(time_ns: int) -> list[float]:
        values = readings.at(joint, time_ns, FRAME_NS[kind])
        return [gain * values[n] for n, gain in gains.items()]

    server: Any = VOLTAGE_SERVERS[kind](voltages)
    if kind == "labjack":
        server.registers.interval_s = _CONTENT["devices"][kind]["exposures"]["interval"]["value"]
    stack.enter_context(server)
    entries = _direct(readings, joint, "daq")
    for channel in channels:
        if channel.unit == "A":
            entries[channel.name]["scale"] = quantity(1.0 / FEEDBACK_OHM, "A/V")
    entry = readings.joint_entry(joint, entries)
    entry["lit_sources"] = [round(first[n]) for n, channel in enumerate(channels) if channel.kind == "lit_sources"]
    del entry["home_mark"]
    names = [channels[n].name for n in gains]
    if kind == "scpi":
        inputs = {name: {"number": FIRST_CHANNEL + n, "unit": "V"} for n, name in enumerate(names)}
        daq = _entry(kind, address=f"TCPIP::127.0.0.1::{server.port}::SOCKET", channels=inputs)
    else:
        daq = _entry(kind, port=server.port, channels={name: {"input": n} for n, name in enumerate(names)})
    if kind == "labjack_stream":
        daq |= {"stream_port": server.stream_port, "delay": _delay()}
    return Devices({"daq": daq}, {joint: entry}, server.stalled)
