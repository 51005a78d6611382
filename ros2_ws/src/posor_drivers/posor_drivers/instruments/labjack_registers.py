# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Inputs and registers of a LabJack over Modbus TCP, for its devices.

Source: Modbus map of the T series. Registers hold big-endian numbers with the high word first: the voltage of input n
(``AIN#``) is a 32-bit float at 2 n, its range (``AIN#_RANGE``) at 40000 + 2 n, its negative input
(``AIN#_NEGATIVE_CH``) 16 bits at 41000 + n; product and firmware are floats at 60000 and 60004.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from posor.calibration.file_model import FrozenModel
from posor.calibration.quantity import Quantity, measured
from pydantic import Field

from posor_drivers.instruments.device import DeviceError, starting_channels
from posor_drivers.quantity_limits import POSITIVE

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

PRODUCTS = {4: "LabJack T4", 7: "LabJack T7", 8: "LabJack T8"}
VOLTAGE, RANGE, NEGATIVE_INPUT, RESOLUTION_INDEX = 0, 40_000, 41_000, 41_500
"""First registers of the analogue inputs."""
PRODUCT, FIRMWARE = 60_000, 60_004
LONG_REGISTERS = 2
"""Of a float or a 32-bit number."""


class LabJackInput(FrozenModel):
    """An analogue input."""

    unit: ClassVar[str] = "V"
    input: Annotated[int, Field(strict=True, ge=0, le=254)]
    range: Annotated[Quantity, measured("V"), POSITIVE] | None = None
    negative_input: Annotated[int, Field(strict=True, ge=0, le=199)] | None = None


def starting_inputs(units: Mapping[str, str], rate_hz: int) -> dict[str, Any]:
    """Return example settings with an input for each reading that is not a whole number."""
    channels = starting_channels(units, lambda n: {"input": n, "range": {"value": 10.0, "unit": "V"}})
    return {"host": "192.168.0.8", "rate": {"value": rate_hz, "unit": "Hz"}, "channels": channels}


class LabJackRegisters:
    """Connection to the registers of a LabJack; its errors name the device."""

    def __init__(self, error: Callable[[str, str], DeviceError], host: str, port: int, timeout_s: float) -> None:
        """Connect; ``error`` is that of the device.

        Raises:
            DeviceError: The device cannot be reached within the time, which also limits each answer.

        """
        from pymodbus.client import ModbusTcpClient  # noqa: PLC0415  slow to import, and few users have this device

        self.error = error
        self._client = ModbusTcpClient(host, port=port, timeout=timeout_s, retries=0, reconnect_delay=0)
        try:
            connected = self._client.connect()
        except (OSError, UnicodeError):  # UnicodeError: the host is no valid name
            connected = False
        if not connected:
            raise self.error(f"no connection to {host}:{port} within {timeout_s:g} s", "a LabJack")

    def identity(self, products: Collection[int] = tuple(PRODUCTS)) -> str:
        """Return product and firmware.

        Raises:
            DeviceError: The product is another one.

        """
        product, firmware = self.read_floats(PRODUCT, 1)[0], self.read_floats(FIRMWARE, 1)[0]
        if product not in products:
            expected = ", ".join(f"{n} ({PRODUCTS[n]})" for n in products)
            raise self.error(f"the product is {product:g}", expected)
        return f"{PRODUCTS[int(product)]}, firmware {firmware:.4f}"

    def set_up(self, channel: LabJackInput) -> None:
        """Write the settings of an input that are stated."""
        if channel.range is not None:
            self.write_float(RANGE + LONG_REGISTERS * channel.input, channel.range.number)
        if channel.negative_input is not None:
            self.write_short(NEGATIVE_INPUT + channel.input, channel.negative_input)

    def read_floats(self, register: int, count: int) -> Sequence[float]:
        """Return consecutive floats."""
        floats: Sequence[float] = self._read(register, LONG_REGISTERS * count).view(">f4").astype(np.float64).tolist()
        return floats

    def read_shorts(self, register: int, count: int) -> Sequence[int]:
        """Return consecutive 16-bit numbers."""
        words: Sequence[int] = self._read(register, count).tolist()
        return words

    def read_number(self, register: int) -> int:
        """Return a 32-bit number."""
        return int(self._read(register, LONG_REGISTERS).view(">u4")[0])

    def write_float(self, register: int, value: float) -> None:
        """Write a float."""
        self._write(register, np.array([value], dtype=">f4"))

    def write_number(self, register: int, value: int) -> None:
        """Write a 32-bit number."""
        self._write(register, np.array([value], dtype=">u4"))

    def write_short(self, register: int, value: int) -> None:
        """Write a 16-bit number."""
        self._write(register, np.array([value], dtype=">u2"))

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def _read(self, register: int, count: int) -> Any:
        """Return the words of consecutive registers."""
        answer = self._call(register, "read_holding_registers", register, count=count)
        if len(answer.registers) != count:
            raise self.error(f"{len(answer.registers)} registers in the answer for register {register}", f"{count}")
        return np.array(answer.registers, dtype=">u2")

    def _write(self, register: int, values: Any) -> None:
        self._call(register, "write_registers", register, values.view(">u2").tolist())

    def _call(self, register: int, method: str, *arguments: Any, **options: Any) -> Any:
        """Call the client and return the answer.

        Raises:
            DeviceError: No answer, or a Modbus exception.

        """
        from pymodbus.exceptions import ModbusException  # noqa: PLC0415  see __init__

        try:
            answer = getattr(self._client, method)(*arguments, **options)
        except (ModbusException, OSError) as error:
            raise self.error(f"no answer for register {register}, {error}", "an answer in time") from None
        if answer.isError():
            code = getattr(answer, "exception_code", "unknown")
            expected = "registers of a LabJack; the input may not exist"
            raise self.error(f"Modbus exception {code} for register {register}", expected)
        return answer
