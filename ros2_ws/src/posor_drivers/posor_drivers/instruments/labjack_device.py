"""Device ``labjack``: analogue inputs of a LabJack T4, T7 or T8 over Modbus TCP, asked for each frame.

::

    kind: labjack
    host: 192.168.0.8
    rate: {value: 500, unit: Hz}
    channels:
      current1: {input: 0, range: {value: 10, unit: V}}
      current2: {input: 1, range: {value: 10, unit: V}, negative_input: 199}

Channels are in volts. A value beyond ``range`` is invalid, NaN. Settings of an input that are not stated are left as
they are in the device.

Source: Modbus map of the T series. Registers hold big-endian numbers with the high word first: the voltage of input n
(``AIN#``) is a 32-bit float at 2 n, its range (``AIN#_RANGE``) at 40000 + 2 n, its negative input
(``AIN#_NEGATIVE_CH``) 16 bits at 41000 + n, its resolution index (``AIN#_RESOLUTION_INDEX``) 16 bits at 41500 + n;
product and firmware are floats at 60000 and 60004. Never run with a LabJack, only with a Modbus server. The stream mode
of the device is not used: it sends raw converter values, which need the constants in its memory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from posor_estimator.calibration.file_model import FrozenModel
from posor_estimator.calibration.quantity import Quantity, measured
from pydantic import Field

from posor_drivers.instruments.device import Channel, DeviceError
from posor_drivers.instruments.polled_device import PolledDevice, PolledSettings
from posor_drivers.simulator.scenario_limits import POSITIVE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

PRODUCTS = {4: "LabJack T4", 7: "LabJack T7", 8: "LabJack T8"}
VOLTAGE, RANGE, NEGATIVE_INPUT, RESOLUTION_INDEX = 0, 40_000, 41_000, 41_500
"""First registers of the analogue inputs."""
PRODUCT, FIRMWARE = 60_000, 60_004
FLOAT_REGISTERS = 2
MOST_REGISTERS = 124
"""That one question can ask for, in whole floats."""


class LabJackChannel(FrozenModel):
    """An analogue input."""

    input: Annotated[int, Field(strict=True, ge=0, le=254)]
    range: Annotated[Quantity, measured("V"), POSITIVE] | None = None
    negative_input: Annotated[int, Field(strict=True, ge=0, le=199)] | None = None
    resolution_index: Annotated[int, Field(strict=True, ge=0, le=12)] | None = None


class LabJackSettings(PolledSettings):
    """Keys of a LabJack."""

    kind: Literal["labjack"]
    host: str
    port: Annotated[int, Field(strict=True, ge=1, le=65_535)] = 502
    channels: Annotated[dict[str, LabJackChannel], Field(min_length=1)]


class LabJackDevice(PolledDevice[LabJackSettings]):
    """Reads the inputs that lie next to each other with one question."""

    Settings = LabJackSettings

    def __init__(self, name: str, settings: LabJackSettings) -> None:
        """Prepare the questions of a frame."""
        super().__init__(name, settings)
        self._inputs = [channel.input for channel in settings.channels.values()]
        self._questions = _questions(self._inputs)
        self._greatest = [
            np.inf if channel.range is None else channel.range.number for channel in settings.channels.values()
        ]
        self._client: Any = None

    @classmethod
    def starting_settings(cls, units: Mapping[str, str]) -> dict[str, Any]:
        """Return an input for each reading that is not a whole number."""
        analogue = [name for name, unit in units.items() if unit != "1"]
        return {
            "host": "192.168.0.8",
            "rate": {"value": 500, "unit": "Hz"},
            "channels": {name: {"input": n, "range": {"value": 10.0, "unit": "V"}} for n, name in enumerate(analogue)},
        }

    @property
    def channels(self) -> Sequence[Channel]:
        """The channels of the settings."""
        return [Channel(name, "V") for name in self.settings.channels]

    @property
    def address(self) -> str:
        """Host and port."""
        return f"{self.settings.host}:{self.settings.port}"

    def connect(self, timeout_s: float) -> str:
        """Check the product and set up the inputs."""
        from pymodbus.client import ModbusTcpClient  # noqa: PLC0415  slow to import, and few users have this device

        limit_s = min(timeout_s, self.settings.answer_time_s)
        self._client = ModbusTcpClient(
            self.settings.host, port=self.settings.port, timeout=limit_s, retries=0, reconnect_delay=0
        )
        try:
            connected = self._client.connect()
        except (OSError, UnicodeError):  # UnicodeError: the host is no valid name
            connected = False
        if not connected:
            raise self._error(f"no connection to {self.address} within {limit_s:g} s", "a LabJack")
        product, firmware = self._read_floats(PRODUCT, 1)[0], self._read_floats(FIRMWARE, 1)[0]
        if product not in PRODUCTS:
            raise self._error(f"the product is {product:g}", ", ".join(f"{n} ({each})" for n, each in PRODUCTS.items()))
        kinds = self._client.DATATYPE
        for channel in self.settings.channels.values():
            n = channel.input
            if channel.range is not None:
                self._write(RANGE + FLOAT_REGISTERS * n, channel.range.number, kinds.FLOAT32)
            if channel.negative_input is not None:
                self._write(NEGATIVE_INPUT + n, channel.negative_input, kinds.UINT16)
            if channel.resolution_index is not None:
                self._write(RESOLUTION_INDEX + n, channel.resolution_index, kinds.UINT16)
        return f"{PRODUCTS[int(product)]}, firmware {firmware:.4f}"

    def ask(self) -> Sequence[float]:
        """Return the voltage of each channel."""
        voltages: dict[int, float] = {}
        for first, count in self._questions:
            found = self._read_floats(VOLTAGE + FLOAT_REGISTERS * first, count)
            voltages |= {first + n: voltage for n, voltage in enumerate(found)}
        values = [voltages[number] for number in self._inputs]
        return [
            value if abs(value) <= greatest else np.nan for value, greatest in zip(values, self._greatest, strict=True)
        ]

    def close(self) -> None:
        """Close the connection."""
        if self._client is not None:
            self._client.close()
            self._client = None

    def _read_floats(self, register: int, count: int) -> Sequence[float]:
        answer = self._call(register, "read_holding_registers", register, count=FLOAT_REGISTERS * count)
        if len(answer.registers) != FLOAT_REGISTERS * count:
            what = f"{len(answer.registers)} registers in the answer for register {register}"
            raise self._error(what, f"{FLOAT_REGISTERS * count}")
        words = np.array(answer.registers, dtype=">u2")
        floats: Sequence[float] = words.view(">f4").astype(np.float64).tolist()
        return floats

    def _write(self, register: int, value: float, kind: Any) -> None:
        self._call(register, "write_registers", register, self._client.convert_to_registers(value, kind))

    def _call(self, register: int, method: str, *arguments: Any, **options: Any) -> Any:
        """Call the client and return the answer.

        Raises:
            DeviceError: No answer, or a Modbus exception.

        """
        from pymodbus.exceptions import ModbusException  # noqa: PLC0415  see connect

        try:
            answer = getattr(self._client, method)(*arguments, **options)
        except (ModbusException, OSError) as error:
            raise self._error(f"no answer for register {register}, {error}", "an answer in time") from None
        if answer.isError():
            code = getattr(answer, "exception_code", "unknown")
            expected = "registers of a LabJack; the input may not exist"
            raise self._error(f"Modbus exception {code} for register {register}", expected)
        return answer

    def _error(self, what: str, expected: str) -> DeviceError:
        return DeviceError(what, where=self.name, expected=expected)


def _questions(inputs: Sequence[int]) -> list[tuple[int, int]]:
    """Return first input and number of inputs of each run of neighbours that one question can ask for."""
    questions: list[tuple[int, int]] = []
    for number in sorted(set(inputs)):
        first, count = questions[-1] if questions else (number, 0)
        if number == first + count and FLOAT_REGISTERS * count < MOST_REGISTERS:
            questions[-1:] = [(first, count + 1)]
        else:
            questions.append((number, 1))
    return questions
