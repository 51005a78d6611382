# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Triggers that a device has lost, and false triggers that it has counted, over real sockets."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from posor.calibration.design_parts import quantity_entry
from posor.numerics.array_types import FloatArray
from posor_drivers.instruments.clock_mapping import ClockLine
from posor_drivers.instruments.device_reader import DeviceReader
from posor_drivers.instruments.stream_device import StreamDevice, StreamSettings
from posor_drivers.instruments.trigger_arrivals import TriggerArrivals
from posor_lab.device_servers.stream_server import LEAD, StreamServer

from .device_states import running, wait_for, wait_for_frames

RATE, PERIOD_NS, TOLERANCE_S = 100, 10_000_000, 2e-3
LATENCY_NS, CYCLE_NS = 50_000_000, 100_000_000_000
LINE = ClockLine(0, 0, 1e7, 0.0, 0.0)


def stream_device(port: int) -> StreamDevice:
    content = {
        "kind": "stream",
        "transport": "tcp",
        "host": "127.0.0.1",
        "port": port,
        "rate": quantity_entry(RATE, "Hz"),
        "format": f"{LEAD}d",
        "fields": ["magic", "counter", "gap1"],
        "channels": {"gap1": {"unit": "s"}},
        "trigger_tolerance": quantity_entry(TOLERANCE_S, "s"),
    }
    return StreamDevice("box", StreamSettings.model_validate(content))


@pytest.fixture
def arrivals() -> TriggerArrivals:
    return TriggerArrivals(stream_device(1), 1e-3)


@pytest.mark.parametrize(
    ("late_ms", "periods"),
    [
        ([0.1, 0.2, 0.1], 0),
        ([15.0, 12.0, 0.3], 0),  # one arrival before the next tick: no trigger was lost until then
        ([15.0, 12.0, 8.9], 0),
        ([15.0, 12.0, 9.1], 1),  # within the tolerance of the next tick
        ([25.0, 20.1, 31.0], 2),
        ([0.1, 0.1, -1.1], -1),  # before its tick
    ],
)
def test_the_least_delay_since_a_frame_shows_how_many_triggers_may_be_lost(
    arrivals: TriggerArrivals, late_ms: list[float], periods: int
) -> None:
    for number, each in enumerate([0.0, *late_ms], start=9):  # the first one is earlier than the frame
        arrivals.add(number, number * PERIOD_NS + round(1e6 * each))
    assert arrivals.lost_periods(10, LINE) == periods
    assert arrivals.early_by_s(LINE) == 0.0
    frame = arrivals.check(10, 0.0, LINE)
    assert frame.is_usable
    assert frame.shift_s == pytest.approx(0.01 * abs(periods))
    assert bool(frame.fault) == bool(periods)


def test_there_is_no_statement_on_a_frame_without_arrivals(arrivals: TriggerArrivals) -> None:
    arrivals.add(9, 9 * PERIOD_NS)
    with pytest.raises(ValueError, match="empty"):
        arrivals.lost_periods(10, LINE)


def test_a_frame_long_before_its_tick_shows_a_false_trigger(arrivals: TriggerArrivals) -> None:
    arrivals.add(10, 91_000_000)
    assert arrivals.early_by_s(LINE) == pytest.approx(9e-3)


def seconds(time_ns: int) -> list[float]:
    return [(time_ns % CYCLE_NS) * 1e-9]


@pytest.fixture
def server() -> Iterator[StreamServer]:
    with StreamServer(seconds, RATE, triggered=True) as server:
        yield server


@pytest.fixture
def reader(server: StreamServer) -> Iterator[DeviceReader]:
    with running(stream_device(server.port)) as reader:
        yield reader


class Ticks:
    """Values at successive ticks: their errors and the stated limits."""

    def __init__(self, reader: DeviceReader) -> None:
        self.reader = reader
        self.tick = (time.time_ns() - LATENCY_NS) // PERIOD_NS
        self.found: list[tuple[float, float]] = []

    def read(self) -> None:
        """Read all ticks that are due."""
        while (self.tick + 1) * PERIOD_NS + LATENCY_NS <= time.time_ns():
            self.tick += 1
            at_ns = self.tick * PERIOD_NS
            values, error = self.reader.values_at(at_ns), self.reader.stamp_error_at(at_ns, [0])
            if values is not None and error is not None:
                self.found.append((values[0] - seconds(at_ns)[0], error.limit_s))

    def read_for(self, count: int) -> FloatArray:
        """Return errors and limits of so many further ticks that have values, (n, 2) [s]."""
        begin = len(self.found)

        def read() -> bool:
            self.read()
            return len(self.found) >= begin + count

        wait_for(read, "ticks with values")
        return np.array(self.found[begin:])


def test_a_lost_trigger_is_part_of_the_error_of_the_stamps_from_its_tick_on(
    server: StreamServer, reader: DeviceReader
) -> None:
    wait_for_frames(reader)
    ticks = Ticks(reader)
    before = ticks.read_for(50)
    assert np.median(before[:, 1]) < 1.1 * TOLERANCE_S
    server.lost_triggers = 1
    after = ticks.read_for(100)
    assert np.all(np.abs(after[:, 0]) <= after[:, 1] + 1e-6)
    assert np.median(after[50:, 0]) == pytest.approx(PERIOD_NS * 1e-9, abs=TOLERANCE_S)
    assert "a trigger may be lost" in reader.state.fault
    at_ns = ticks.tick * PERIOD_NS
    assert reader.values_at(at_ns) is not None  # as another joint of the device asks for them
    assert "a trigger may be lost" in reader.state.fault


def test_a_false_trigger_is_a_fault_at_once_and_the_clock_is_found_again(
    server: StreamServer, reader: DeviceReader
) -> None:
    wait_for_frames(reader)
    ticks = Ticks(reader)
    ticks.read_for(50)
    server.false_trigger = True

    def fault() -> bool:
        ticks.read()
        return "before its tick" in reader.take_state().fault

    wait_for(fault, "the fault of a false trigger")
    again = ticks.read_for(20)
    assert np.all(np.abs(again[:, 0]) <= again[:, 1] + 1e-6)
    errors = np.array(ticks.found)
    assert np.all(np.abs(errors[:, 0]) <= errors[:, 1] + 1e-6)
