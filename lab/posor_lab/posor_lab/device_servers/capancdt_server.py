# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Counterpart of a capaNCDT 6200 controller: command port and data port, a clock of its own and faults on demand.

Written from the operating instructions, chapter 6, and from what public readers of the controller expect: the preamble
is sent as ``SAEM`` and the bytes per frame before the number of frames.
"""

from __future__ import annotations

import math
import struct
import time
from threading import Event
from typing import TYPE_CHECKING

import numpy as np
from posor_drivers.ros_clock import disable_timer_slack

from posor_lab.device_servers.device_server import POLL_S, DeviceServer

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Mapping, Sequence

WELCOME = "Welcome to capaNCDT\r\nDevice: DT6220\r\nS/N: 12345\r\n"
SAMPLE_TIMES_US = (256, 480, 960, 1920, 3840, 9600, 19_200, 38_400, 96_000, 200_000, 400_000)
"""Of the manual only 960 and the greatest are known."""
HEADER_BYTES = 32
FULL_SCALE = (1 << 24) - 1


class CapaNcdtServer(DeviceServer):
    """Answers commands and sends packets of frames, to one client after another at each port.

    Attributes:
        command_port: Port of the commands.
        data_port: Port of the frames.
        answers: Answers instead of the usual ones, by command without parameters; None: no answer.
        states: Answer to ``$CHS``: state of channel 1, 2, ...
        preamble: First four bytes of each packet.
        frames_first: Send the number of frames before the bytes per frame.
        packet_frames: Frames in a packet.
        merged: Packets that are sent together.
        skip: Number of frames to leave out next.
        first: Counter of the first frame after a connection.
        split_at: Send the next packet in two parts, this many bytes first; the second after ``released``.
        split: Set while the second part is missing.
        stalled: No frame is sent while it is set; frames of this time are lost.
        sample_time_us: Time from frame to frame by the server's clock [us].

    """

    def __init__(
        self,
        distances: Callable[[int], Sequence[float]],
        ranges: Mapping[int, float],
        *,
        drift: float = 0.0,
        delay_s: float = 0.0,
    ) -> None:
        """Open both ports.

        ``distances``: distances [m] at a ROS time [ns], in ascending order of the channels; NaN: no 24-bit value.
        ``ranges``: measuring range of each channel that has a module [m]. ``drift``: share by which the server's clock
        is slow. ``delay_s``: mean of the exponential delay of each packet [s]; packets stay in order.
        """
        super().__init__()
        self.answers: dict[str, str | None] = {}
        self.states = [1 if number in ranges else 0 for number in (1, 2, 3, 4)]
        self.preamble, self.frames_first = b"SAEM", False
        self.packet_frames, self.merged, self.skip, self.first, self.split_at = 4, 1, 0, 0, 0
        self.split, self.released, self.stalled = Event(), Event(), Event()
        self.sample_time_us, self.trigger_mode = 960, 1
        self._distances, self._ranges = distances, dict(sorted(ranges.items()))
        self._drift, self._delay_s = drift, delay_s
        self._start_ns, self._period_ns, self._restarted = 0, 0.0, False
        self._dropped = Event()
        self._random = np.random.default_rng(1985)
        self.command_port, self.data_port = self.open_port(self._answer), self.open_port(self._stream)

    def stop(self) -> None:
        """Close both ports, also in the middle of a packet."""
        self.released.set()
        super().stop()

    def exposed_ns(self, number: int) -> int:
        """Return the ROS time of a frame since the connection [ns]."""
        return self._start_ns + round(number * self._period_ns)

    def restart_counter(self) -> None:
        """Begin with counter zero in the next packet."""
        self._restarted = True

    def drop_client(self) -> None:
        """Close the data connection; the next one is accepted."""
        self._dropped.set()

    def _answer(self, client: socket.socket) -> None:
        """Answer commands until the client's end; each character comes back as echo, the rest follows."""
        client.settimeout(POLL_S)
        client.sendall(WELCOME.encode())
        line = b""
        while not self.stopping.is_set():
            try:
                byte = client.recv(1)
            except TimeoutError:
                continue
            if not byte:
                return
            if byte == b"\r":
                command = line[line.find(b"$") + 1 :].decode()
                name, parameter = command[:3], command[3:]
                answer = self.answers[name] if name in self.answers else self._answer_to(name, parameter)
                if answer is not None:
                    client.sendall(f"{answer}\r\n".encode())
                line = b""
            else:
                client.sendall(byte)
                line += byte

    def _answer_to(self, name: str, parameter: str) -> str:
        """Carry out a command; return the answer after the echo."""
        known = {"VER": "DT6200;V1.2a;8010079", "CHS": ",".join(str(state) for state in self.states) + "OK"}
        if name in known and not parameter:
            return known[name]
        if name == "AVT" and parameter == "?":
            return "0OK"
        if name == "TRG" and parameter in {"0", "1", "2", "3"}:
            self.trigger_mode = int(parameter)
            return "OK"
        if name == "STI" and parameter.isdecimal():
            self.sample_time_us = max((each for each in SAMPLE_TIMES_US if each <= int(parameter)), default=256)
            return f",{self.sample_time_us}OK"
        return "$WRONG PARAMETER" if name in {"TRG", "STI"} else "$UNKNOWN COMMAND"

    def _stream(self, client: socket.socket) -> None:
        """Send packets until the end, the client's end, or ``drop_client``; nothing in a trigger mode."""
        disable_timer_slack()
        self._dropped.clear()
        self._period_ns = self.sample_time_us * 1e3 * (1.0 + self._drift)
        self._start_ns, offset, number, sent_s = time.time_ns(), self.first, 0, 0.0
        frames: list[bytes] = []
        packets: list[bytes] = []
        while not self._dropped.is_set():
            delay_s = self._random.exponential(self._delay_s) if self._delay_s and not frames else 0.0
            sent_s = max(sent_s, self.exposed_ns(number) * 1e-9 + delay_s)
            frame = self._frame(number)  # before its time, so that sending is the least delay
            if self.stopping.wait(max(0.0, sent_s - time.time())):
                return
            number += 1
            if self.skip or self.stalled.is_set() or self.trigger_mode:
                self.skip = max(0, self.skip - 1)
                frames.clear()
                continue
            frames.append(frame)
            if len(frames) < self.packet_frames:
                continue
            if self._restarted:
                offset, self._restarted = len(frames) - number, False
            packets.append(self._packet(offset + number - len(frames), frames))
            frames.clear()
            if len(packets) >= self.merged:
                self._send(client, packets)
                packets.clear()

    def _frame(self, number: int) -> bytes:
        distances = self._distances(self.exposed_ns(number))
        return b"".join(
            struct.pack("<i", digital_value(distance, greatest))
            for distance, greatest in zip(distances, self._ranges.values(), strict=True)
        )

    def _packet(self, counter: int, frames: Sequence[bytes]) -> bytes:
        channel_bits = sum(1 << 2 * (number - 1) for number in self._ranges)
        lengths = (len(frames), len(frames[0])) if self.frames_first else (len(frames[0]), len(frames))
        header = self.preamble + struct.pack(
            "<iiQiHHI", 2303_017, 12_345, channel_bits, 0, *lengths, counter % (1 << 32)
        )
        return header + b"".join(frames)

    def _send(self, client: socket.socket, packets: Sequence[bytes]) -> None:
        data = b"".join(packets)
        if self.split_at:
            client.sendall(data[: self.split_at])
            data, self.split_at = data[self.split_at :], 0
            self.split.set()
            self.released.wait()
        client.sendall(data)


def digital_value(distance: float, greatest: float) -> int:
    """Return the number of a distance: 24 bits, limited at both ends; NaN: a number beyond."""
    if math.isnan(distance):
        return FULL_SCALE + 1
    return min(max(0, round(distance / greatest * FULL_SCALE)), FULL_SCALE)
