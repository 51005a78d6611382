# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Device ``capancdt_6200`` over real sockets, against a counterpart of the controller with faults on demand."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
import pytest
from posor.calibration.file_model import first_problem
from posor_drivers.instruments.capancdt_device import CapaNcdtDevice, CapaNcdtSettings
from posor_drivers.instruments.device import DeviceError, Frames
from posor_lab.device_servers.capancdt_server import FULL_SCALE, HEADER_BYTES, CapaNcdtServer
from pydantic import ValidationError

from .device_states import running, wait_for_frames, wait_for_reported_fault

TIMEOUT_S = 5.0
RANGES = {1: 0.5e-3, 3: 2e-3, 4: 1e-3}
LAST = (1 << 32) - 1


def distances(time_ns: int) -> tuple[float, float, float]:
    """Distances that change by many LSB from frame to frame, each in its own way."""
    seconds = (time_ns % 1_000_000_000_000) * 1e-9
    return (
        0.25e-3 + 0.2e-3 * math.sin(300.0 * seconds),
        1e-3 + 0.9e-3 * math.cos(200.0 * seconds),
        0.5e-3 + 0.4e-3 * math.sin(100.0 * seconds),
    )


def settings(server: CapaNcdtServer | None = None, **changes: Any) -> CapaNcdtSettings:
    """Return settings with channel 3 before channel 1, and without channel 4."""
    ports = {} if server is None else {"command_port": server.command_port, "data_port": server.data_port}
    content = {
        "kind": "capancdt_6200",
        "host": "127.0.0.1",
        "rate": {"value": 3906.25, "unit": "Hz"},
        "channels": {
            "wide": {"number": 3, "range": {"value": 2, "unit": "mm"}},
            "narrow": {"number": 1, "range": {"value": 500, "unit": "um"}},
        },
    }
    return CapaNcdtSettings.model_validate(content | ports | changes)


@contextmanager
def connected(server: CapaNcdtServer, **changes: Any) -> Iterator[CapaNcdtDevice]:
    device = CapaNcdtDevice("probes", settings(server, **changes))
    try:
        device.connect(TIMEOUT_S)
        yield device
    finally:
        device.close()


@pytest.fixture
def server() -> Iterator[CapaNcdtServer]:
    with CapaNcdtServer(distances, RANGES) as server:
        yield server


def read(device: CapaNcdtDevice, frames: int = 1) -> Frames:
    parts: list[Frames] = []
    while sum(len(part.counters) for part in parts) < frames:
        part = device.read(TIMEOUT_S)
        assert part is not None
        parts.append(part)
    return Frames(np.concatenate([p.counters for p in parts]), np.concatenate([p.values for p in parts]))


def check_values(server: CapaNcdtServer, frames: Frames, first: int = 0) -> None:
    """Check that each frame has the distances of its time to half an LSB."""
    for counter, values in zip(frames.counters, frames.values, strict=True):
        narrow, wide, _ = distances(server.exposed_ns(int(counter) - first))
        assert values[0] == pytest.approx(wide, rel=0.0, abs=0.501 * RANGES[3] / FULL_SCALE)
        assert values[1] == pytest.approx(narrow, rel=0.0, abs=0.501 * RANGES[1] / FULL_SCALE)


def check_all(server: CapaNcdtServer, frames: Frames, first: int = 0) -> None:
    np.testing.assert_array_equal(np.diff(frames.counters), 1)
    check_values(server, frames, first)


def read_to_gap(device: CapaNcdtDevice, frames: Frames) -> Frames:
    """Return the given frames and those that follow, up to lost frames and some more."""
    deadline_s = time.monotonic() + TIMEOUT_S
    while np.diff(frames.counters).max() == 1:
        assert time.monotonic() < deadline_s, "no frames are lost"
        more = read(device)
        counters = np.append(frames.counters, more.counters)
        frames = Frames(counters, np.vstack((frames.values, more.values)))
    return frames


def error_of(device: CapaNcdtDevice) -> str:
    deadline_s = time.monotonic() + TIMEOUT_S
    with pytest.raises(DeviceError) as caught:  # noqa: PT012  frames may come before it
        while device.read(TIMEOUT_S) is not None:
            assert time.monotonic() < deadline_s, "no error"
    return str(caught.value)


def test_what_is_known_without_a_connection() -> None:
    device = CapaNcdtDevice("probes", settings(rate={"value": 1041.7, "unit": "Hz"}))
    assert [(each.name, each.unit) for each in device.channels] == [("wide", "m"), ("narrow", "m")]
    assert device.frame_rate == pytest.approx(1e6 / 960)
    assert device.address == "127.0.0.1:10001"
    device.close()


def test_values_of_all_frames(server: CapaNcdtServer) -> None:
    with connected(server) as device:
        frames = read(device, 200)
    assert frames.counters[0] == 0
    assert frames.counters.dtype == np.int64
    assert frames.values.shape == (len(frames.counters), 2)
    check_all(server, frames)


def test_connection_sets_up_the_controller(server: CapaNcdtServer) -> None:
    assert server.trigger_mode == 1
    device = CapaNcdtDevice("probes", settings(server))
    assert device.connect(TIMEOUT_S) == "DT6200 V1.2a 8010079"
    assert (server.trigger_mode, server.sample_time_us) == (0, 256)
    device.close()


def test_version_may_end_with_ok_and_a_line_of_the_command_alone_is_an_echo(server: CapaNcdtServer) -> None:
    server.answers |= {"VER": "DT6220;V2.0OK", "CHS": "\r\n$CHS1,0,1,1OK"}
    device = CapaNcdtDevice("probes", settings(server))
    assert device.connect(TIMEOUT_S) == "DT6220 V2.0"
    check_all(server, read(device))
    device.close()


@pytest.mark.parametrize("preamble", [b"MEAS", b"SAEM"])
@pytest.mark.parametrize("frames_first", [False, True])
@pytest.mark.parametrize("packet_frames", [1, 12, 100])  # a frame has 12 bytes
def test_both_byte_orders_of_the_header(
    server: CapaNcdtServer, preamble: bytes, packet_frames: int, *, frames_first: bool
) -> None:
    server.preamble, server.frames_first, server.packet_frames = preamble, frames_first, packet_frames
    with connected(server) as device:
        check_all(server, read(device, 2 * packet_frames))


@pytest.mark.parametrize(
    "split_at", [1, 4, HEADER_BYTES - 1, HEADER_BYTES, HEADER_BYTES + 7, HEADER_BYTES + 12 * 6 + 2]
)
def test_split_packet(server: CapaNcdtServer, split_at: int) -> None:
    server.packet_frames, server.split_at = 8, split_at
    with connected(server) as device:
        assert server.split.wait(TIMEOUT_S)
        assert device.read(0.01) is None
        server.released.set()
        check_all(server, read(device, 24))


def test_merged_packets_with_a_part_of_the_next(server: CapaNcdtServer) -> None:
    packet_bytes = HEADER_BYTES + 4 * 12
    server.merged, server.split_at = 3, 2 * packet_bytes + 9
    with connected(server) as device:
        assert server.split.wait(TIMEOUT_S)
        whole = read(device)
        assert len(whole.counters) == 8
        assert device.read(0.0) is None
        server.released.set()
        rest = read(device)
        check_all(server, Frames(np.append(whole.counters, rest.counters), np.vstack((whole.values, rest.values))))


def test_lost_frames_leave_a_gap(server: CapaNcdtServer) -> None:
    with connected(server) as device:
        frames = read(device)
        server.skip = 37
        frames = read_to_gap(device, frames)
    assert np.diff(frames.counters).max() >= 38
    check_values(server, frames)


def test_counter_wraps(server: CapaNcdtServer) -> None:
    server.first = LAST - 9
    with connected(server) as device:
        frames = read(device, 40)
    assert frames.counters[0] == LAST - 9
    check_all(server, frames, first=server.first)


def test_frames_lost_while_the_counter_wraps(server: CapaNcdtServer) -> None:
    server.first = LAST - 3
    with connected(server, rate={"value": 1e6 / 9600, "unit": "Hz"}) as device:
        frames = read(device, 4)  # the next packet comes after 38 ms
        server.skip = 5
        frames = read_to_gap(device, frames)
    assert frames.counters[0] == LAST - 3
    assert frames.counters[-1] > LAST + 5
    check_values(server, frames, first=server.first)


@pytest.mark.parametrize("first", [1000, 3_000_000_000])
def test_counter_goes_back(server: CapaNcdtServer, first: int) -> None:
    server.first = first
    with running(CapaNcdtDevice("probes", settings(server))) as reader:
        wait_for_frames(reader)
        server.restart_counter()
        wait_for_reported_fault(reader, "probes: the frame counter went back from ")
        wait_for_frames(reader)


LENGTHS = "a packet states 8 and 4 as number of frames and bytes per frame"


@pytest.mark.parametrize(
    ("attribute", "value", "sentence"),
    [
        ("preamble", b"MEAX", "a packet begins with b'MEAX'; expected 'MEAS' or 'SAEM'."),
        ("_frame", lambda _: bytes(8), f"{LENGTHS}; expected 12 bytes per frame of 3 channels, and a frame or more."),
    ],
)
def test_invalid_packet(server: CapaNcdtServer, attribute: str, value: object, sentence: str) -> None:
    setattr(server, attribute, value)
    with connected(server) as device:
        assert error_of(device) == f"probes: {sentence}"


def test_packet_without_a_channel() -> None:
    with CapaNcdtServer(lambda _: (0.0, 0.0), {1: 1.0, 2: 1.0}) as server:
        server.states = [1, 1, 1, 0]
        with connected(server) as device:
            sentence = "probes: a packet has no channel 3, only [1, 2]; expected the channels of the settings."
            assert error_of(device) == sentence


@pytest.mark.parametrize(("distance", "valid"), [(0.0, True), (1.999e-3, True), (2e-3, False), (math.nan, False)])
def test_values_out_of_range_are_nan(distance: float, *, valid: bool) -> None:
    with CapaNcdtServer(lambda _: (1e-4, distance, 0.0), RANGES) as server, connected(server) as device:
        values = read(device).values
    assert np.all(values[:, 0] == pytest.approx(distance, abs=2e-10)) if valid else np.all(np.isnan(values[:, 0]))
    assert values[:, 1] == pytest.approx(1e-4, abs=1e-10)


def test_closed_connection_and_the_next_one(server: CapaNcdtServer) -> None:
    with connected(server) as device:
        read(device)
        server.drop_client()
        expected = f"probes: 127.0.0.1:{server.data_port} has closed the connection; expected an open connection."
        assert error_of(device) == expected
        device.close()
        device.connect(TIMEOUT_S)
        frames = read(device, 8)
        assert frames.counters[0] == 0
        check_all(server, frames)


def test_reading_needs_a_connection(server: CapaNcdtServer) -> None:
    with pytest.raises(DeviceError, match="probes: no connection; expected a call of connect before"):
        CapaNcdtDevice("probes", settings(server)).read(0.0)


VERSION = "expected '$VERDT62' and the version."
STATES = "expected '$CHS', the state of each channel, 'OK'."
AVERAGING = "expected averaging off ('$AVT0'); a driver has conditioning.samples."
ANSWER = "expected '$STI256,', a sample time, 'OK'."
SAMPLE_TIME = "expected a rate that the controller has; in Hz, 1e6 divided by the sample time."


CONTROLLERS: list[tuple[dict[str, str], list[int], float, str]] = [
    ({"VER": "DT3100;V1.0;1"}, [], 3906.25, f"the answer to '$VER' is '$VERDT3100;V1.0;1'; {VERSION}"),
    ({"VER": "$UNKNOWN COMMAND"}, [], 3906.25, f"the answer to '$VER' is '$UNKNOWN COMMAND'; {VERSION}"),
    ({"CHS": "OK"}, [], 3906.25, f"the answer to '$CHS' is '$CHSOK'; {STATES}"),
    ({"TRG": "$WRONG PARAMETER"}, [], 3906.25, "the answer to '$TRG0' is '$WRONG PARAMETER'; expected '$TRG0OK'."),
    (
        {"AVT": "1OK"},
        [],
        3906.25,
        f"the controller averages ('$AVT1'): its readings are older than their stamps; {AVERAGING}",
    ),
    ({"STI": ",xOK"}, [], 3906.25, f"the answer to '$STI256' is '$STI256,xOK'; {ANSWER}"),
    ({}, [1, 0, 0, 1], 3906.25, "channel 3, 'wide', has no module; expected one of 1, 4."),
    ({}, [1, 1], 3906.25, "channel 3, 'wide', has no module; expected one of 1, 2."),
    ({}, [0, 0, 0, 0], 3906.25, "channel 3, 'wide', has no module; expected one of no channels."),
    ({}, [1, 0, 2, 1], 3906.25, "channel 3, 'wide', has the state 2, which is no sensor; expected one of 1, 4."),
    ({}, [], 1000, f"the controller has no sample time of 1000 us, the next one is 960 us; {SAMPLE_TIME}"),
]


@pytest.mark.parametrize(("answers", "states", "rate_hz", "message"), CONTROLLERS)
def test_unsuitable_controller_is_refused(
    server: CapaNcdtServer, answers: dict[str, str], states: list[int], rate_hz: float, message: str
) -> None:
    server.answers |= answers
    server.states = states or server.states
    with pytest.raises(DeviceError) as caught, connected(server, rate={"value": rate_hz, "unit": "Hz"}):
        pass
    assert str(caught.value) == f"probes: {message}"


def test_no_answer_within_the_time(server: CapaNcdtServer) -> None:
    server.answers["CHS"] = None
    device = CapaNcdtDevice("probes", settings(server))
    started_s = time.monotonic()
    with pytest.raises(DeviceError, match=r"probes: no answer to '\$CHS' in time; expected '\$CHS', the state"):
        device.connect(0.2)
    assert 0.19 < time.monotonic() - started_s < 1.0


def test_a_packet_that_is_never_whole_is_named(server: CapaNcdtServer) -> None:
    server.split_at = 9
    with running(CapaNcdtDevice("probes", settings(server))) as reader:
        wait_for_reported_fault(reader, ", but 9 bytes of an incomplete packet; expected ")
        server.released.set()


@pytest.mark.parametrize("port", ["command_port", "data_port"])
def test_closed_port_and_unknown_host_are_named(server: CapaNcdtServer, port: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as closed:
        number = closed.getsockname()[1]
    for changes, place in (
        ({port: number}, f"127.0.0.1:{number}: "),
        ({"host": "no.such.host.invalid"}, "no.such.host.invalid"),
    ):
        device = CapaNcdtDevice("probes", settings(server, **changes))
        with pytest.raises(DeviceError, match=f"probes: no connection to {place}"):
            device.connect(TIMEOUT_S)


def test_connection_times_out(server: CapaNcdtServer) -> None:
    with ExitStack() as stack:
        busy = stack.enter_context(socket.socket())
        busy.bind(("127.0.0.1", 0))
        busy.listen(0)
        for _ in range(4):  # fills the queue of connections that nobody accepts
            waiting = stack.enter_context(socket.socket())
            waiting.setblocking(False)  # noqa: FBT003
            waiting.connect_ex(busy.getsockname())
        device = CapaNcdtDevice("probes", settings(server, command_port=busy.getsockname()[1]))
        with pytest.raises(DeviceError, match=r"no connection to 127.0.0.1:\d+ within 0.2 s; expected a device that"):
            device.connect(0.2)


def channel(number: int, value: float = 1e-3, unit: str = "m") -> dict[str, Any]:
    return {"number": number, "range": {"value": value, "unit": unit}}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rate": {"value": 4000, "unit": "Hz"}}, "rate 4000 Hz"),
        ({"rate": {"value": 2.4, "unit": "Hz"}}, "rate 2.4 Hz"),
        ({"rate": {"value": 1000, "unit": "kHz"}}, "unit 'kHz'"),
        ({"rate": 1000}, "1000 has no unit"),
        ({"channels": {}}, "has 0 entries"),
        ({"channels": {"a": channel(5)}}, "5"),
        ({"channels": {"a": channel(0)}}, "0"),
        ({"channels": {"a": channel(1, 0)}}, "0.0 m"),
        ({"channels": {"a": channel(1, 1, "V")}}, "unit 'V'"),
        ({"channels": {"a": channel(1), "b": channel(1)}}, "number 1, used twice"),
        ({"data_port": 0}, "0"),
        ({"command_port": 65_536}, "65536"),
        ({"port": 23}, "unknown key 'port'"),
    ],
)
def test_refused_settings(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError) as caught:
        settings(**changes)
    assert first_problem(caught.value).what == message
