# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Device ``stream`` with lines of text, and with frames without a counter, over real sockets."""

from __future__ import annotations

import socketserver
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import pytest
from posor_drivers.instruments.device_reader import DeviceReader
from posor_drivers.instruments.stream_device import StreamDevice, StreamSettings
from pydantic import ValidationError

from .device_states import running, wait_for, wait_for_frames, wait_for_reported_fault

RATE, MORE_FRAMES = 200.0, 300


@contextmanager
def serving(frame: Callable[[int], bytes]) -> Iterator[int]:
    """Send a frame by its number 200 times per second over TCP; yield the port."""
    stop = threading.Event()

    class Sender(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            begin = time.monotonic()
            with suppress(OSError):
                for n in range(100_000):
                    self.request.sendall(frame(n))
                    if stop.wait(max(0.0, begin + n / RATE - time.monotonic())):
                        return

    class Server(socketserver.ThreadingTCPServer):
        allow_reuse_address = daemon_threads = True

    with Server(("127.0.0.1", 0), Sender) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield server.server_address[1]
        finally:
            stop.set()
            server.shutdown()
            thread.join()


def settings(port: int, **changes: Any) -> StreamSettings:
    content: dict[str, Any] = {
        "kind": "stream",
        "transport": "tcp",
        "host": "127.0.0.1",
        "port": port,
        "rate": {"value": RATE, "unit": "Hz"},
        "format": "text",
        "fields": ["gap1", "gap2"],
        "without_counter": "counter" not in changes.get("fields", ()),
        "channels": {"gap1": {"unit": "V", "scale": 2.0}, "gap2": {"unit": "V"}},
    }
    return StreamSettings.model_validate(content | changes)


def newest_values(reader: DeviceReader) -> Any:
    """Wait for values of 50 ms ago, and return them."""
    found: list[Any] = []

    def take() -> bool:
        found[:] = [reader.values_at(time.time_ns() - 50_000_000)]
        return found[0] is not None

    wait_for(take, "values")
    return found[0]


WAYS: dict[str, tuple[Callable[[int], bytes], dict[str, Any]]] = {
    "commas": (lambda _: b"0.5, -1.25\n", {}),
    "a first line that is cut, and a banner": (lambda n: b"0.5,-1.25\r\n" if n else b"5,-1.25\r\n", {}),
    "blanks and exponents": (lambda _: b"  5e-1   -1.25  \r\n", {"separator": " "}),
    "counter, name and unused fields": (
        lambda n: f"12D4;{n};0.5;-1.25;ok\n".encode(),
        {"separator": ";", "constants": {"name": "12D4"}, "fields": ["name", "counter", "gap1", "gap2", "remark"]},
    ),
    "a counter of 8 bits": (
        lambda n: f"{n % 256},0.5,-1.25\n".encode(),
        {"fields": ["counter", "gap1", "gap2"], "counter_bits": 8},
    ),
    "binary without counter": (lambda _: struct.pack("<2d", 0.5, -1.25), {"format": "<2d"}),
}


@pytest.mark.parametrize("way", WAYS)
def test_values_of_frames(way: str) -> None:
    frame, changes = WAYS[way]
    with serving(frame) as port, running(StreamDevice("box", settings(port, **changes))) as reader:
        wait_for_frames(reader)
        np.testing.assert_allclose(newest_values(reader), [1.0, -1.25], rtol=1e-12)
        wait_for(lambda: reader.state.values["frames"] > MORE_FRAMES, "frames")  # a counter of 8 bits has wrapped
        assert (reader.state.values["frames_lost"], reader.state.values["connections"]) == (0, 1)


@pytest.mark.parametrize(
    ("frame", "form"),
    [
        (b"OVER,nan\n", "text"),
        (b"9.9E37,-9.91e+37\n", "text"),
        (b"1D38,-inf\n", "text"),
        (struct.pack("<2d", 9.9e37, -np.inf), "<2d"),
    ],
    ids=["texts", "overload of SCPI", "larger", "binary"],
)
def test_a_number_out_of_range_is_invalid(frame: bytes, form: str) -> None:
    changes: dict[str, Any] = {"channels": {"gap1": {"unit": "m", "scale": 1e-9}, "gap2": {"unit": "V"}}}
    changes |= {"format": form, "overload": "OVER" if form == "text" else None}
    with serving(lambda _: frame) as port, running(StreamDevice("box", settings(port, **changes))) as reader:
        wait_for_frames(reader)
        assert np.isnan(newest_values(reader)).all()


@pytest.mark.parametrize("control", ["\r", "\v", "\f", "\x1c", "\x1d", "\x1e"], ids=repr)
def test_only_a_line_feed_ends_a_frame(control: str) -> None:
    frame = f"0.5,-1.25{control}0.5,-1.25\n".encode()
    with serving(lambda _: frame) as port, running(StreamDevice("box", settings(port))) as reader:
        wait_for_reported_fault(reader, " has 3 values")
        assert reader.state.fault.isprintable()


@pytest.mark.parametrize("step", [0, -1], ids=["still", "down"])
def test_a_counter_that_does_not_rise_is_named(step: int) -> None:
    def frame(n: int) -> bytes:
        return f"{5000 + n * step},0.5,-1.25\n".encode()

    fields = ["counter", "gap1", "gap2"]
    with serving(frame) as port, running(StreamDevice("box", settings(port, fields=fields))) as reader:
        wait_for_reported_fault(reader, "box: the frame counter has not risen above ")


@pytest.mark.parametrize(
    ("frame", "form", "words"),
    [
        (lambda _: b"0.5,-1.25\r", "text", " bytes without a line feed; expected 200 frames per second."),
        (lambda n: b"" if n else bytes(5), "<2d", ", but 5 bytes of a frame of 16; expected 200 frames per second."),
    ],
    ids=["lines that end in CR", "a part of a binary frame"],
)
def test_bytes_that_are_no_frame_are_named(frame: Callable[[int], bytes], form: str, words: str) -> None:
    with serving(frame) as port, running(StreamDevice("box", settings(port, format=form))) as reader:
        wait_for_reported_fault(reader, words)
        assert reader.state.fault.startswith("box: no frame for 0.3")


@pytest.mark.parametrize(
    ("frame", "changes", "sentence"),
    [
        (b"0.5\n", {}, "the line '0.5' has 1 values; expected 2, separated by ','"),
        (b"0.5;1\n", {}, "has 1 values"),
        (b"0.5,x\n", {}, "'x' in place of a number; expected a number, or the text of the key overload"),
        (b"0.5,1_0\n", {}, "'1_0' in place of a number"),
        (b"x,0.5,1\n", {"fields": ["counter", "gap1", "gap2"]}, "'x' in place of the counter; expected a whole number"),
        (
            b"0,0.5,1\n",
            {"fields": ["id", "gap1", "gap2"], "constants": {"id": 7}},
            "'id' is 0.0 in a frame; expected 7",
        ),
        (b"0.5 " * 4096, {}, "no end of a line in"),
    ],
)
def test_lines_of_another_layout_are_named(frame: bytes, changes: dict[str, Any], sentence: str) -> None:
    with serving(lambda _: frame) as port, running(StreamDevice("box", settings(port, **changes))) as reader:
        wait_for_reported_fault(reader, sentence)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"transport": "udp"}, "without_counter; expected a counter in the frames of UDP"),
        ({"format": "<2d", "separator": ","}, "separator of binary frames; expected format: text"),
        ({"format": "<2d", "constants": {"gap1": "x"}}, "'x'; expected a whole number"),
        ({"without_counter": False}, "'counter' occurs 0 times; expected each counter, constant and channel once, or"),
        ({"counter_bits": 16}, "counter_bits; expected a counter in the frames"),
        ({"format": "txt"}, "expected as of Python's struct, or text"),
    ],
)
def test_keys_that_do_not_fit_are_refused(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValidationError) as caught:
        settings(5000, **changes)
    assert sentence in str(caught.value.errors()[0]["ctx"]["error"])
