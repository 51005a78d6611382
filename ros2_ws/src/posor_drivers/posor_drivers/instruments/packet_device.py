"""Base class of devices that send their frames in packets over TCP."""

from __future__ import annotations

import time
from abc import abstractmethod

import numpy as np

from posor_drivers.instruments.device import Device, Frames, SettingsT
from posor_drivers.instruments.tcp_connection import TcpConnection


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
        self.connection = TcpConnection(self.name, host, port, timeout_s)

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
