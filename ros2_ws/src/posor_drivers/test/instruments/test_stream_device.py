# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Device ``stream`` and the reader of a device, over real sockets."""

from __future__ import annotations

import re
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
import pytest
from posor_drivers.instruments.device import DeviceError
from posor_drivers.instruments.device_reader import DeviceReader
from posor_drivers.instruments.shared_readers import shared_reader
from posor_drivers.instruments.stream_device import StreamDevice, StreamSettings
from posor_lab.device_servers.stream_server import LEAD, StreamServer
from pydantic import ValidationError

from .device_states import running, wait_for, wait_for_fault, wait_for_frames, wait_for_reported_fault, wait_for_values


def settings(port: int, **changes: Any) -> StreamSettings:
    content = {
        "kind": "stream",
        "transport": "tcp",
        "host": "127.0.0.1",
        "port": port,
        "rate": {"value": 1000, "unit": "Hz"},
        "format": f"{LEAD}2d",
        "fields": ["magic", "counter", "gap1", "gap2"],
        "constants": {"magic": 0xAA55},
        "channels": {"gap1": {"unit": "V", "scale": 2.0}, "gap2": {"unit": "m"}},
    }
    return StreamSettings.model_validate(content | changes)


def slow_sine(time_ns: int) -> tuple[float, float]:
    """Values that change by up to 6.3 per second; the second is the time itself [s]."""
    seconds = (time_ns % 1_000_000_000_000) * 1e-9
    return float(np.sin(2.0 * np.pi * seconds)), seconds


def source_number(time_ns: int) -> tuple[float, float]:
    """The time [s], and a whole number that changes 20 times per second."""
    seconds = (time_ns % 1_000_000_000_000) * 1e-9
    return seconds, float(int(20.0 * seconds) % 100)


@pytest.fixture
def server() -> Iterator[StreamServer]:
    with StreamServer(slow_sine) as server:
        yield server


@pytest.fixture
def reader(server: StreamServer) -> Iterator[DeviceReader]:
    with running(StreamDevice("box", settings(server.port))) as reader:
        yield reader


def test_values_are_interpolated_at_a_ros_time(reader: DeviceReader) -> None:
    wait_for_frames(reader)
    differences = []

    def take() -> bool:
        at_ns = time.time_ns() - 50_000_000
        if (values := reader.values_at(at_ns)) is not None:
            differences.append((values[0] / 2.0 - slow_sine(at_ns)[0], values[1] - slow_sine(at_ns)[1]))
        return len(differences) >= 30

    wait_for(take, "30 values")
    late_s = np.array(differences)[:, 1]
    assert np.abs(late_s).max() < 5e-3  # a loaded host delays every arrival
    assert np.abs(np.array(differences)[:, 0]).max() < 2.0 * np.pi * np.abs(late_s).max() + 1e-4
    assert reader.state.values["frames_lost"] == 0


def test_free_running_devices_have_values_at_common_times() -> None:
    """997 and 1003 frames per second: the interpolated sines agree within the bound a T^2 / 8 and their stamps."""
    with StreamServer(slow_sine, 997.0) as slow, StreamServer(slow_sine, 1003.0) as fast:
        pairs: list[Any] = []
        settings_of = {
            rate: settings(server.port, rate={"value": rate, "unit": "Hz"})
            for rate, server in ((997, slow), (1003, fast))
        }

        def take() -> bool:
            tick_ns = time.time_ns() // 5_000_000 * 5_000_000 - 50_000_000
            values = [reader.values_at(tick_ns) for reader in (one, other)]
            if values[0] is not None and values[1] is not None:
                pairs.append(np.concatenate([*values]))
            return len(pairs) >= 100

        one_box, other_box = (StreamDevice("box", each) for each in settings_of.values())
        with running(one_box) as one, running(other_box) as other:
            wait_for(take, "100 common values")
    sine_a, time_a, sine_b, time_b = (np.array(pairs) / (2.0, 1.0, 2.0, 1.0)).T
    bound = 2.0 * (2.0 * np.pi / 997.0) ** 2 / 8.0
    assert np.all(np.abs(sine_a - sine_b) <= bound + 2.0 * np.pi * np.abs(time_a - time_b) + 1e-9)
    print(f"stamps of two devices differ by {1e6 * np.sqrt(np.mean((time_a - time_b) ** 2)):.1f} us rms")
    assert np.abs(time_a - time_b).max() < 5e-3  # a loaded host delays every arrival


def test_counter_that_wraps_goes_on(server: StreamServer, reader: DeviceReader) -> None:
    wait_for_frames(reader)
    server.first = (1 << 32) - 700
    server.drop_client()
    wait_for(lambda: server.clients == 2 and reader.state.values["frames"] > 3000, "frames after the wrap")
    wait_for_frames(reader)
    assert reader.state.values["frames_lost"] == 0
    assert reader.state.values["connections"] == 2


def test_merged_and_lost_frames_are_counted_and_never_bridged(server: StreamServer, reader: DeviceReader) -> None:
    wait_for_frames(reader)
    server.merged = 7
    server.skip = 40
    wait_for(lambda: reader.state.values["frames_lost"] == 40, "lost frames")
    now_ns = time.time_ns()
    wait_for(lambda: reader.values_at(now_ns + 50_000_000) is not None, "frames after the lost ones")
    missing = [reader.values_at(now_ns + n * 1_000_000) is None for n in range(-200, 51)]
    assert sum(missing) in {41, 42, 43}  # a millisecond more at each end, where the nearest frame has one neighbour


FAULTS: dict[str, tuple[Callable[[StreamServer], None], Callable[[StreamServer], None], str]] = {
    "stall": (lambda s: s.stalled.set(), lambda s: s.stalled.clear(), "box: no frame for 0.3"),
    "closed": (lambda s: s.drop_client(), lambda _: None, "has closed the connection"),
    "corrupted": (
        lambda s: setattr(s, "magic", 0x1234),
        lambda s: setattr(s, "magic", 0xAA55),
        "box: 'magic' is 4660 in a frame; expected 43605",
    ),
    "counter a little back": (
        lambda s: setattr(s, "first", s.first - 100),
        lambda s: setattr(s, "first", 0),
        "box: the frame counter went back from",
    ),
    "counter back": (
        lambda s: setattr(s, "first", -5000 + s.first),
        lambda s: setattr(s, "first", 0),
        "box: the frame counter went back from",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_fault_is_named_at_once_and_the_device_read_again(
    server: StreamServer, reader: DeviceReader, name: str
) -> None:
    begin, end, sentence = FAULTS[name]
    server.first = 100_000
    wait_for_frames(reader)
    connections = reader.state.values["connections"]
    begin(server)
    begun_s = time.monotonic()
    wait_for_fault(reader)
    found = reader.state.fault
    named_s = time.monotonic() - begun_s
    end(server)
    ended_s = time.monotonic()
    wait_for(lambda: reader.state.values["connections"] > connections, "connection")
    connected_s = time.monotonic() - ended_s
    wait_for_frames(reader)
    print(f"{name}: named after {named_s:.2f} s, connected {connected_s:.2f} s after the end: {found}")
    assert sentence in found
    assert sentence in reader.take_state().fault  # a fault that has passed between two reports is reported once
    assert not reader.take_state().fault


def test_absent_device_is_named_and_read_when_it_comes() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with running(StreamDevice("box", settings(port))) as reader:
        wait_for_reported_fault(reader, f"box: no connection to 127.0.0.1:{port}")
        assert reader.values_at(time.time_ns()) is None


class LockWithPauseAfterError:
    """A lock whose users pause after an exception, so that other threads can see the state."""

    def __init__(self) -> None:
        self._lock = Lock()

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._lock.release()
        if kind is not None:
            time.sleep(0.1)


def test_another_rate_than_stated_is_a_fault_before_any_frame_is_used(
    server: StreamServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posor_drivers.instruments.device_reader.Lock", LockWithPauseAfterError)
    with running(StreamDevice("box", settings(server.port, rate={"value": 900, "unit": "Hz"}))) as reader:
        found = []

        def read() -> bool:
            values = reader.values_at(time.time_ns() - 50_000_000)
            found.append((reader.state.fault, values))
            return found[-1][0].endswith("frames per second; expected 900, as stated.")

        wait_for(read, "fault of the rate")
    assert all(fault and values is None for fault, values in found)


DISORDER = {  # frames that are sent before the late one; what is counted
    "exchanged": (1, {"frames_late": 1}),
    "late": (100, {"frames_late": 1}),
    "too late": (1500, {"frames_dropped": 1, "frames_lost": 1}),
    "repeated": (-1, {"frames_repeated": 1}),
    "repeated late": (-300, {"frames_repeated": 1}),
}


@pytest.mark.parametrize("first", [0, (1 << 32) - 2000], ids=["low", "wraps"])
@pytest.mark.parametrize("name", DISORDER)
def test_datagrams_out_of_order_interrupt_nothing(name: str, first: int) -> None:
    hold, counted = DISORDER[name]
    port = free_udp_port()
    device = StreamDevice("box", settings(port, transport="udp"))
    with StreamServer(slow_sine, udp_port=port) as server, running(device) as reader:
        server.first = first
        wait_for_frames(reader)
        reader.take_state()
        before = reader.state.values
        server.hold = hold
        wait_for(lambda: all(reader.state.values[key] > before[key] for key in counted), "the late frame")
        wait_for(lambda: reader.state.values["frames"] > before["frames"] + 2000, "frames after the late one")
        state = reader.take_state()
        end_ns = wait_for_values(reader)
        missing = [reader.values_at(end_ns - n * 1_000_000) is None for n in range(2000)]
        assert sum(missing) <= (3 if "frames_lost" in counted else 0)
    assert state.fault == ""
    keys = ("frames_lost", "frames_late", "frames_dropped", "frames_repeated", "connections")
    assert {key: state.values[key] - before[key] for key in keys} == dict.fromkeys(keys, 0) | counted


def free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port: int = free.getsockname()[1]
    return port


def test_datagrams_wait_while_the_reader_does_not_run() -> None:
    port, sent = free_udp_port(), 500
    device = StreamDevice("box", settings(port, transport="udp"))
    device.connect(1.0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for counter in range(sent):
            sender.sendto(struct.pack(f"{LEAD}2d", 0xAA55, counter, 1.0, 2.0), ("127.0.0.1", port))
    frames = device.read(1.0)
    device.close()
    assert frames is not None
    assert frames.counters.tolist() == list(range(sent))


def test_datagrams_of_two_senders_are_a_fault() -> None:
    port = free_udp_port()
    with running(StreamDevice("box", settings(port, transport="udp"))) as reader, ExitStack() as stack:
        boxes = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2)]
        sent, place = count(), r"127\.0\.0\.1 port \d+"

        def is_named() -> bool:
            for number, box in enumerate(boxes):
                box.sendto(struct.pack(f"{LEAD}2d", 0xAA55, next(sent), number, number), ("127.0.0.1", port))
            sentence = rf"box: datagrams of {place} and {place}; expected one sender at this port\."
            return bool(re.fullmatch(sentence, reader.state.fault))

        wait_for(is_named, "the senders")


def test_two_frames_of_one_number_contradict_each_other() -> None:
    port = free_udp_port()
    with (
        running(StreamDevice("box", settings(port, transport="udp"))) as reader,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box,
    ):
        values = count()

        def is_named() -> bool:
            box.sendto(struct.pack(f"{LEAD}2d", 0xAA55, 7, next(values), 0.0), ("127.0.0.1", port))
            return reader.state.fault.startswith("box: frame 7 arrived twice, with different values; expected ")

        wait_for(is_named, "the contradiction")


def test_datagrams_come_to_an_address_of_ipv6() -> None:
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as sender:
        try:
            sender.bind(("::1", 0))
        except OSError:
            pytest.skip("this host has no address ::1")
        port = free_udp_port()
        device = StreamDevice("box", settings(port, transport="udp", host="::1"))
        device.connect(1.0)
        sender.sendto(struct.pack(f"{LEAD}2d", 0xAA55, 1, 2.0, 3.0), ("::1", port))
        frames = device.read(1.0)
        device.close()
    assert frames is not None
    assert frames.counters.tolist() == [1]


@pytest.mark.parametrize(("form", "bits"), [("<Q2d", None), ("text", 53), ("text", 8)])
def test_a_counter_beyond_the_limit_is_refused(form: str, bits: int | None) -> None:
    port = free_udp_port()
    changes: dict[str, Any] = {
        "format": form,
        "fields": ["counter", "gap1", "gap2"],
        "constants": {},
        "counter_bits": bits,
    }
    device = StreamDevice("box", settings(port, transport="udp", **changes))
    device.connect(1.0)
    frame = b"9100000000000000,1,2" if bits else struct.pack(form, 1 << 63, 1.0, 2.0)
    greatest = (1 << (bits or 62)) - 1
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(frame, ("127.0.0.1", port))
        sentence = rf"box: '9\d+' in place of the counter; expected a whole number of at most {greatest}\."
        with pytest.raises(DeviceError, match=sentence):
            device.read(1.0)
    device.close()


def test_what_ends_the_thread_of_a_reader_ends_its_users(server: StreamServer, monkeypatch: pytest.MonkeyPatch) -> None:
    device = StreamDevice("box", settings(server.port))
    with running(device) as reader:
        wait_for_frames(reader)
        monkeypatch.setattr(device, "read", lambda _: dict[str, Any]()["absent"])

        def is_raised() -> bool:
            try:
                reader.take_state()
            except KeyError:
                return True
            return False

        wait_for(is_raised, "the error")
        with pytest.raises(KeyError):
            reader.newest_values()
        with pytest.raises(KeyError):
            reader.values_at(time.time_ns())


@pytest.mark.parametrize(("order", "code", "last"), [("<", "H", 65535), (">", "I", (1 << 32) - 1), ("<", "h", 32767)])
def test_counter_beside_repeated_codes_goes_on_where_it_wraps(order: str, code: str, last: int) -> None:
    port = free_udp_port()
    form, fields = f"{order}H {code} x 2d", ["magic", "counter", "gap1", "gap2"]
    device = StreamDevice("box", settings(port, transport="udp", format=form, fields=fields))
    device.connect(1.0)
    first = -last - 1 if code == "h" else 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for counter in (last, first):
            sender.sendto(struct.pack(form, 0xAA55, counter, 1.0, np.inf), ("127.0.0.1", port))
        frames: list[int] = []
        while len(frames) < 2 and (found := device.read(1.0)) is not None:
            frames += found.counters.tolist()
            assert np.isnan(found.values[:, 1]).all()
    device.close()
    assert frames == [last, last + 1]


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"format": "<Hz"}, "'<Hz': bad char in struct format"),
        ({"format": "<HI"}, "4 fields"),
        ({"fields": ["magic", "count", "gap1", "gap2"]}, "'counter' occurs 0 times"),
        ({"format": "<Hddd"}, "the counter is no integer"),
        ({"channels": {"gap3": {"unit": "V"}}}, "'gap3' occurs 0 times"),
        ({"counter_bits": 16}, "counter_bits of binary frames"),
        ({"format": "<H?2d"}, "the counter is no integer"),
        ({"format": "<HId8s"}, "channel 'gap2' is no number; expected a code of a number in place of 's'"),
        ({"format": "<hI2d"}, "43605 (0xaa55) does not fit the code 'h'; expected"),
        ({"constants": {"magic": -1}}, "-1 (-0x1) does not fit the code 'H'; expected"),
    ],
)
def test_invalid_settings_are_refused(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValidationError) as caught:
        settings(5000, **changes)
    assert sentence in str(caught.value.errors()[0]["ctx"]["error"])


def test_a_whole_number_is_never_interpolated() -> None:
    with StreamServer(source_number) as server, running(StreamDevice("box", settings(server.port))) as reader:
        wait_for_frames(reader)
        wait_for(lambda: reader.state.values["frames"] > 1500, "frames of half a second")
        end_ns = wait_for_values(reader)
        found = [reader.values_at(end_ns - n * 200_000, whole=[1]) for n in range(2000)]
        numbers = [values[1] for values in found if values is not None]
        assert set(numbers) <= set(range(100))
        assert len(set(numbers)) > 5
        assert 1900 < len(numbers) < len(found)


def test_users_of_one_file_share_the_reader_of_a_device(tmp_path: Path, server: StreamServer) -> None:
    file, box = tmp_path / "instruments.yaml", settings(server.port)
    with shared_reader(file, StreamDevice("box", box)) as one:
        with shared_reader(file, StreamDevice("box", box)) as two:
            assert two is one
        wait_for_frames(one)
        with shared_reader(
            file, StreamDevice("box", settings(server.port, rate={"value": 999, "unit": "Hz"}))
        ) as other:
            assert other is not one
        assert server.clients >= 1
    with shared_reader(file, StreamDevice("box", box)) as again:
        assert again is not one


def test_frames_of_a_triggered_device_are_checked_and_not_interpolated() -> None:
    """The server starts at any time, so its frames are off the ticks by a constant part of a period."""
    with StreamServer(slow_sine) as server:
        loose, strict = (
            StreamDevice("box", settings(server.port, trigger_tolerance={"value": value, "unit": "s"}))
            for value in (6e-4, 1e-9)
        )
        with running(loose) as reader:
            wait_for_frames(reader)
            end_ns = wait_for_values(reader)
            found = [reader.values_at(end_ns - n * 100_000) for n in range(40)]
            times = {values[1] for values in found if values is not None}
            assert len(times) in {4, 5}  # of 4 ms: whole frames only
        with running(strict) as reader:
            wait_for_frames(reader)

            def is_off_tick() -> bool:
                sentence = r"box: frame \d+ is [-+]0\.\d+(e-\d+)? ms from its tick; expected at most 1e-06 ms, as it is"
                is_absent = reader.values_at(time.time_ns() - 50_000_123) is None
                return is_absent and re.match(sentence, reader.state.fault) is not None

            wait_for(is_off_tick, "a frame off its tick")
