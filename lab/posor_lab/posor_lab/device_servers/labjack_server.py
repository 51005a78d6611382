"""Counterpart of a LabJack: its registers behind the Modbus server of pyModbusTCP, with faults on demand."""

from __future__ import annotations

import struct
import time
from threading import Event
from typing import TYPE_CHECKING, Any

from pyModbusTCP.server import DataBank, ModbusServer

from posor_lab.device_servers.device_server import HOST, DeviceServer, free_port

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

PRODUCT, FIRMWARE = 60_000, 60_004
FLOAT = struct.Struct(">f")


class _Registers(DataBank):
    """Voltages of the present time, and what was written."""

    def __init__(self, voltages: Callable[[int], Sequence[float]], stopping: Event) -> None:
        super().__init__(virtual_mode=True)
        self.voltages = voltages
        self.others: Callable[[int, int], list[int] | None] = lambda _address, _number: None
        self.product = 7.0
        self.written: dict[int, int] = {}
        self.stalled = Event()
        self.stopping = stopping

    def get_holding_registers(self, address: int, number: int = 1, srv_info: object = None) -> list[int] | None:
        """Return registers; None, an illegal address, for those that a LabJack does not have."""
        del srv_info
        while self.stalled.is_set() and not self.stopping.is_set():
            time.sleep(0.01)
        if address in {PRODUCT, FIRMWARE}:
            floats: Sequence[float] = [self.product if address == PRODUCT else 1.0292]
        else:
            if (words := self.others(address, number)) is not None:
                return words
            floats = self.voltages(time.time_ns())[address // 2 : (address + number) // 2]
        words = [word for value in floats for word in struct.unpack(">2H", FLOAT.pack(value))]
        return words if len(words) == number else None

    def set_holding_registers(self, address: int, word_list: Sequence[int], srv_info: object = None) -> bool:
        """Store registers."""
        del srv_info
        self.written |= dict(enumerate(word_list, start=address))
        return True


class LabJackServer(DeviceServer):
    """Serves the inputs of a LabJack at a port of this host.

    Attributes:
        port: The port.
        registers: Its registers: ``product``, and what was ``written``.
        stalled: No question is answered while it is set.

    """

    def __init__(self, voltages: Callable[[int], Sequence[float]]) -> None:
        """Choose a port; ``voltages`` are those of input 0, 1, ... by the ROS time [ns]."""
        super().__init__()
        self.port = free_port()
        self.registers = _Registers(voltages, self.stopping)
        self.stalled = self.registers.stalled
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
