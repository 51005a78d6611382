# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Devices behind a TCP port: the connection, and the base class of those that send their frames in packets."""

from __future__ import annotations

import select
import socket
import time
from abc import abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from posor_drivers.instruments.device import Device, DeviceError, Frames, SettingsT

if TYPE_CHECKING:
    from collections.abc import Callable

_BUFFER_BYTES = 65536


class TcpConnection:
    """TCP connection to a device; its errors name the device and the address.

    Attributes:
        received_ns: Time at which the last bytes were received [ns].

    """

    def __init__(self, error: Callable[[str, str], DeviceError], host: str, port: int, timeout_s: float) -> None:
        """Connect; ``error`` is that of the device, ``timeout_s`` also limits each later ``send``.

        Raises:
            DeviceError: The device cannot be reached within the time.

        """
        self._error, self.received_ns = error, 0
        self._address = f"{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), timeout_s)
        except (OSError, UnicodeError) as cause:  # UnicodeError: the host is no valid name
            reason = f" within {timeout_s:g} s" if isinstance(cause, TimeoutError) else f": {cause}"
            expected = "a device that accepts the connection"
            raise error(f"no connection to {self._address}{reason}", expected) from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, data: bytes) -> None:
        """Send all bytes.

        Raises:
            DeviceError: The connection was lost, or the device does not take the bytes within the time.

        """
        try:
            self._socket.sendall(data)
        except OSError as error:  # a time-out is one
            raise self._lost(error) from None

    def receive(self, timeout_s: float) -> bytes:
        """Return the bytes that have come, at most 64 KiB; wait for the first one. Empty: none came within the time.

        Raises:
            DeviceError: The connection was lost, or the device has closed it.

        """
        try:
            if not select.select([self._socket], [], [], timeout_s)[0]:
                return b""
            data = self._socket.recv(_BUFFER_BYTES)
            self.received_ns = time.time_ns()
        except OSError as error:
            raise self._lost(error) from None
        if not data:
            raise self._error(f"{self._address} has closed the connection", "an open connection")
        return data

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def _lost(self, error: OSError) -> DeviceError:
        """Return the error of a lost connection."""
        return self._error(f"the connection to {self._address} was lost: {error}", "an open connection")


class PacketDevice(Device[SettingsT]):
    """Receives bytes and takes whole packets of frames from them.

    Attributes:
        received: Bytes that have been received and not yet taken.

    """

    connection: TcpConnection | None
    received = b""

    def open_stream(self, host: str, port: int, timeout_s: float) -> None:
        """Connect to the port that sends the packets.

        Raises:
            DeviceError: The port cannot be reached within the time.

        """
        self.received = b""
        self.connection = TcpConnection(self.error, host, port, timeout_s)

    @property
    def incomplete_frame(self) -> str:
        """Bytes after the last whole packet."""
        return f"{len(self.received)} bytes of an incomplete packet" if self.received else ""

    @abstractmethod
    def take_packet(self) -> Frames | None:
        """Take the first packet from ``received`` and return its frames; None if it is not complete.

        Raises:
            DeviceError: What has been received is no packet.

        """

    def read(self, timeout_s: float) -> Frames | None:
        """Return the frames of the packets that have come."""
        if self.connection is None:
            raise self.error("no connection", "a call of connect before")
        deadline_s = time.monotonic() + timeout_s
        while received := self.connection.receive(max(0.0, deadline_s - time.monotonic())):
            self.received += received
            packets = list(iter(self.take_packet, None))
            if packets:
                counters = np.concatenate([packet.counters for packet in packets])
                values = np.concatenate([packet.values for packet in packets])
                return Frames(counters, values, arrived_ns=self.connection.received_ns)
        return None
