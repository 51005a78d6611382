# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Counterparts of a LabJack with faults on demand: Modbus registers, and the stream of a T7."""

from __future__ import annotations

import struct
import time
from threading import Event
from typing import TYPE_CHECKING, Any

from posor_drivers.ros_clock import disable_timer_slack
from pyModbusTCP.server import DataBank, ModbusServer

from posor_lab.device_servers.device_server import HOST, POLL_S, DeviceServer, free_port, read_in_turn

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Sequence

PRODUCT, FIRMWARE = 60_000, 60_004
FLOAT = struct.Struct(">f")
SETUP = range(4002, 4022)
SCAN_RATE, ADDRESSES, SAMPLES, SCAN_LIST, ENABLE = 4002, 4004, 4006, 4100, 4990
RANGES = range(40_000, 40_500)
POINTER, FLASH, FLASH_CONSTANTS = 61_810, 61_812, 0x3C4000
GAIN = {10.0: 1.0, 1.0: 10.0, 0.1: 100.0, 0.01: 1000.0}
SETTLING = 4008
AUTOMATIC_US, FAST_US, FAST_SAMPLES_PER_S, CONVERSION_US = 15.0, 8.0, 60_000, 3.0
"""From channel to channel with automatic settling, above this rate, and besides a stated settling time."""
SLOPE, CENTRE = 3.16e-4, 33_510.0  # of the range of 10 V; other devices have others


class _Registers(DataBank):
    """Voltages of the present time, and the registers that a client has written."""

    def __init__(self, voltages: Callable[[int], Sequence[float]], stopping: Event) -> None:
        super().__init__(virtual_mode=True)
        self.voltages = voltages
        self.others: Callable[[int, int], list[int] | None] = lambda _address, _number: None
        self.product = 7.0
        self.written: dict[int, int] = {}
        self.stalled = Event()
        self.stopping = stopping
        self.interval_s = 0.0

    def get_holding_registers(self, address: int, number: int = 1, srv_info: object = None) -> list[int] | None:
        """Return registers; None, an illegal address, for those that a LabJack does not have."""
        del srv_info
        while self.stalled.is_set() and not self.stopping.is_set():
            time.sleep(0.01)
        if address in {PRODUCT, FIRMWARE}:
            floats: Sequence[float] = [self.product if address == PRODUCT else 1.0292]
        elif all(each in self.written for each in range(address, address + number)):
            return [self.written[each] for each in range(address, address + number)]
        else:
            if (words := self.others(address, number)) is not None:
                return words
            begin_ns, first, count = time.time_ns(), address // 2, number // 2
            inputs = range(first, min(first + count, len(self.voltages(begin_ns))))
            floats = read_in_turn(self.voltages, begin_ns, inputs, self.interval_s)
            time.sleep(self.interval_s * max(0, count - 1))
        words = [word for value in floats for word in struct.unpack(">2H", FLOAT.pack(value))]
        return words if len(words) == number else None

    def set_holding_registers(self, address: int, word_list: Sequence[int], srv_info: object = None) -> bool:
        """Store registers."""
        del srv_info
        self.written |= dict(enumerate(word_list, start=address))
        return True


class LabJackServer(DeviceServer):
    """Serves the inputs of a LabJack at a port of this host."""

    def __init__(self, voltages: Callable[[int], Sequence[float]], interval_s: float = 0.0) -> None:
        """Choose a port; ``voltages`` are those of input 0, 1, ... by the ROS time [ns], read at an interval [s]."""
        super().__init__()
        self.port = free_port()  # the port
        self.registers = _Registers(voltages, self.stopping)  # its registers: ``product``, and what was ``written``
        self.registers.interval_s = interval_s
        self.stalled = self.registers.stalled  # no question is answered while it is set
        self._server: Any = None

    def start(self) -> None:
        """Accept connections."""
        super().start()
        self._server = ModbusServer(HOST, self.port, no_block=True, data_bank=self.registers)
        self._server.start()

    def stop(self) -> None:
        """Accept no more connections, and answer no more questions."""
        super().stop()
        self._server.stop()

    def written_float(self, register: int) -> float:
        """Return the float that was written to two registers."""
        words = [self.registers.written[register], self.registers.written[register + 1]]
        value: float = FLOAT.unpack(struct.pack(">2H", *words))[0]
        return value


class LabJackStreamServer(LabJackServer):
    """Streams the inputs of a T7 to one client after another.

    Attributes:
        stream_port: Port of the stream.
        status: Status of the next packet, with its information.
        leave_out: Number of frames to leave out in the middle of the next packet, with a delimiter in their place.
        skip_packet: Leave out the number of the next packet.
        stalled: While this event is set, no packet is sent, and the frames of this time are never sent.

    """

    def __init__(self, voltages: Callable[[int], Sequence[float]], *, drift: float = 0.0) -> None:
        """Open the ports; ``voltages`` are those of input 0, 1, ... by the ROS time [ns]."""
        super().__init__(voltages)
        self.registers.others = self._read
        self.registers.stalled = Event()
        self.stalled = Event()
        self.status, self.leave_out, self.skip_packet = (0, 0), 0, False
        self._drift = drift
        self.stream_port = self.open_port(self._stream)

    def written_number(self, register: int) -> int:
        """Return the 32-bit number that was written to two registers; 0 if there was none."""
        words = [self.registers.written.get(register + n, 0) for n in range(2)]
        return words[0] << 16 | words[1]

    def _interval_s(self, count: int) -> float:
        """Return the time from one of ``count`` channels to the next."""
        if settling_us := self.written_float(SETTLING):
            return 1e-6 * (settling_us + CONVERSION_US)
        is_fast = count * self.written_float(SCAN_RATE) > FAST_SAMPLES_PER_S
        return 1e-6 * (FAST_US if is_fast else AUTOMATIC_US)

    def _read(self, address: int, number: int) -> list[int] | None:
        """Return registers that are no voltages."""
        if address == FLASH:
            gain = list(GAIN.values())[(self.written_number(POINTER) - FLASH_CONSTANTS) // 16]
            constants = (SLOPE / gain, -SLOPE / gain, CENTRE, -CENTRE * SLOPE / gain)
            return [word for each in constants for word in struct.unpack(">2H", FLOAT.pack(each))][:number]
        if address in SETUP or address in RANGES or address == ENABLE:
            return [self.registers.written.get(address + n, 0) for n in range(number)]
        return None

    def _stream(self, client: socket.socket) -> None:
        """Send packets while the stream is enabled; wait for that first."""
        disable_timer_slack()
        while not self.written_number(ENABLE):
            if self.stopping.wait(POLL_S):
                return
        count = self.written_number(ADDRESSES)
        inputs = [self.written_number(SCAN_LIST + 2 * n) // 2 for n in range(count)]
        gains = [GAIN[round(self.written_float(RANGES.start + 2 * n), 6)] for n in inputs]
        frames = self.written_number(SAMPLES) // count
        period_ns = 1e9 / self.written_float(SCAN_RATE) * (1.0 + self._drift)
        interval_s = self._interval_s(count)
        start_ns, number, packet, samples = time.time_ns(), 0, 0, b""
        while self.written_number(ENABLE) and not self.stopping.is_set():
            if self.leave_out and len(samples) == 2 * count * (frames // 2):
                samples += b"\xff" * 2 * count
                number, self.status, self.leave_out = number + self.leave_out, (2941, self.leave_out), 0
            exposed_ns = start_ns + round(number * period_ns)
            number += 1
            volts = read_in_turn(self.registers.voltages, exposed_ns, inputs, interval_s)
            samples += b"".join(sample(each, gain).to_bytes(2, "big") for each, gain in zip(volts, gains, strict=True))
            exposed_ns += round((count - 1) * interval_s * 1e9)
            if (wait_s := exposed_ns * 1e-9 - time.time()) > 0.0:
                time.sleep(wait_s)
            if self.stalled.is_set():
                samples = b""
            elif len(samples) == 2 * count * frames:
                packet += self.skip_packet
                header = struct.pack(">HHHBBBxHHH", packet, 0, 10 + len(samples), 1, 76, 16, 0, *self.status)
                client.sendall(header + samples)
                self.status, self.skip_packet, samples = (0, 0), False, b""
                packet = (packet + 1) % (1 << 16)


def sample(volts: float, gain: float) -> int:
    """Return the sample of a voltage, limited at both ends."""
    return min(max(0, round(CENTRE + volts * gain / SLOPE)), 0xFFFF)
