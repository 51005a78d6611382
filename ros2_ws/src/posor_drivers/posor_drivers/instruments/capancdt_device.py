# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Device ``capancdt_6200``: capacitive distances of a capaNCDT 6200 controller of Micro-Epsilon.

::

    kind: capancdt_6200
    host: 192.168.0.6
    rate: {value: 1041.67, unit: Hz}
    channels:
      gap1: {number: 1, range: {value: 0.5, unit: mm}}
      gap2: {number: 2, range: {value: 0.5, unit: mm}}

``range`` is the measuring range of the sensor at the channel; the controller sends only shares of it. ``connect`` sets
continuous transmission (``$TRG0``) and the sample time (``$STI``); all other settings of the controller are left as
they are. A controller that averages (``$AVT``) is refused: its readings are older than their stamps.

Source: operating instructions capaNCDT 6200, chapter 6, Ethernet interface. A packet is, little endian: preamble
``MEAS``, order number, serial number, two bits of each channel (``01``: available) in 64 bits, unused status, number of
frames and bytes per frame (16 bits each), counter of the first frame, and frames of one int32 of each channel; 0xFFFFFF
is the measuring range. Where the manual is silent or ambiguous:

- Byte order of the preamble: public readers of this controller expect ``SAEM``, the text as a little-endian number.
  Both are accepted.
- Order of the two 16-bit numbers: the manual lists the number of frames first, two public readers read it second. The
  one that is four times the number of channels is the bytes per frame.
- Channels with a math function: a value other than ``00`` in the channel bits counts as available (assumption).
- Targets out of range: a value of 0xFFFFFF or more, or below zero, is invalid, NaN (assumption). Zero is valid.
- Averaging: ``$AVT?`` is answered by ``$AVT?nOK``, as the manuals of controllers of the same family state.
- Counter: counts frames (assumption), and wraps at 32 bits.
- Model: the answer to ``$VER`` starts with ``DT62``, as ``DT6200`` in the manual (assumption for other models).

The sample times that exist are not listed in the manual; the controller answers with the next one. A rate whose sample
time it does not have is refused, and the message names the sample time that it has.
"""

from __future__ import annotations

import re
import struct
import time
from contextlib import closing
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from posor.calibration.file_model import EntryError, FrozenModel
from posor.calibration.quantity import Quantity, measured
from pydantic import Field, model_validator

from posor_drivers.instruments.device import DeviceSettings, FrameCounter, Frames, Host, Port, refuse_repeated_numbers
from posor_drivers.instruments.tcp_device import PacketDevice, TcpConnection
from posor_drivers.quantity_limits import POSITIVE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

FULL_SCALE = 0xFFFFFF
"""Digital value of the measuring range."""
LEAST_RATE_HZ, GREATEST_RATE_HZ = 2.5, 3906.25
"""The manual says 2.5 Sa/s to 3.9 kSa/s; the shortest sample time is 256 us."""
US = 1_000_000
PREAMBLES = (b"MEAS", b"SAEM")
_HEADER = struct.Struct("<4siiQiHHI")
_COUNTER_RANGE = 1 << 32
_VALUE_BYTES = 4
_MAX_CHANNELS = 32
MOST_SENSORS = 4
_NO_AVERAGING = "0"
_SENSOR = "1"
"""State of a channel in the answer to ``$CHS``: 0: no module, 2: a math function."""


class CapaNcdtChannel(FrozenModel):
    """A channel: its number at the controller and the measuring range of its sensor."""

    unit: ClassVar[str] = "m"
    number: Annotated[int, Field(strict=True, ge=1, le=MOST_SENSORS)]
    range: Annotated[Quantity, measured("m"), POSITIVE]


class CapaNcdtSettings(DeviceSettings):
    """Keys of a capaNCDT 6200."""

    kind: Literal["capancdt_6200"]
    host: Host
    command_port: Port = 23
    data_port: Port = 10_001
    rate: Annotated[Quantity, measured("Hz")]
    channels: Annotated[dict[str, CapaNcdtChannel], Field(min_length=1)]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not LEAST_RATE_HZ <= self.rate.number <= GREATEST_RATE_HZ:
            expected = f"{LEAST_RATE_HZ:g} to {GREATEST_RATE_HZ:g} Hz"
            raise EntryError(f"rate {self.rate.number:g} Hz", key=("rate", "value"), expected=expected)
        refuse_repeated_numbers({name: channel.number for name, channel in self.channels.items()})
        return self

    @property
    def sample_time_us(self) -> int:
        """Time from frame to frame [us]."""
        return round(US / self.rate.number)


class CapaNcdtDevice(PacketDevice[CapaNcdtSettings]):
    """Sets up the controller over its command port, and reads the frames of its data port."""

    Settings = CapaNcdtSettings

    def __init__(self, name: str, settings: CapaNcdtSettings) -> None:
        """Prepare the scale of each channel."""
        super().__init__(name, settings)
        channels = settings.channels.values()
        self._numbers = [channel.number for channel in channels]
        self._steps = np.array([channel.range.number / FULL_SCALE for channel in channels])
        self._frame_counter = FrameCounter(_COUNTER_RANGE)

    @classmethod
    def starting_settings(cls, units: Mapping[str, str]) -> dict[str, Any]:
        """Return a sensor at each of the channels, of which there are at most four."""
        span = {"value": 0.5, "unit": "mm"}
        voltages = [name for name, unit in units.items() if unit == "V"][:MOST_SENSORS]
        return {
            "host": "192.168.0.6",
            "rate": {"value": 1041.67, "unit": "Hz"},
            "channels": {name: {"number": n, "range": dict(span)} for n, name in enumerate(voltages, start=1)},
        }

    @property
    def frame_rate(self) -> float:
        """Rate of the sample time in whole microseconds [Hz]."""
        return US / self.settings.sample_time_us

    @property
    def address(self) -> str:
        """Host and data port."""
        return f"{self.settings.host}:{self.settings.data_port}"

    def connect(self, timeout_s: float) -> str:
        """Check model, channels and averaging, set the sample time, and open the data port."""
        deadline_s = time.monotonic() + timeout_s
        settings, sample_time_us = self.settings, self.settings.sample_time_us
        with closing(TcpConnection(self.error, settings.host, settings.command_port, timeout_s)) as port:
            version = self._ask(port, "VER", r"VER(DT62.*?)(OK)?", "'$VERDT62' and the version", deadline_s)
            status = self._ask(port, "CHS", r"CHS(\d(,\d)*)OK", "'$CHS', the state of each channel, 'OK'", deadline_s)
            self._check_channels(status.split(","))
            averaging = self._ask(port, "AVT?", r"AVT\?(\d)OK", "'$AVT?', the kind of averaging, 'OK'", deadline_s)
            if averaging != _NO_AVERAGING:
                what = f"the controller averages ('$AVT{averaging}'): its readings are older than their stamps"
                raise self.error(what, "averaging off ('$AVT0'); a driver has conditioning.samples")
            self._ask(port, "TRG0", "(TRG0)OK", "'$TRG0OK'", deadline_s)
            command = f"STI{sample_time_us}"
            actual = self._ask(port, command, rf"{command},(\d+)OK", f"'${command},', a sample time, 'OK'", deadline_s)
        if int(actual) != sample_time_us:
            what = f"the controller has no sample time of {sample_time_us} us, the next one is {actual} us"
            raise self.error(what, "a rate that the controller has; in Hz, 1e6 divided by the sample time")
        remaining_s = max(0.001, deadline_s - time.monotonic())
        self._frame_counter = FrameCounter(_COUNTER_RANGE)
        self.open_stream(settings.host, settings.data_port, remaining_s)
        return version.replace(";", " ")

    def _ask(self, port: TcpConnection, command: str, pattern: str, expected: str, deadline_s: float) -> str:
        """Send a command and return group 1 of its answer.

        The answer is a line: the command, its values and ``OK``, or an error such as ``$UNKNOWN COMMAND``. Lines
        without ``$`` are the welcome text. The controller echoes all characters, so the command may come twice.
        """
        port.send(f"${command}\r".encode("ascii"))
        data = b""
        while received := port.receive(max(0.0, deadline_s - time.monotonic())):
            *lines, data = (data + received).split(b"\n")
            for line in lines:
                _, mark, answer = line.replace(b"\r", b"").decode("ascii", "replace").rpartition("$")
                if mark and answer != command:
                    if (match := re.fullmatch(pattern, answer)) is None:
                        raise self.error(f"the answer to '${command}' is '${answer}'", expected)
                    return match[1]
        raise self.error(f"no answer to '${command}' in time", expected)

    def _check_channels(self, states: Sequence[str]) -> None:
        """Check that each channel of the settings outputs the values of a sensor."""
        for name, channel in self.settings.channels.items():
            state = states[channel.number - 1] if channel.number <= len(states) else "0"
            if state != _SENSOR:
                what = "has no module" if state == "0" else f"has the state {state}, which is no sensor"
                modules = ", ".join(str(n) for n, state in enumerate(states, start=1) if state == _SENSOR)
                raise self.error(f"channel {channel.number}, '{name}', {what}", f"one of {modules or 'no channels'}")

    def take_packet(self) -> Frames | None:
        """Return the frames of the first packet; None if it is not complete."""
        if len(self.received) < _HEADER.size:
            return None
        preamble, _, _, channel_bits, _, first, second, counter = _HEADER.unpack_from(self.received)
        if preamble not in PREAMBLES:
            expected = " or ".join(f"'{each.decode()}'" for each in PREAMBLES)
            raise self.error(f"a packet begins with {preamble!r}", expected)
        present = [n + 1 for n in range(_MAX_CHANNELS) if channel_bits >> 2 * n & 3]
        if missing := [number for number in self._numbers if number not in present]:
            raise self.error(f"a packet has no channel {missing[0]}, only {present}", "the channels of the settings")
        frame_bytes = _VALUE_BYTES * len(present)
        count = first if second == frame_bytes else second
        if frame_bytes not in (first, second) or count == 0:
            what = f"a packet states {first} and {second} as number of frames and bytes per frame"
            raise self.error(what, f"{frame_bytes} bytes per frame of {len(present)} channels, and a frame or more")
        end = _HEADER.size + count * frame_bytes
        if len(self.received) < end:
            return None
        raw = np.frombuffer(self.received, "<i4", count * len(present), _HEADER.size).reshape(count, len(present))
        raw = raw[:, [present.index(number) for number in self._numbers]]
        self.received = self.received[end:]
        values = np.where((raw >= 0) & (raw < FULL_SCALE), raw * self._steps, np.nan)
        return Frames(self._frame_counter.number(counter, count) + np.arange(count), values)
