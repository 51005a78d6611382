# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Device ``stream``: any TCP server or UDP sender of binary frames of fixed length, or of lines of text.

For frames of a magic number, a counter and two voltages in steps of 0.1 mV::

    kind: stream
    transport: tcp
    host: 192.168.0.5
    port: 5000
    rate: {value: 1000, unit: Hz}
    format: "<HIhh"
    fields: [magic, counter, gap1, gap2]
    constants: {magic: 0xaa55}
    channels:
      gap1: {unit: V, scale: 1.0e-4}
      gap2: {unit: V, scale: 1.0e-4}

For lines such as ``0.7161,-0.2566`` over TCP, which need no counter because TCP loses nothing::

    format: text
    fields: [gap1, gap2]
    without_counter: true
"""

from __future__ import annotations

import re
import select
import socket
import struct
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from posor.calibration.file_model import EntryError, FrozenModel
from posor.tables.number_text import OVERLOAD, parse_number
from pydantic import AfterValidator, Field, model_validator

from posor_drivers.instruments.device import Device, DeviceSettings, FrameCounter, Frames, Host, Port
from posor_drivers.instruments.tcp_device import TcpConnection

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

COUNTER = "counter"
TEXT = "text"
_CODE = re.compile(r"(\d*)([A-Za-z?])")
LONGEST_LINE = 65_536  # bytes
MAX_DATAGRAM = 65_536
TEXT_COUNTER_BITS, MAX_COUNTER_BITS = 53, 62  # numbers in text are doubles; sums of others stay 64 bit integers
RECEIVE_BUFFER = 1 << 22
"""Bytes for datagrams that wait while the reader does not run; the system gives at most ``net.core.rmem_max``."""


def _not_zero(scale: float) -> float:
    if scale == 0.0:
        raise EntryError("scale 0", expected="a number other than 0")
    return scale


class StreamChannel(FrozenModel):
    """A field that is a channel: its value is ``scale`` times the number in the frame, in ``unit``."""

    unit: str
    scale: Annotated[float, Field(strict=True, allow_inf_nan=False), AfterValidator(_not_zero)] = 1.0


class StreamSettings(DeviceSettings):
    """Keys of a stream."""

    kind: Literal["stream"]
    transport: Literal["tcp", "udp"]
    host: Host
    port: Port
    format: str
    fields: tuple[str, ...]
    separator: Annotated[str, Field(min_length=1)] | None = None
    """Of lines of text; default: a comma; a blank stands for any number of blanks."""
    counter_bits: Annotated[int, Field(strict=True, ge=8, le=TEXT_COUNTER_BITS)] | None = None
    """Number of bits of a counter in lines of text that wraps; None: it does not wrap."""
    overload: Annotated[str, Field(min_length=1)] | None = None
    """Text in place of a number that is out of range."""
    without_counter: bool = Field(default=False, strict=True)
    """Frames are counted as they come; for TCP, which loses nothing."""
    constants: dict[str, Annotated[int, Field(strict=True)] | str] = Field(default_factory=dict)
    channels: Annotated[dict[str, StreamChannel], Field(min_length=1)]

    @model_validator(mode="after")
    def _check_fields(self) -> Self:
        if not self.is_text:
            self._check_format()
        if self.without_counter and self.counter_bits is not None:
            raise EntryError("counter_bits", key=("counter_bits",), expected="a counter in the frames")
        if self.without_counter and (COUNTER in self.fields or self.transport == "udp"):
            expected = "a counter in the frames of UDP" if self.transport == "udp" else "fields without a counter"
            raise EntryError("without_counter", key=("without_counter",), expected=expected)
        for name in (*(() if self.without_counter else (COUNTER,)), *self.constants, *self.channels):
            if self.fields.count(name) != 1:
                what = f"'{name}' occurs {self.fields.count(name)} times"
                expected = "each counter, constant and channel once"
                expected += ", or without_counter: true for TCP" if name == COUNTER else ""
                raise EntryError(what, key=("fields",), expected=expected)
        return self

    @property
    def is_text(self) -> bool:
        """Whether frames are lines of text."""
        return self.format == TEXT

    def _check_format(self) -> None:
        """Check the keys of binary frames."""
        for name in ("separator", "overload", "counter_bits"):
            if getattr(self, name) is not None:
                raise EntryError(f"{name} of binary frames", key=(name,), expected="format: text")
        try:
            frame = struct.Struct(self.format)
            numbers = frame.unpack(bytes(frame.size))
        except struct.error as error:
            expected = "as of Python's struct, or text"
            raise EntryError(f"'{self.format}': {error}", key=("format",), expected=expected) from None
        if len(self.fields) != len(numbers):
            expected = f"{len(numbers)} names, as many as '{self.format}' has values"
            raise EntryError(f"{len(self.fields)} fields", key=("fields",), expected=expected)
        self._check_codes(numbers)

    def _check_codes(self, numbers: Sequence[Any]) -> None:
        """Check that counter, channels and constants fit the codes of their fields; ``numbers``: of some frame."""
        of_fields = dict(zip(self.fields, zip(codes_of(self.format), numbers, strict=True), strict=True))
        if COUNTER in of_fields and type(of_fields[COUNTER][1]) is not int:
            raise EntryError("the counter is no integer", key=("format",), expected="a code such as H, I or Q for it")
        for name in of_fields.keys() & self.channels.keys():
            code, number = of_fields[name]
            if isinstance(number, bytes):
                expected = f"a code of a number in place of '{code[-1]}'"
                raise EntryError(f"channel '{name}' is no number", key=("format",), expected=expected)
        for name, value in self.constants.items():
            if isinstance(value, str):
                raise EntryError(f"'{value}'", key=("constants", name), expected="a whole number")
            if name in of_fields:
                _check_constant(name, value, of_fields[name][0])


def codes_of(frame: str) -> list[str]:
    """Return the code of each value of a format of Python's ``struct``, with the byte order."""
    order = frame[0] if frame[:1] in ("@", "=", "<", ">", "!") else "@"
    codes = [(code, 1 if code in "sp" else int(count or 1)) for count, code in _CODE.findall(frame) if code != "x"]
    return [order + code for code, count in codes for _ in range(count)]


def _check_constant(name: str, value: int, code: str) -> None:
    """Raise EntryError: a frame cannot hold a constant."""
    try:
        struct.pack(code, value)
    except struct.error as error:
        what = f"{value} ({value:#x}) does not fit the code '{code[-1]}'"
        raise EntryError(what, key=("constants", name), expected=f"{error}") from None


class StreamDevice(Device[StreamSettings]):
    """Connects to a TCP server, or receives datagrams of one frame each or of several at a port of this host."""

    Settings = StreamSettings
    connection: TcpConnection | socket.socket | None

    def __init__(self, name: str, settings: StreamSettings) -> None:
        """Prepare the layout of a frame."""
        super().__init__(name, settings)
        fields = settings.fields
        self._frame = struct.Struct("" if settings.is_text else settings.format)
        self._columns = [fields.index(channel) for channel in settings.channels]
        self._scales = np.array([channel.scale for channel in settings.channels.values()])
        self._constants = [(fields.index(each), each, value) for each, value in settings.constants.items()]
        self._texts = {column for column, _, value in self._constants if isinstance(value, str)}
        self._counter = fields.index(COUNTER) if COUNTER in fields else None
        bits = settings.counter_bits or 64
        if self._counter is not None and not settings.is_text:
            bits = 8 * struct.calcsize(codes_of(settings.format)[self._counter])
        self._wrap = 1 << bits
        self._greatest = (1 << min(bits, TEXT_COUNTER_BITS if settings.is_text else MAX_COUNTER_BITS)) - 1
        self._start()

    def _start(self) -> None:
        """Forget what an earlier connection has sent."""
        self._rest, self._numbers, self._counted = b"", FrameCounter(self._wrap), 0
        self._is_first = self.settings.is_text  # a connection may begin within a line
        self._sender: Any = None

    @classmethod
    def starting_settings(cls, units: Mapping[str, str]) -> dict[str, Any]:
        """Return frames of a counter and a double for each reading."""
        return {
            "transport": "tcp",
            "host": "192.168.0.5",
            "port": 5000,
            "rate": {"value": 1000, "unit": "Hz"},
            "format": f"<I{len(units)}d",
            "fields": [COUNTER, *units],
            **super().starting_settings(units),
        }

    @property
    def address(self) -> str:
        """Transport, host and port."""
        return f"{self.settings.transport} {self.settings.host}:{self.settings.port}"

    def connect(self, timeout_s: float) -> str:
        """Connect, or open the port; the first frame is checked like every other."""
        settings = self.settings
        self._start()
        if settings.transport == "tcp":
            self.connection = TcpConnection(self.error, settings.host, settings.port, timeout_s)
        else:
            self.connection = self._open_port()
        return self.address

    def _open_port(self) -> socket.socket:
        with ExitStack() as stack:
            try:
                family = socket.AF_INET6 if ":" in self.settings.host else socket.AF_INET
                port = stack.enter_context(socket.socket(family, socket.SOCK_DGRAM))
                port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
                port.bind((self.settings.host, self.settings.port))
            except (OSError, UnicodeError) as error:  # UnicodeError: the host is no valid name
                what = f"{self.address} cannot be opened, {getattr(error, 'strerror', error)}"
                raise self.error(what, "an address of this host and a free port") from None
            stack.pop_all()
        return port

    def read(self, timeout_s: float) -> Frames | None:
        """Return the frames that have come."""
        connection = self.connection
        if isinstance(connection, TcpConnection):
            data = self._rest + connection.receive(timeout_s)
            arrived_ns = connection.received_ns
        elif connection is not None and select.select([connection], [], [], timeout_s)[0]:
            data = self._receive_datagrams(connection)
            arrived_ns = time.time_ns()
        else:
            return None
        whole = data.rfind(b"\n") + 1 if self.settings.is_text else len(data) - len(data) % self._frame.size
        self._rest = data[whole:]
        if len(self._rest) > LONGEST_LINE:
            raise self.error(f"no end of a line in {len(self._rest)} bytes", "lines of text")
        rows = self._lines(data[:whole]) if self.settings.is_text else list(self._frame.iter_unpack(data[:whole]))
        return self._frames(rows, arrived_ns) if rows else None

    @property
    def incomplete_frame(self) -> str:
        """Bytes after the last whole frame."""
        missing = " without a line feed" if self.settings.is_text else f" of a frame of {self._frame.size}"
        return f"{len(self._rest)} bytes{missing}" if self._rest else ""

    def _receive_datagrams(self, port: socket.socket) -> bytes:
        """Return the content of all datagrams received so far. Raises DeviceError: they are of two senders."""
        data = b""
        while select.select([port], [], [], 0.0)[0]:
            datagram, sender = port.recvfrom(MAX_DATAGRAM)
            self._sender = self._sender or sender
            if sender != self._sender:
                what = " and ".join(f"{host} port {number}" for host, number, *_ in sorted([self._sender, sender]))
                raise self.error(f"datagrams of {what}", "one sender at this port")
            if self.settings.is_text:
                datagram = datagram.rstrip(b"\r\n") + b"\n"
                self._is_first = False
            elif len(datagram) % self._frame.size:
                what = f"a datagram of {len(datagram)} bytes"
                raise self.error(what, f"whole frames of {self._frame.size} bytes")
            data += datagram
        return data

    def _lines(self, data: bytes) -> list[list[float | str]]:
        """Return the cells of whole lines: numbers, and texts of fields that are no numbers."""
        separator = self.settings.separator or ","
        lines = [line for line in data.decode("ascii", "replace").split("\n") if line.strip()]
        if self._is_first and lines:
            self._is_first = False
            del lines[0]
        rows: list[list[float | str]] = []
        for line in lines:
            cells = line.split() if separator == " " else [cell.strip() for cell in line.split(separator)]
            if len(cells) != len(self.settings.fields):
                expected = f"{len(self.settings.fields)}, separated by '{separator}'"
                raise self.error(f"the line {line[:60].strip()!r} has {len(cells)} values", expected)
            rows.append([cell if n in self._texts else self._cell(cell) for n, cell in enumerate(cells)])
        return rows

    def _cell(self, cell: str) -> float | str:
        if cell == self.settings.overload:
            return np.nan
        try:
            return parse_number(cell)
        except ValueError:
            return cell

    def _frames(self, rows: Sequence[Sequence[Any]], arrived_ns: int) -> Frames:
        for row in rows:
            for column, name, value in self._constants:
                if row[column] != value:
                    what = f"'{name}' is {row[column]!r} in a frame"
                    raise self.error(what, f"{value!r}; the frames may be of another layout")
        numbers = [[row[column] for column in self._columns] for row in rows]
        text = next((each for row in numbers for each in row if isinstance(each, str)), None)
        if text is not None:
            raise self.error(f"{text!r} in place of a number", "a number, or the text of the key overload")
        unscaled = np.array(numbers, dtype=np.float64)
        values = unscaled * self._scales
        values[(np.abs(unscaled) >= OVERLOAD) | np.isinf(values)] = np.nan
        counters = np.array([self._number_of(row) for row in rows], dtype=np.int64)
        return Frames(counters, values, arrived_ns=arrived_ns)

    def _number_of(self, row: Sequence[Any]) -> int:
        """Return the number of a frame: by its counter, or counted here."""
        self._counted += 1
        if self._counter is None:
            return self._counted
        counter = row[self._counter]
        if isinstance(counter, float) and counter.is_integer() and counter >= 0.0:
            counter = int(counter)
        if not isinstance(counter, int) or abs(counter) > self._greatest:
            raise self.error(f"{str(counter)!r} in place of the counter", f"a whole number of at most {self._greatest}")
        return self._numbers.number(counter)
