# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Device ``labjack``: analogue inputs of a LabJack T4, T7 or T8 over Modbus TCP, asked for each frame.

::

    kind: labjack
    host: 192.168.0.8
    rate: {value: 500, unit: Hz}
    channels:
      current1: {input: 0, range: {value: 10, unit: V}}
      current2: {input: 1, range: {value: 10, unit: V}, negative_input: 199}

Channels are in volts. A value beyond ``range`` is invalid, NaN; so is one beyond every range, such as the -9999 of an
input that cannot be read. Settings of an input that are not stated are left as
they are in the device. A T8 converts its inputs at one time. A T4 or T7 converts them one after another, in ascending
order, at an interval that depends on settling time, range and resolution index: unknown unless ``exposures`` states it.

Source: ``labjack_registers``; the resolution index (``AIN#_RESOLUTION_INDEX``) is 16 bits at 41500 + n. Never run with
a LabJack, only with a Modbus server. ``labjack_stream`` is the stream mode.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from posor_drivers.instruments.device import Host, Port
from posor_drivers.instruments.labjack_registers import (
    LONG_REGISTERS,
    NEGATIVE_INPUT,
    PRODUCTS,
    RANGE,
    RESOLUTION_INDEX,
    VOLTAGE,
    LabJackInput,
    LabJackRegisters,
    starting_inputs,
)
from posor_drivers.instruments.polled_device import PolledDevice, PolledSettings

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

BEYOND_RANGES_V = 12.0
T8 = 8
"""Product that converts all inputs at one time."""
MOST_REGISTERS = 124
"""That one question can ask for, in whole floats."""


class LabJackChannel(LabJackInput):
    """An analogue input that is asked for."""

    resolution_index: Annotated[int, Field(strict=True, ge=0, le=12)] | None = None


class LabJackSettings(PolledSettings):
    """Keys of a LabJack."""

    kind: Literal["labjack"]
    host: Host
    port: Port = 502
    channels: Annotated[dict[str, LabJackChannel], Field(min_length=1)]


class LabJackDevice(PolledDevice[LabJackSettings]):
    """Reads the inputs that lie next to each other with one question."""

    Settings = LabJackSettings
    connection: LabJackRegisters | None

    def __init__(self, name: str, settings: LabJackSettings) -> None:
        """Prepare the questions of a frame."""
        super().__init__(name, settings)
        self._inputs = [channel.input for channel in settings.channels.values()]
        self._questions = _questions(self._inputs)
        ranges = [channel.range for channel in settings.channels.values()]
        self._greatest = np.array([BEYOND_RANGES_V if each is None else each.number for each in ranges])
        self.channel_interval_s = math.nan

    @property
    def reading_order(self) -> Sequence[int]:
        """In ascending order of the inputs."""
        inputs = sorted(set(self._inputs))
        return [inputs.index(each) for each in self._inputs]

    @classmethod
    def starting_settings(cls, units: Mapping[str, str]) -> dict[str, Any]:
        """Return an input for each reading that is not a whole number."""
        return starting_inputs(units, 500)

    @property
    def address(self) -> str:
        """Host and port."""
        return f"{self.settings.host}:{self.settings.port}"

    def connect(self, timeout_s: float) -> str:
        """Check the product and set up the inputs."""
        settings = self.settings
        limit_s = min(timeout_s, settings.answer_time_s)
        self.connection = registers = LabJackRegisters(self.error, settings.host, settings.port, limit_s)
        identity = registers.identity()
        is_simultaneous = identity.startswith(PRODUCTS[T8]) and len(self._questions) == 1
        self.channel_interval_s = 0.0 if is_simultaneous else math.nan
        for channel in settings.channels.values():
            registers.set_up(channel)
            if channel.resolution_index is not None:
                registers.write_short(RESOLUTION_INDEX + channel.input, channel.resolution_index)
        return identity

    def settings_in_force(self) -> Mapping[str, object]:
        """Return the ranges and negative inputs that are stated."""
        found: dict[str, object] = {}
        for what, register, words in (("range", RANGE, LONG_REGISTERS), ("negative_input", NEGATIVE_INPUT, 1)):
            stated = [each.input for each in self.settings.channels.values() if getattr(each, what) is not None]
            for first, count in _questions(stated):
                read = self._registers.read_floats if words == LONG_REGISTERS else self._registers.read_shorts
                values = read(register + words * first, count)
                found |= {f"{what} of input {first + n}": value for n, value in enumerate(values)}
        return found

    @property
    def _registers(self) -> LabJackRegisters:
        if self.connection is None:
            raise self.error("no connection", "a call of connect before")
        return self.connection

    def ask(self) -> Sequence[float]:
        """Return the voltage of each channel."""
        voltages: dict[int, float] = {}
        for first, count in self._questions:
            found = self._registers.read_floats(VOLTAGE + LONG_REGISTERS * first, count)
            voltages |= {first + n: voltage for n, voltage in enumerate(found)}
        values = np.array([voltages[number] for number in self._inputs])
        valid: Sequence[float] = np.where(np.abs(values) <= self._greatest, values, np.nan).tolist()
        return valid


def _questions(inputs: Sequence[int]) -> list[tuple[int, int]]:
    """Return first input and number of inputs of each run of neighbours that one question can ask for."""
    questions: list[tuple[int, int]] = []
    for number in sorted(set(inputs)):
        first, count = questions[-1] if questions else (number, 0)
        if number == first + count and LONG_REGISTERS * count < MOST_REGISTERS:
            questions[-1:] = [(first, count + 1)]
        else:
            questions.append((number, 1))
    return questions
