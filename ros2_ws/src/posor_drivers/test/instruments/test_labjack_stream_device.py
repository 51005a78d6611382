# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Device ``labjack_stream`` over real sockets: a Modbus server of another code base and the stream of a T7."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from posor_drivers.instruments.device import DeviceError
from posor_drivers.instruments.device_reader import DeviceReader
from posor_drivers.instruments.labjack_stream_device import (
    HEADER,
    HIGHEST_SAMPLE,
    LENGTH_WITHOUT_SAMPLES,
    RECOVERED,
    RECOVERING,
    LabJackStreamDevice,
    LabJackStreamSettings,
)
from posor_lab.device_servers.labjack_server import LabJackStreamServer

from .device_states import running, wait_for, wait_for_frames, wait_for_reported_fault

STEP_V = 3.2e-4  # a little more than a step of the converter at 10 V


def ramps(time_ns: int) -> list[float]:
    """Voltages of input 0, 1, 2: a ramp of 2 s, its negative tenth, a constant."""
    seconds = time_ns % 2_000_000_000 * 1e-9
    return [4.0 * seconds - 4.0, 0.4 - 0.4 * seconds, 0.05]


def settings(server: LabJackStreamServer, **changes: Any) -> LabJackStreamSettings:
    content = {
        "kind": "labjack_stream",
        "host": "127.0.0.1",
        "port": server.port,
        "stream_port": server.stream_port,
        "rate": {"value": 1000, "unit": "Hz"},
        "channels": {
            "third": {"input": 2, "range": {"value": 0.1, "unit": "V"}},
            "first": {"input": 0},
            "second": {"input": 1, "range": {"value": 1, "unit": "V"}, "negative_input": 199},
        },
    }
    return LabJackStreamSettings.model_validate(content | changes)


@pytest.fixture
def server() -> Iterator[LabJackStreamServer]:
    with LabJackStreamServer(ramps, drift=30e-6) as server:
        yield server


@pytest.fixture
def reader(server: LabJackStreamServer) -> Iterator[DeviceReader]:
    with running(LabJackStreamDevice("box", settings(server))) as reader:
        yield reader


def test_values_are_the_voltages_of_their_time(server: LabJackStreamServer, reader: DeviceReader) -> None:
    wait_for_frames(reader)
    assert reader.state.text == "LabJack T7, firmware 1.0292"
    errors = []

    def take() -> bool:
        at_ns = time.time_ns() - 100_000_000
        if (values := reader.values_at(at_ns)) is not None and 0.1 < at_ns % 2_000_000_000 * 1e-9 < 1.9:
            errors.append(values - np.array(ramps(at_ns))[[2, 0, 1]])
        return len(errors) >= 50

    wait_for(take, "50 values")
    late_s = np.abs(np.array(errors)[:, 1]) / 4.0
    assert np.median(late_s) < 1e-3  # a loaded host delays every packet
    assert np.abs(np.array(errors)[:, 0]).max() < STEP_V / 100.0
    assert server.registers.written[41_001] == 199
    assert 41_000 not in server.registers.written
    assert reader.state.values["frames_lost"] == 0


def test_the_stream_is_stopped_at_the_end_and_one_that_still_runs_at_the_begin(server: LabJackStreamServer) -> None:
    device = LabJackStreamDevice("box", settings(server))
    server.registers.set_holding_registers(4990, [0, 1])
    device.connect(1.0)
    wait_for(lambda: device.read(0.1), "frames")
    assert server.written_number(4990) == 1
    device.close()
    assert server.written_number(4990) == 0


def become_t4(server: LabJackStreamServer) -> None:
    """Let the reader connect again, to another product."""
    server.registers.product, server.skip_packet = 4.0, True


FAULTS: dict[str, tuple[Callable[[LabJackStreamServer], None], str]] = {
    "packet number": (lambda s: setattr(s, "skip_packet", True), "expected packets without a gap"),
    "overlap": (lambda s: setattr(s, "status", (2942, 0)), "box: the stream has status 2942; expected 0"),
    "stall": (lambda s: s.stalled.set(), "box: no frame for 0.3"),
    "product": (become_t4, "box: the product is 4; expected 7 (LabJack T7)."),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named_and_the_stream_read_again(
    server: LabJackStreamServer, reader: DeviceReader, name: str
) -> None:
    wait_for_frames(reader)
    begin, sentence = FAULTS[name]
    begin(server)
    wait_for_reported_fault(reader, sentence)
    server.stalled.clear()
    server.registers.product = 7.0
    wait_for_frames(reader)


def test_scans_that_the_device_left_out_are_counted(server: LabJackStreamServer, reader: DeviceReader) -> None:
    wait_for_frames(reader)
    server.status = (2941, 17)
    wait_for(lambda: reader.state.values["frames_lost"] == 17, "lost frames")
    assert reader.state.fault == ""


def test_frames_around_a_delimiter_keep_their_numbers(server: LabJackStreamServer, reader: DeviceReader) -> None:
    wait_for_frames(reader)
    server.leave_out = 150
    wait_for(lambda: reader.state.values["frames_lost"] == 150, "lost frames")
    end_ns = time.time_ns() + 100_000_000
    wait_for(lambda: reader.values_at(end_ns) is not None, "frames after the gap")
    ticks = np.arange(end_ns - 600_000_000, end_ns, 1_000_000).tolist()
    found = {tick: reader.values_at(tick) for tick in ticks if 0.1 < tick % 2_000_000_000 * 1e-9 < 1.9}
    errors = [abs(values[1] - ramps(tick)[0]) for tick, values in found.items() if values is not None]
    assert max(errors) < 0.05  # 10 ms of the ramp
    assert reader.take_state().fault == ""


@pytest.mark.parametrize(
    ("rows", "information", "numbers"),
    [
        ([8, 9, None, 1010], 1000, [8, 9, 1010]),
        ([None, 1008, 1009], 1000, [1008, 1009]),
        ([8, None], 5, [8]),
        ([1008, 1009], 1000, [1008, 1009]),
        ([8, None, 9, None, 15], 4, [8, 15]),  # one of them is a frame at the end of the converter
    ],
)
def test_a_packet_with_a_delimiter(rows: list[int | None], information: int, numbers: list[int]) -> None:
    device = LabJackStreamDevice("box", settings(LabJackStreamServer(ramps)))
    device._constants[:] = [1.0, -1.0, 0.0, 0.0]
    device._next = 8
    samples = np.array([3 * [HIGHEST_SAMPLE if row is None else row] for row in rows], ">u2").tobytes()
    device.received = HEADER.pack(0, 0, LENGTH_WITHOUT_SAMPLES + len(samples), 1, 76, 16, 0, RECOVERED, information)
    device.received += samples
    frames = device.take_packet()
    assert frames is not None
    assert frames.counters.tolist() == numbers
    assert frames.values[:, 0].tolist() == numbers
    assert device._next == 8 + information + len(rows) - (None in rows)


def test_a_delimiter_at_the_end_of_the_packet_before() -> None:
    device = LabJackStreamDevice("box", settings(LabJackStreamServer(ramps)))
    device._constants[:] = [1.0, -1.0, 0.0, 0.0]
    packets = [(RECOVERING, 0, [0, 1, HIGHEST_SAMPLE]), (RECOVERED, 1000, [1002, 1003]), (0, 0, [1004, 1005])]
    for number, (status, information, rows) in enumerate(packets):
        samples = np.repeat(np.array(rows, ">u2"), 3).tobytes()
        device.received += HEADER.pack(
            number, 0, LENGTH_WITHOUT_SAMPLES + len(samples), 1, 76, 16, 0, status, information
        )
        device.received += samples
    found = list(iter(device.take_packet, None))
    assert np.concatenate([each.counters for each in found]).tolist() == [0, 1, 2, 1002, 1003, 1004, 1005]
    assert np.isnan(found[0].values[2]).all()


def test_a_value_at_an_end_of_the_converter_is_invalid(server: LabJackStreamServer, reader: DeviceReader) -> None:
    wait_for_frames(reader)
    server.registers.voltages = lambda _time_ns: [11.0, -1.2, 0.05]

    def at_ends() -> bool:
        values = reader.newest_values()
        return values is not None and bool(np.isnan(values[1:]).all())

    wait_for(at_ends, "invalid values")


def test_a_range_that_does_not_exist_is_refused(server: LabJackStreamServer) -> None:
    channels = {"a": {"input": 0, "range": {"value": 5, "unit": "V"}}}
    device = LabJackStreamDevice("box", settings(server, channels=channels))
    with pytest.raises(DeviceError, match=r"a range of 5 V; expected 10, 1, 0.1, 0.01"):
        device.connect(1.0)
    device.close()
