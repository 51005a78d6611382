"""Least delay of a server on this host, measured as a user measures a device: by a channel whose motion is known.

The clock of a device cannot show its least delay, so an instruments file states it. A server is late by the time in
which this host wakes a thread; it depends on host and load.
"""

from __future__ import annotations

import time

import numpy as np
from posor.errors import TopicError
from posor.numerics.stamps import NS
from posor_drivers.instruments.device_reader import DeviceReader
from posor_drivers.instruments.stream_device import StreamDevice, StreamSettings

from posor_lab.device_servers.stream_server import LEAD, StreamServer
from posor_lab.instruments.simulated_readings import quantity

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
