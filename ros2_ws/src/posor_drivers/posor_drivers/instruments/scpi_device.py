"""Device ``scpi``: scanners and multimeters that answer text commands, through PyVISA with its own library pyvisa-py.

::

    kind: scpi
    address: TCPIP::192.168.0.7::5025::SOCKET
    dialect: keysight_daq970a
    rate: {value: 5, unit: Hz}
    channels:
      gap1: {number: 101, unit: V}
      gap2: {number: 102, unit: V}

``channel_delay`` and ``aperture`` (integration time: power line cycles over line frequency) are written to the
instrument; ``overhead`` is what it needs for each channel besides, such as for switching and auto zero. Channels are
read in ascending order of their numbers, at an interval of the sum of the three; without aperture it is unknown.

With the key ``light`` the device switches the light sources by a digital output, and has a further channel ``light``: 1
while they are lit, 0 in the dark frames at the interval. Three dark frames follow one another, because a scan is
interpolated between three; the first frames are dark::

      light: {output: 204, lit: 1, dark: 0, interval: {value: 60, unit: s}}

``address`` is a VISA resource: TCP socket, VXI-11 (``TCPIP::host::INSTR``), HiSLIP (``TCPIP::host::hislip0::INSTR``),
or a serial port with pyserial. ``dialect`` is the name of a file in ``scpi_dialects`` beside this module or the path of
a dialect file of your own (its name ends in ``.yaml``); the commands of an instrument are written there, not in code.
"""

from __future__ import annotations

import math
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from posor.calibration.file_model import EntryError, FrozenModel
from posor.calibration.quantity import Quantity, measured
from posor.calibration.yaml_document import load_document
from pydantic import Field, model_validator

from posor_drivers.instruments.device import Channel, refuse_repeated_numbers, starting_channels
from posor_drivers.instruments.polled_device import PolledDevice, PolledSettings
from posor_drivers.quantity_limits import NOT_NEGATIVE, Seconds

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_drivers.instruments.device import Frames

DIALECTS = Path(__file__).parent / "scpi_dialects"
DIALECT_VERSION = 1
CHECK_ERRORS_S = 1.0
"""Time between two looks into the instrument's error queue."""
TIMES = ("channel_delay", "aperture")
"""Keys that are written to the instrument by commands of the same names."""
LIGHT = "light"
DARK_FRAMES = 3
"""Frames in a row without light."""
MOST_ERRORS = 20
"""Errors that are read from the queue; it may be as long."""


class Dialect(FrozenModel):
    """Commands of an instrument; ``{numbers}`` stands for the channel numbers in ascending order, with commas."""

    format: Literal["posor_scpi_dialect"]
    version: Literal[1]
    identify: str
    """Question for the model."""
    model: str
    """Regular expression that the answer contains."""
    setup: tuple[str, ...] = ()
    channel_delay: str = ""
    """Command that sets the time from switching to a channel to its measurement, ``{value}`` [s]."""
    aperture: str = ""
    """Command that sets the integration time ``{value}`` [s]."""
    digital_output: str = ""
    """Command that sets the digital output ``{number}`` to ``{value}``."""
    read: str
    """Question for one value of each channel, in ascending order of the numbers."""
    separator: str = ","
    overload: Annotated[float, Field(strict=True, gt=0.0)]
    """A value of at least this size, of either sign, is out of range."""
    error: str
    """Question for the oldest entry of the error queue, which it removes."""
    no_error: str
    """Regular expression of the answer of an empty queue."""
    termination: str = "\n"

    @model_validator(mode="after")
    def _check_expressions(self) -> Self:
        for key in ("model", "no_error"):
            try:
                re.compile(getattr(self, key))
            except re.error as error:
                what = f"'{getattr(self, key)}': {error}"
                raise EntryError(what, key=(key,), expected="a regular expression") from None
        return self


class ScpiChannel(FrozenModel):
    """A channel: its number in the instrument, and the unit of its readings."""

    number: Annotated[int, Field(strict=True, ge=0)]
    unit: str


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
    channel_delay: Annotated[Quantity, measured("s"), NOT_NEGATIVE] | None = None
    aperture: Seconds | None = None
    overhead: Annotated[Quantity, measured("s"), NOT_NEGATIVE] | None = None
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
        keys = "format, version, identify, model, setup, read, separator, overload, error, no_error"
        path, check = settings.dialect_path, Dialect.model_validate
        self._dialect = load_document(path, "dialect file", keys, DIALECT_VERSION, check)[0]
        self._numbers = [channel.number for channel in settings.channels.values()]
        self._checked_s = 0.0
        self._dark_left, self._next_dark_s = 0, 0.0
        for key, command in (*zip(TIMES, TIMES, strict=True), (LIGHT, "digital_output")):
            if getattr(settings, key) is not None and not getattr(self._dialect, command):
                raise self.error(f"dialect '{settings.dialect}' has no command '{command}'", f"no key '{key}'")
        times = [settings.channel_delay, settings.aperture, settings.overhead]
        interval_s = sum(each.number for each in times if each is not None)
        self.channel_interval_s = math.nan if settings.aperture is None else interval_s

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
        identity = self._query(dialect.identify)
        if re.search(dialect.model, identity) is None:
            raise self.error(f"the instrument is '{identity}'", f"a model that matches '{dialect.model}'")
        numbers = ",".join(map(str, sorted(self._numbers)))
        for command in dialect.setup:
            self._transfer("write", command.replace("{numbers}", numbers))
        for name in TIMES:
            if (time_s := getattr(self.settings, name)) is not None:
                command = getattr(dialect, name).replace("{value}", f"{time_s.number:.6g}")
                self._transfer("write", command.replace("{numbers}", numbers))
        self._dark_left, self._next_dark_s = 0, time.monotonic()
        if self.settings.light is not None:
            self._switch_light(self.settings.light)
        self._check_errors()
        return identity

    def read(self, timeout_s: float) -> Frames | None:
        """Look for errors once a second, between two frames, and return the next frame."""
        if time.monotonic() - self._checked_s > CHECK_ERRORS_S:
            self._check_errors()
        frames = super().read(timeout_s)
        if frames is not None and self.settings.light is not None:
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

    def ask(self) -> Sequence[float]:
        """Return the reading of each channel."""
        dialect = self._dialect
        answer = self._query(dialect.read)
        try:
            readings = [float(number) for number in answer.split(dialect.separator)]
        except ValueError:
            readings = []
        if len(readings) != len(self._numbers):
            self._check_errors()
            what = f"the answer to '{dialect.read}' is '{answer}'"
            raise self.error(what, f"{len(self._numbers)} numbers, separated by '{dialect.separator}'")
        by_number = dict(zip(sorted(self._numbers), readings, strict=True))
        values = [by_number[number] for number in self._numbers]
        read = [value if abs(value) < dialect.overload else math.nan for value in values]
        return read if self.settings.light is None else [*read, float(self._dark_left == 0)]

    def _check_errors(self) -> None:
        """Empty the error queue.

        Raises:
            DeviceError: It was not empty.

        """
        errors: list[str] = []
        while len(errors) < MOST_ERRORS:
            answer = self._query(self._dialect.error)
            if re.search(self._dialect.no_error, answer):
                break
            errors.append(answer)
        self._checked_s = time.monotonic()
        if errors:
            raise self.error(f"the instrument reports {'; '.join(errors)}", "an empty error queue")

    def _query(self, command: str) -> str:
        answer: str = self._transfer("query", command)
        return answer.strip()

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
