"""Server of binary frames over TCP or UDP, with a clock of its own and faults on demand."""

from __future__ import annotations

import socket
import struct
import time
from threading import Event, Thread
from typing import TYPE_CHECKING, Self

import numpy as np

from posor_drivers.ros_clock import disable_timer_slack

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import TracebackType

LEAD = "<HI"
"""Format of magic number and counter; the values follow as doubles."""
MAGIC = 0xAA55


class StreamServer:
    """Sends frames of a magic number, a counter and values to one client after another.

    Attributes:
        port: Port of the server; of UDP: port to send to.
        magic: Sent in each frame; another one is a corrupted frame.
        stalled: No frame is sent while it is set; frames of this time are lost.
        merged: Number of frames that are sent together.
        skip: Number of frames to leave out next.
        first: Counter of the first frame after a connection.
        clients: Number of connections so far.

    """

    def __init__(
        self,
        values: Callable[[int], Sequence[float]],
        rate: float = 1000.0,
        *,
        drift: float = 0.0,
        jitter_s: float = 0.0,
        udp_port: int = 0,
    ) -> None:
        """Open a port of this host.

        Args:
            values: Values of a frame by its ROS time [ns].
            rate: Frames per second of the server's clock.
            drift: Share by which the server's clock is slow.
            jitter_s: Mean of the exponential delay of each frame [s]; frames stay in order.
            udp_port: Send datagrams to this port instead; 0: TCP.

        """
        self.magic, self.merged, self.skip, self.first, self.clients = MAGIC, 1, 0, 0, 0
        self.stalled, self._stopping, self._dropped = Event(), Event(), Event()
        self._values, self._period_ns, self._jitter_s = values, 1e9 / rate * (1.0 + drift), jitter_s
        self._random = np.random.default_rng(1985)
        self._udp_port = udp_port
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM if udp_port else socket.SOCK_STREAM)
        if not udp_port:
            self._listen(0)
        self.port: int = udp_port or self._socket.getsockname()[1]
        self._thread = Thread(target=self._serve, daemon=True)

    def _listen(self, port: int) -> None:
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.bind(("127.0.0.1", port))
        self._socket.listen()
        self._socket.settimeout(0.02)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        self._stopping.set()
        self._thread.join()
        self._socket.close()

    def drop_client(self) -> None:
        """Close the present connection; the next one is accepted."""
        self._dropped.set()

    def _serve(self) -> None:
        disable_timer_slack()
        while not self._stopping.is_set():
            if self._udp_port:
                self._socket.connect(("127.0.0.1", self._udp_port))
                self._send_frames(self._socket)
                continue
            try:
                client, _ = self._socket.accept()
            except TimeoutError:
                continue
            with client:
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self.clients += 1
                self._dropped.clear()
                self._send_frames(client)

    def _send_frames(self, client: socket.socket) -> None:
        """Send until the end, the client's end, or ``drop_client``."""
        start_ns, number, held, sent_s = time.time_ns(), 0, b"", 0.0
        while not (self._stopping.is_set() or self._dropped.is_set()):
            exposed_ns = start_ns + round(number * self._period_ns)
            due_s = exposed_ns * 1e-9 + (self._random.exponential(self._jitter_s) if self._jitter_s else 0.0)
            sent_s = max(sent_s, due_s)
            values = self._values(exposed_ns)  # before its time, so that sending is the least delay
            frame = struct.Struct(f"{LEAD}{len(values)}d")
            if (wait_s := sent_s - time.time()) > 0.0:
                time.sleep(wait_s)
            number += 1
            if self.skip or self.stalled.is_set():
                self.skip = max(0, self.skip - 1)
                continue
            held += frame.pack(self.magic, (self.first + number - 1) % (1 << 32), *values)
            if len(held) < self.merged * frame.size:
                continue
            try:
                client.sendall(held)
            except OSError:
                if not self._udp_port:
                    return
            held = b""
