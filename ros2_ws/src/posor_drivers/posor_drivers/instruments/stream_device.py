"""Device ``stream``: any TCP server or UDP sender of binary frames of fixed length.

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
"""

from __future__ import annotations

import select
import socket
import struct
import time
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from posor.calibration.file_model import EntryError, FrozenModel
from pydantic import Field, model_validator

from posor_drivers.instruments.device import Device, DeviceSettings, FrameCounter, Frames, Port
from posor_drivers.instruments.tcp_device import TcpConnection

if TYPE_CHECKING:
    from collections.abc import Mapping

COUNTER = "counter"
MAX_DATAGRAM = 65_536


class StreamChannel(FrozenModel):
    """A field that is a channel: its value is ``scale`` times the number in the frame, in ``unit``."""

    unit: str
    scale: Annotated[float, Field(allow_inf_nan=False)] = 1.0


class StreamSettings(DeviceSettings):
    """Keys of a stream."""

    kind: Literal["stream"]
    transport: Literal["tcp", "udp"]
    host: str
    port: Port
    format: str
    fields: tuple[str, ...]
    constants: dict[str, int] = Field(default_factory=dict)
    channels: Annotated[dict[str, StreamChannel], Field(min_length=1)]

    @model_validator(mode="after")
    def _check_fields(self) -> Self:
        try:
            frame = struct.Struct(self.format)
            numbers = frame.unpack(bytes(frame.size))
        except struct.error as error:
            raise EntryError(f"'{self.format}': {error}", key=("format",), expected="as of Python's struct") from None
        if len(self.fields) != len(numbers):
            expected = f"{len(numbers)} names, as many as '{self.format}' has values"
            raise EntryError(f"{len(self.fields)} fields", key=("fields",), expected=expected)
        for name in (COUNTER, *self.constants, *self.channels):
            if self.fields.count(name) != 1:
                what = f"'{name}' occurs {self.fields.count(name)} times"
                raise EntryError(what, key=("fields",), expected="each counter, constant and channel once")
        if not isinstance(numbers[self.fields.index(COUNTER)], int):
            raise EntryError("the counter is no integer", key=("format",), expected="a code such as H, I or Q for it")
        return self


class StreamDevice(Device[StreamSettings]):
    """Connects to a TCP server, or receives datagrams of one frame each or of several at a port of this host."""

    Settings = StreamSettings
    connection: TcpConnection | socket.socket | None

    def __init__(self, name: str, settings: StreamSettings) -> None:
        """Prepare the layout of a frame."""
        super().__init__(name, settings)
        fields = settings.fields
        self._frame = struct.Struct(settings.format)
        self._columns = [fields.index(channel) for channel in settings.channels]
        self._scales = np.array([channel.scale for channel in settings.channels.values()])
        self._constants = [(fields.index(each), each, value) for each, value in settings.constants.items()]
        self._counter = fields.index(COUNTER)
        codes = [code for code in settings.format.strip("@=<>!") if code != "x"]
        self._wrap = 1 << (8 * struct.calcsize("<" + codes[self._counter])) if len(codes) == len(fields) else 1 << 64
        self._rest, self._numbers = b"", FrameCounter(self._wrap)

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
        self._rest, self._numbers = b"", FrameCounter(self._wrap)
        if settings.transport == "tcp":
            self.connection = TcpConnection(self.name, settings.host, settings.port, timeout_s)
        else:
            self.connection = self._open_port()
        return self.address

    def _open_port(self) -> socket.socket:
        port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            port.bind((self.settings.host, self.settings.port))
        except OSError as error:
            port.close()
            what = f"{self.address} cannot be opened, {error.strerror}"
            raise self.error(what, "an address of this host and a free port") from None
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
        whole = len(data) - len(data) % self._frame.size
        self._rest = data[whole:]
        return self._frames(data[:whole], arrived_ns) if whole else None

    def _receive_datagrams(self, port: socket.socket) -> bytes:
        """Return the content of all datagrams received so far; waits for the first."""
        data = b""
        while select.select([port], [], [], 0.0)[0]:
            datagram = port.recv(MAX_DATAGRAM)
            if len(datagram) % self._frame.size:
                what = f"a datagram of {len(datagram)} bytes"
                raise self.error(what, f"whole frames of {self._frame.size} bytes")
            data += datagram
        return data

    def _frames(self, data: bytes, arrived_ns: int) -> Frames:
        rows = list(self._frame.iter_unpack(data))
        for row in rows:
            for column, name, value in self._constants:
                if row[column] != value:
                    what = f"'{name}' is {row[column]} in a frame"
                    raise self.error(what, f"{value}; the frames may be of another layout")
        values = np.array([[row[column] for column in self._columns] for row in rows], dtype=np.float64) * self._scales
        counters = np.array([self._numbers.number(row[self._counter]) for row in rows], dtype=np.int64)
        return Frames(counters, values, arrived_ns=arrived_ns)
