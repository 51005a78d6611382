"""TCP connection to a device."""

from __future__ import annotations

import select
import socket
import time

from posor_drivers.instruments.device import DeviceError

_BUFFER_BYTES = 65536


class TcpConnection:
    """TCP connection to a device; its errors name the device and the address.

    Attributes:
        received_ns: Time at which the last bytes were received [ns].

    """

    def __init__(self, device: str, host: str, port: int, timeout_s: float) -> None:
        """Connect.

        Args:
            device: Name of the device, for messages.
            host: Name or address of the device.
            port: TCP port.
            timeout_s: Time limit of the connection, and of each later ``send``.

        Raises:
            DeviceError: The device cannot be reached within the time.

        """
        self._device, self.received_ns = device, 0
        self._address = f"{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), timeout_s)
        except TimeoutError:
            raise self._error(
                f"no connection to {self._address} within {timeout_s:g} s", "a device that accepts the connection"
            ) from None
        except (OSError, UnicodeError) as error:  # UnicodeError: the host is no valid name
            raise self._error(
                f"no connection to {self._address}: {error}", "a device that accepts the connection"
            ) from None
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
        """Return the bytes that have come, at most 64 KiB; wait for the first one.

        Returns:
            The bytes; none where none came within the time.

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

    def _error(self, what: str, expected: str) -> DeviceError:
        """Return an error of this device."""
        return DeviceError(what, where=self._device, expected=expected)
