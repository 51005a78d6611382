# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Device ``scpi``: scanners and multimeters that answer text commands, through PyVISA with its own library pyvisa-py.

::

    kind: scpi
    address: TCPIP::192.168.0.7::5025::SOCKET
    dialect: keysight_daq970a
    rate: {value: 5, unit: Hz}
    channels:
      gap1: {number: 101, unit: V}
      gap2: {number: 102, unit: V}
      plate: {number: 103, unit: degC, function: thermocouple_k}

Each channel measures with one of the ``functions`` of the dialect, which states the unit of its readings and sets up
the instrument. ``function`` may be left out where only one function of the dialect gives the unit of the channel.

``channel_delay`` and ``aperture`` (integration time: power line cycles over line frequency) are written to the
instrument; ``overhead`` is what it needs for each channel besides, such as for switching and auto zero. Channels are
read in ascending order of their numbers, at an interval of the sum of the three; without aperture it is unknown.

With the key ``light`` the device switches the light sources by a digital output, and has a further channel ``light``: 1
while they are lit, 0 in the dark frames at the interval. Three dark frames follow one another, because a scan is
interpolated between three; the first frames are dark. A second process of the host that would switch it is refused::

      light: {output: 204, lit: 1, dark: 0, interval: {value: 60, unit: s}}

``address`` is a VISA resource: TCP socket, VXI-11 (``TCPIP::host::INSTR``), HiSLIP (``TCPIP::host::hislip0::INSTR``),
or a serial port with pyserial. ``dialect`` is the name of a file in ``scpi_dialects`` beside this module or the path of
a dialect file of your own (its name ends in ``.yaml``); the commands of an instrument are written there, not in code.

Versions of dialect files:

1. First version: one ``setup`` for all channels, whose unit nothing stated.
2. ``functions`` with unit, set-up and ``aperture``; ``scan_list``, ``function``.
"""

from __future__ import annotations

import math
import re
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from posor.calibration.file_model import EntryError, Expression, FrozenModel
from posor.calibration.yaml_document import load_document
from posor.claim import claim
from posor.tables.number_text import OVERLOAD, parse_number
from pydantic import Field, model_validator

from posor_drivers.instruments.device import Channel, refuse_repeated_numbers, starting_channels
from posor_drivers.instruments.polled_device import PolledDevice, PolledSettings
from posor_drivers.quantity_limits import Delay, Seconds

if TYPE_CHECKING:
    import socket
    from collections.abc import Mapping, Sequence

    from posor.calibration.quantity import Quantity

    from posor_drivers.instruments.device import Frames

DIALECTS = Path(__file__).parent / "scpi_dialects"
DIALECT_VERSION = 2
LIGHT = "light"
DARK_FRAMES = 3
"""Frames in a row without light."""
MOST_ERRORS = 20
"""Errors that are read from the queue; it may be as long."""


class MeasuringFunction(FrozenModel):
    """What an instrument can measure; ``{numbers}`` stands for the numbers of the channels with this function."""

    unit: Annotated[str, Field(min_length=1)]
    """Of the readings."""
    setup: tuple[str, ...] = ()
    aperture: str = ""
    """Command that sets the integration time ``{value}`` [s]."""
    answer: Expression = ""
    """Contained in the answer to the question ``function`` of the dialect."""


class Dialect(FrozenModel):
    """Commands of an instrument; ``{numbers}`` stands for the channel numbers in ascending order, with commas."""

    format: Literal["posor_scpi_dialect"]
    version: Literal[2]
    identify: str
    """Question for the model."""
    model: Expression
    """Contained in the answer."""
    setup: tuple[str, ...] = ()
    """Commands before those of the functions."""
    functions: Annotated[dict[str, MeasuringFunction], Field(min_length=1)]
    function: str = ""
    """Question for the function of an instrument that is set up by hand."""
    unchanged: tuple[str, ...] = ()
    """Questions for settings that nobody may change while the driver runs; asked once a second."""
    scan_list: str = ""
    """Command after those of the functions that chooses the channels."""
    channel_delay: str = ""
    """Command that sets the time from switching to a channel to its measurement, ``{value}`` [s]."""
    digital_output: str = ""
    """Command that sets the digital output ``{number}`` to ``{value}``."""
    read: str
    """Question for one value of each channel, in ascending order of the numbers."""
    separator: str = ","
    overload: Annotated[float, Field(strict=True, gt=0.0)] = OVERLOAD
    """A value of at least this size, of either sign, is out of range."""
    error: str
    """Question for the oldest entry of the error queue, which it removes."""
    no_error: Expression
    """Contained in the answer of an empty queue."""
    termination: str = "\n"


class ScpiChannel(FrozenModel):
    """A channel: its number in the instrument, the unit of its readings, and the function that gives it."""

    number: Annotated[int, Field(strict=True, ge=0)]
    unit: str
    function: str = ""


class LightSwitch(FrozenModel):
    """Digital output that switches the light sources: its number, its values, and the interval of dark frames."""

    output: Annotated[int, Field(strict=True, ge=0)]
    lit: Annotated[int, Field(strict=True, ge=0)] = 1
    dark: Annotated[int, Field(strict=True, ge=0)] = 0
    interval: Seconds


class ScpiSettings(PolledSettings):
    """Keys of an instrument with text commands."""

    kind: Literal["scpi"]
    address: str
    dialect: str
    channels: Annotated[dict[str, ScpiChannel], Field(min_length=1)]
    channel_delay: Delay | None = None
    aperture: Seconds | None = None
    overhead: Delay | None = None
    light: LightSwitch | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse_repeated_numbers({name: channel.number for name, channel in self.channels.items()})
        if self.light is not None and LIGHT in self.channels:
            raise EntryError(f"channel '{LIGHT}'", key=("channels", LIGHT), expected="another name, with the key light")
        if not self.dialect_path.is_file():
            known = ", ".join(sorted(path.stem for path in DIALECTS.glob("*.yaml")))
            expected = f"one of {known}, or the path of a file"
            raise EntryError(f"dialect '{self.dialect}'", key=("dialect",), expected=expected)
        return self

    @property
    def dialect_path(self) -> Path:
        """The dialect file."""
        return Path(self.dialect) if self.dialect.endswith(".yaml") else DIALECTS / f"{self.dialect}.yaml"


class ScpiDevice(PolledDevice[ScpiSettings]):
    """Asks the instrument for a reading of every channel in each period."""

    Settings = ScpiSettings

    def __init__(self, name: str, settings: ScpiSettings) -> None:
        """Read the dialect.

        Raises:
            CalibrationError: The dialect file cannot be read, or holds an invalid entry.

        """
        super().__init__(name, settings)
        keys = "format, version, identify, model, setup, functions, read, separator, error, no_error"
        path, check = settings.dialect_path, Dialect.model_validate
        self._dialect = load_document(path, "dialect file", keys, DIALECT_VERSION, check)[0]
        self._numbers = [channel.number for channel in settings.channels.values()]
        self._numbers_of: dict[str, list[int]] = {}  # by function, ascending
        for channel_name, channel in sorted(settings.channels.items(), key=lambda entry: entry[1].number):
            self._numbers_of.setdefault(self._function_of(channel_name, channel), []).append(channel.number)
        self._identity = ""
        self._dark_left, self._next_dark_s = 0, 0.0
        self._claim: socket.socket | None = None
        apertures = [self._dialect.functions[function].aperture for function in self._numbers_of]
        for key, command, found in (
            ("channel_delay", "channel_delay", self._dialect.channel_delay),
            ("aperture", "aperture", all(apertures)),
            (LIGHT, "digital_output", self._dialect.digital_output),
        ):
            if getattr(settings, key) is not None and not found:
                raise self.error(f"dialect '{settings.dialect}' has no command '{command}'", f"no key '{key}'")
        times = [settings.channel_delay, settings.aperture, settings.overhead]
        interval_s = sum(each.number for each in times if each is not None)
        self.channel_interval_s = math.nan if settings.aperture is None else interval_s

    def _function_of(self, name: str, channel: ScpiChannel) -> str:
        """Return the function of a channel; raise DeviceError where it does not give the unit of the channel."""
        functions, dialect = self._dialect.functions, f"dialect '{self.settings.dialect}'"
        if channel.function:
            if channel.function not in functions:
                what = f"function '{channel.function}' of channel '{name}'"
                raise self.error(what, f"one of {', '.join(functions)}, which {dialect} has")
            if (unit := functions[channel.function].unit) != channel.unit:
                what = f"unit '{channel.unit}' of channel '{name}', whose function is {channel.function}"
                raise self.error(what, f"unit '{unit}'")
            return channel.function
        found = [each for each, function in functions.items() if function.unit == channel.unit]
        if not found:
            known = ", ".join(dict.fromkeys(function.unit for function in functions.values()))
            raise self.error(f"unit '{channel.unit}' of channel '{name}'", f"one of {known}, which {dialect} sets up")
        if len(found) > 1:
            what = f"channel '{name}' of unit '{channel.unit}' has no key 'function'"
            raise self.error(what, f"one of {', '.join(found)}")
        return found[0]

    @property
    def channels(self) -> Sequence[Channel]:
        """Those of the key ``channels``, and ``light`` where the device switches it."""
        light = [] if self.settings.light is None else [Channel(LIGHT, "1")]
        return [*super().channels, *light]

    @property
    def reading_order(self) -> Sequence[int]:
        """In ascending order of the numbers; the light is that of the last one."""
        numbers = sorted(self._numbers)
        order = [numbers.index(number) for number in self._numbers]
        return order if self.settings.light is None else [*order, len(numbers) - 1]

    @classmethod
    def starting_settings(cls, units: Mapping[str, str]) -> dict[str, Any]:
        """Return a channel for each reading that is not a whole number."""
        return {
            "address": "TCPIP::192.168.0.7::5025::SOCKET",
            "dialect": "keysight_daq970a",
            "rate": {"value": 5, "unit": "Hz"},
            "channels": starting_channels(units, lambda n: {"number": 101 + n, "unit": "V"}),
        }

    @property
    def address(self) -> str:
        """The VISA resource."""
        return self.settings.address

    def connect(self, timeout_s: float) -> str:
        """Check the model, set up the scan, and look for errors."""
        import pyvisa  # noqa: PLC0415  slow to import, and few users have such a device
        from pyvisa.resources import MessageBasedResource  # noqa: PLC0415

        dialect = self._dialect
        try:
            instrument: Any = pyvisa.ResourceManager("@py").open_resource(
                self.address, open_timeout=round(1e3 * timeout_s), resource_pyclass=MessageBasedResource
            )
            self.connection = instrument  # not the resource manager, which all devices of the process share
            instrument.timeout = round(1e3 * self.settings.answer_time_s)
            instrument.read_termination = instrument.write_termination = dialect.termination
        except Exception as error:  # noqa: BLE001  pyvisa-py raises a plain Exception where the host cannot be reached
            raise self.error(f"no connection to {self.address}, {error}", "an instrument at this address") from None
        self._identity = identity = self._query(dialect.identify)
        if re.search(dialect.model, identity) is None:
            raise self.error(f"the instrument is '{identity}'", f"a model that matches '{dialect.model}'")
        if self.settings.light is not None:
            self._claim_light(self.settings.light)
        every = sorted(self._numbers)
        self._set_up(dialect.setup, every)
        for name, numbers in self._numbers_of.items():
            self._set_up(dialect.functions[name].setup, numbers)
        self._check_functions()
        self._set_up((dialect.scan_list,), every)
        self._set_up((dialect.channel_delay,), every, self.settings.channel_delay)
        for name, numbers in self._numbers_of.items():
            self._set_up((dialect.functions[name].aperture,), numbers, self.settings.aperture)
        self._dark_left, self._next_dark_s = 0, time.monotonic()
        if self.settings.light is not None:
            self._switch_light(self.settings.light)
        self._check_errors()
        return identity

    def close(self) -> None:
        """Close the connection; another driver may switch the light."""
        super().close()
        if self._claim is not None:
            self._claim.close()
            self._claim = None

    def _claim_light(self, light: LightSwitch) -> None:
        """Let no other driver of this host switch the light. Raises DeviceError: another one does."""
        what = f"another driver switches the light, output {light.output} of {self.address}"
        refusal = self.error(what, "all drivers of such a device in one process, as with --layout composed")
        self._claim = claim(f"light:{self.address.upper()}:{light.output}", refusal)

    def _set_up(self, commands: Sequence[str], numbers: Sequence[int], *times: Quantity | None) -> None:
        """Write commands for some channels, and those that set a time only if the time is stated."""
        if None in times:
            return
        for command in filter(None, commands):
            value = "".join(f"{each.number:.6g}" for each in times if each is not None)
            self._transfer("write", command.replace("{numbers}", ",".join(map(str, numbers))).replace("{value}", value))

    def read(self, timeout_s: float) -> Frames | None:
        """Return the next frame, and switch the light."""
        frames = super().read(timeout_s)
        if frames is not None:
            self._refuse_unsolicited_line()  # the first of two lines may be no answer
            if self.settings.light is not None:
                self._switch_light(self.settings.light)
        return frames

    def _switch_light(self, light: LightSwitch) -> None:
        """Switch the light sources between two frames."""
        now_s = time.monotonic()
        if self._dark_left > 1:
            self._dark_left -= 1
            return
        begins = self._dark_left == 0 and now_s >= self._next_dark_s
        if begins or self._dark_left == 1:
            self._dark_left = DARK_FRAMES if begins else 0
            self._next_dark_s = now_s + light.interval.number if begins else self._next_dark_s
            value = light.dark if begins else light.lit
            command = self._dialect.digital_output.replace("{number}", str(light.output))
            self._transfer("write", command.replace("{value}", str(value)))

    def settings_in_force(self) -> Mapping[str, object]:
        """Look for errors and other functions; return the answers to the questions ``unchanged`` of the dialect."""
        self._check_errors()
        self._check_functions()
        numbers = ",".join(map(str, sorted(self._numbers)))
        questions = [each.replace("{numbers}", numbers) for each in self._dialect.unchanged]
        return {f"the answer to '{each}'": self._query(each) for each in questions}

    def before_query(self) -> None:
        """Raise DeviceError: the instrument has sent a line that no query asked for, or a setting has changed."""
        self._refuse_unsolicited_line()
        super().before_query()

    def _refuse_unsolicited_line(self) -> None:
        """Raise DeviceError: there is a line, and each answer would be taken for the answer to the next query.

        Only on a socket or a serial port: VXI-11 and HiSLIP return an answer to its own query. Of a line that comes in
        parts to a socket the first part may be lost.
        """
        from pyvisa.constants import VI_ATTR_ASRL_AVAIL_NUM, StatusCode  # noqa: PLC0415  see connect
        from pyvisa.errors import Error  # noqa: PLC0415

        address, instrument, answer_time_ms = self.address.upper(), self.connection, self.connection.timeout
        is_serial = address.startswith("ASRL")
        if not (is_serial or address.endswith("::SOCKET")):
            return
        try:
            if is_serial and not instrument.get_visa_attribute(VI_ATTR_ASRL_AVAIL_NUM):
                return
            instrument.timeout = answer_time_ms if is_serial else 0
            line = instrument.read()
        except (Error, OSError, UnicodeDecodeError) as error:
            if getattr(error, "error_code", None) != StatusCode.error_timeout or is_serial:
                raise self.error(f"reading without a query failed, {error}", "a connection without a line") from None
        else:
            raise self.error(f"the instrument sent the unsolicited line '{line}'", "one line for each query")
        finally:
            instrument.timeout = answer_time_ms

    def _refuse_shifted_answers(self) -> None:
        """Raise DeviceError: an extra line, such as a greeting, has shifted the answers by one query.

        To be called before an answer is refused, because a shifted one says nothing about its query.
        """
        if (answer := self._query(self._dialect.identify)) != self._identity:
            what = f"the answers to '{self._dialect.identify}' are '{self._identity}' and then '{answer}'"
            raise self.error(what, "one line for each query")

    def ask(self) -> Sequence[float]:
        """Return the reading of each channel."""
        dialect = self._dialect
        answer = self._query(dialect.read)
        try:
            readings = [parse_number(number) for number in answer.split(dialect.separator)]
        except ValueError:
            readings = []
        if len(readings) != len(self._numbers):
            self._refuse_shifted_answers()
            self._check_errors()
            what = f"the answer to '{dialect.read}' is '{answer}'"
            raise self.error(what, f"{len(self._numbers)} numbers, separated by '{dialect.separator}'")
        by_number = dict(zip(sorted(self._numbers), readings, strict=True))
        values = [by_number[number] for number in self._numbers]
        read = [value if abs(value) < dialect.overload else math.nan for value in values]
        return read if self.settings.light is None else [*read, float(self._dark_left == 0)]

    def _check_functions(self) -> None:
        """Raise DeviceError: the instrument is set up by hand, and measures something else than its channel states."""
        for name in self._numbers_of if self._dialect.function else ():
            answer, expected = self._query(self._dialect.function), self._dialect.functions[name].answer
            if not re.search(expected, answer):
                self._refuse_shifted_answers()
                raise self.error(f"the instrument measures {answer}", f"{name}, '{expected}'")

    def _check_errors(self) -> None:
        """Empty the error queue.

        Raises:
            DeviceError: It was not empty.

        """
        errors: Counter[str] = Counter()
        while errors.total() < MOST_ERRORS:
            answer = self._query(self._dialect.error)
            if re.search(self._dialect.no_error, answer):
                break
            errors[answer] += 1
        if errors:
            self._refuse_shifted_answers()
            texts = (text if count == 1 else f"{text} ({count} times)" for text, count in errors.items())
            raise self.error(f"the instrument reports {'; '.join(texts)}", "an empty error queue")

    def _query(self, command: str) -> str:
        """Return the answer to a question. Raises DeviceError: there is none, or only the question again."""
        answer: str = self._transfer("query", command).strip()
        if answer == command.strip():
            raise self.error(f"the instrument echoes '{command}'", "answers without the question")
        return answer

    def _transfer(self, method: str, command: str) -> Any:
        """Write a command, or query its answer.

        Raises:
            DeviceError: The connection was lost, or there is no answer in time.

        """
        from pyvisa.errors import Error  # noqa: PLC0415  see connect

        try:
            return getattr(self.connection, method)(command)
        except (Error, OSError, UnicodeDecodeError) as error:
            raise self.error(f"no answer to '{command}', {error}", "an answer in time") from None
