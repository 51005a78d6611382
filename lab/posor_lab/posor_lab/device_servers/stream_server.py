# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Server of binary frames over TCP or UDP, with a clock of its own and faults on demand."""

from __future__ import annotations

import socket
import struct
import time
from threading import Event
from typing import TYPE_CHECKING

from posor_drivers.ros_clock import disable_timer_slack

from posor_lab.device_servers.device_server import HOST, DeviceServer

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

LEAD = "<HI"  # format of magic number and counter; the values follow as doubles
MAGIC = 0xAA55


class StreamServer(DeviceServer):
    """Sends frames of a magic number, a counter and values to one client after another.

    Attributes:
        port: Port of the server; of UDP: port to send to.
        magic: Sent in each frame; another one is a corrupted frame.
        stalled: No frame is sent while it is set; frames of this time are lost.
        merged: Number of frames that are sent together.
        skip: Number of frames to leave out next.
        hold: Number of frames to send before the next one, which is late then; a negative one is sent twice.
        first: Counter of the first frame after a connection.
        lost_triggers: Number of triggers to lose next; 0 as soon as they are lost.
        false_trigger: True: count a false trigger half a period before the next one; False as soon as it is counted.
        clients: Number of connections so far.

    """

    def __init__(
        self,
        values: Callable[[int], Sequence[float]],
        rate: float = 1000.0,
        *,
        drift: float = 0.0,
        udp_port: int = 0,
        triggered: bool = False,
    ) -> None:
        """Open a port of this host, or send datagrams to ``udp_port``.

        ``values`` are those of a frame by its ROS time [ns]; the server's clock is slow by the share ``drift``.
        ``triggered``: the frames are those of the ticks of the ROS clock at this rate.
        """
        super().__init__()
        self.magic, self.merged, self.skip, self.hold, self.first, self.clients = MAGIC, 1, 0, 0, 0, 0
        self.stalled, self._dropped = Event(), Event()
        self.lost_triggers, self.false_trigger, self._triggered = 0, False, triggered
        self._values, self._period_ns = values, 1e9 / rate * (1.0 + drift)
        if udp_port:
            self.add_task(self._send_datagrams)
        self.port = udp_port or self.open_port(self._serve)

    def drop_client(self) -> None:
        """Close the present connection; the next one is accepted."""
        self._dropped.set()

    def _serve(self, client: socket.socket) -> None:
        self.clients += 1
        self._dropped.clear()
        self._send_frames(client.sendall)

    def _send_datagrams(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            self._send_frames(lambda frames: sender.sendto(frames, (HOST, self.port)))

    def _send_frames(self, send: Callable[[bytes], object]) -> None:
        """Send until the end, the client's end, or ``drop_client``."""
        disable_timer_slack()
        start_ns, number, held, late, due, shift = time.time_ns(), 0, b"", b"", 0, 0
        if self._triggered:
            start_ns += -start_ns % round(self._period_ns)
        while not (self.stopping.is_set() or self._dropped.is_set()):
            periods = float(number + shift)
            if self.lost_triggers:
                shift, self.lost_triggers = shift + self.lost_triggers, 0
                periods = float(number + shift)
            elif self.false_trigger:
                shift, self.false_trigger, periods = shift - 1, False, periods - 0.5
            exposed_ns = start_ns + round(periods * self._period_ns)
            values = self._values(exposed_ns)  # before its time, so that sending is the least delay
            frame = struct.Struct(f"{LEAD}{len(values)}d")
            if (wait_s := exposed_ns * 1e-9 - time.time()) > 0.0:
                time.sleep(wait_s)
            number += 1
            if self.skip or self.stalled.is_set():
                self.skip = max(0, self.skip - 1)
                continue
            data = frame.pack(self.magic, (self.first + number - 1) % (1 << 32), *values)
            if self.hold:
                late, due = data, number + abs(self.hold)
                data, self.hold = b"" if self.hold > 0 else data, 0
            elif late and number >= due:
                data, late = data + late, b""
            held += data
            if len(held) < self.merged * frame.size:
                continue
            send(held)
            held = b""
