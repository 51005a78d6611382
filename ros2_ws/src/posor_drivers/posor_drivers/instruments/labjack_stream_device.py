# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Device ``labjack_stream``: analogue inputs of a LabJack T7 in stream mode, which sends frames by its own clock.

::

    kind: labjack_stream
    host: 192.168.0.8
    rate: {value: 1000, unit: Hz}
    channels:
      current1: {input: 0, range: {value: 10, unit: V}}
      current2: {input: 1, range: {value: 10, unit: V}, negative_input: 199}

Channels are in volts; a value at an end of the converter is invalid, NaN. The inputs of a frame are converted one after
the other in the order of ``channels``. The data sheet (A-1-1) states the interval for resolution index 1 and a range of
10 V: 15 us, or 8 us with 5 us of settling above 60,000 samples per second. So with ``settling: {value: 2.0e-5, unit:
s}`` the interval is the settling time and 3 us of conversion; with other ranges and automatic settling it is unknown.

Source: Modbus map and low-level stream protocol of the T series, of which public programs agree:

- Set-up: scan rate (float) at 4002, number of addresses 4004, samples per packet 4006, settling time (float, 0:
  automatic) 4008, resolution 4010, buffer size (0: default) 4012, target (1: Ethernet) 4016, type of data (0) 4018,
  number of scans (0: endless) 4020, address k at 4100 + 2 k, enable 4990.
- Packet at port 702, big endian: transaction number, protocol, length, unit, function 76, type 16, a reserved byte,
  backlog, status and information of 16 bits each, samples of 16 bits. Status 2940 is a full buffer, 2941 its end, with
  the number of scans that were left out. Its packet holds scans from before and after them, with a scan of 0xFFFF
  between (U3 manual, 5.2.12), or only scans from after them. The scan of 0xFFFF is not one of those left out
  (assumption).
  The scan of 0xFFFF may be the last one of a packet of status 2940; it counts as one that was left out.
- Constants in the flash memory of a T7, read through 61810 and 61812, from 0x3C4000 on, for each of the ranges 10, 1,
  0.1 and 0.01 V: slope above and below the centre, centre and offset (floats).

Never run with a LabJack.
"""

from __future__ import annotations

import math
import struct
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from posor.calibration.quantity import Quantity, measured
from pydantic import Field

from posor_drivers.instruments.device import DeviceError, DeviceSettings, Frames, Host, Port
from posor_drivers.instruments.labjack_registers import LONG_REGISTERS, LabJackInput, LabJackRegisters, starting_inputs
from posor_drivers.instruments.tcp_device import PacketDevice
from posor_drivers.quantity_limits import POSITIVE, limit_quantity

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.numerics.array_types import FloatArray, IntArray

T7 = 7
RANGES_V = (10.0, 1.0, 0.1, 0.01)
SCAN_RATE, ADDRESSES, SAMPLES_PER_PACKET, SETTLING, RESOLUTION, BUFFER = 4002, 4004, 4006, 4008, 4010, 4012
TARGET, DATA_TYPE, SCANS, SCAN_LIST, ENABLE = 4016, 4018, 4020, 4100, 4990
ETHERNET = 1
FLASH_POINTER, FLASH, CONSTANTS_ADDRESS, CONSTANTS = 61_810, 61_812, 0x3C4000, 4
FLOAT_BYTES = 4
MOST_SAMPLES, PACKETS_PER_S = 512, 100
HEADER = struct.Struct(">HHHBBBxHHH")
LENGTH_WITHOUT_SAMPLES = HEADER.size - 6
STREAM_FUNCTION, STREAM_TYPE = 76, 16
RECOVERING, RECOVERED = 2940, 2941
HIGHEST_SAMPLE = 0xFFFF
RATE_TOLERANCE = 0.01
INTERVAL_S, FAST_INTERVAL_S, FAST_SAMPLES_PER_S = 15e-6, 8e-6, 60_000
CONVERSION_S = 3e-6
SETTLING_LIMITS = limit_quantity(lambda seconds: 1e-6 <= seconds <= 4400e-6, "1e-6 to 4.4e-3 s")  # noqa: PLR2004


class StreamChannel(LabJackInput):
    """An analogue input of the stream."""

    range: Annotated[Quantity, measured("V"), POSITIVE] = Quantity(value=10.0, unit="V")


class LabJackStreamSettings(DeviceSettings):
    """Keys of a LabJack T7 in stream mode."""

    kind: Literal["labjack_stream"]
    host: Host
    port: Port = 502
    stream_port: Port = 702
    channels: Annotated[dict[str, StreamChannel], Field(min_length=1, max_length=128)]
    settling: Annotated[Quantity, measured("s"), SETTLING_LIMITS] | None = None

    @property
    def channel_interval_s(self) -> float:
        """Time from input to input [s]; NaN: unknown."""
        if self.settling is not None:
            return self.settling.number + CONVERSION_S
        if any(channel.range.number != RANGES_V[0] for channel in self.channels.values()):
            return math.nan
        return FAST_INTERVAL_S if len(self.channels) * self.rate.number > FAST_SAMPLES_PER_S else INTERVAL_S


class LabJackStreamDevice(PacketDevice[LabJackStreamSettings]):
    """Sets up the stream through the registers, and reads it from its port."""

    Settings = LabJackStreamSettings

    def __init__(self, name: str, settings: LabJackStreamSettings) -> None:
        """Store the settings."""
        super().__init__(name, settings)
        self._registers: LabJackRegisters | None = None
        self._constants: FloatArray = np.empty((len(settings.channels), CONSTANTS))
        self._packet, self._next = 0, 0
        self._delimited = False  # whether the last packet ends with the delimiter of the next one
        self.channel_interval_s = settings.channel_interval_s

    @classmethod
    def starting_settings(cls, units: Mapping[str, str]) -> dict[str, Any]:
        """Return an input for each reading that is not a whole number."""
        return starting_inputs(units, 1000)

    @property
    def address(self) -> str:
        """Host and port of the stream."""
        return f"{self.settings.host}:{self.settings.stream_port}"

    def connect(self, timeout_s: float) -> str:
        """Check the product, stop a stream that still runs, set up the inputs and start the stream."""
        settings = self.settings
        self._registers = registers = LabJackRegisters(self.error, settings.host, settings.port, timeout_s)
        identity = registers.identity([T7])
        if registers.read_number(ENABLE):
            registers.write_number(ENABLE, 0)
        for n, channel in enumerate(settings.channels.values()):
            registers.set_up(channel)
            self._constants[n] = self._read_constants(registers, channel.range.number)
        self._write_setup(registers)
        self._packet, self._next, self._delimited = 0, 0, False
        self.open_stream(settings.host, settings.stream_port, timeout_s)
        registers.write_number(ENABLE, 1)
        actual_hz = registers.read_floats(SCAN_RATE, 1)[0]
        if abs(actual_hz / self.frame_rate - 1.0) > RATE_TOLERANCE:
            raise self.error(f"the device streams {actual_hz:g} frames per second", f"{self.frame_rate:g}, as stated")
        return identity

    def _read_constants(self, registers: LabJackRegisters, range_v: float) -> Sequence[float]:
        """Return slope above and below the centre, centre and offset of a range."""
        if range_v not in RANGES_V:
            raise self.error(f"a range of {range_v:g} V", ", ".join(f"{each:g}" for each in RANGES_V))
        bytes_before = RANGES_V.index(range_v) * CONSTANTS * FLOAT_BYTES
        registers.write_number(FLASH_POINTER, CONSTANTS_ADDRESS + bytes_before)
        return registers.read_floats(FLASH, CONSTANTS)

    def _write_setup(self, registers: LabJackRegisters) -> None:
        settings, count = self.settings, len(self.settings.channels)
        frames = max(1, min(MOST_SAMPLES // count, round(self.frame_rate / PACKETS_PER_S)))
        settling_us = 0.0 if settings.settling is None else 1e6 * settings.settling.number
        for register, value in ((SCAN_RATE, self.frame_rate), (SETTLING, settling_us)):
            registers.write_float(register, value)
        numbers = {ADDRESSES: count, SAMPLES_PER_PACKET: count * frames, TARGET: ETHERNET}
        for register in (ADDRESSES, SAMPLES_PER_PACKET, RESOLUTION, BUFFER, TARGET, DATA_TYPE, SCANS):
            registers.write_number(register, numbers.get(register, 0))
        for n, channel in enumerate(settings.channels.values()):
            registers.write_number(SCAN_LIST + LONG_REGISTERS * n, LONG_REGISTERS * channel.input)

    def take_packet(self) -> Frames | None:
        """Return the frames of the first packet; None if it is not complete."""
        if len(self.received) < HEADER.size:
            return None
        packet, _, length, _, function, kind, _, status, information = HEADER.unpack_from(self.received)
        if (function, kind) != (STREAM_FUNCTION, STREAM_TYPE):
            expected = f"{STREAM_FUNCTION} and {STREAM_TYPE}"
            raise self.error(f"a packet has function {function} and type {kind}", expected)
        if packet != self._packet:
            raise self.error(f"packet {packet} follows packet {self._packet - 1}", "packets without a gap")
        if status not in (0, RECOVERING, RECOVERED):
            raise self.error(f"the stream has status {status}", "0; 2942 means that the rate is too high")
        count, row = length - LENGTH_WITHOUT_SAMPLES, 2 * len(self._constants)
        if count <= 0 or count % row:
            raise self.error(f"a packet has {count} bytes of samples", f"whole frames of {row} bytes")
        if len(self.received) < HEADER.size + count:
            return None
        samples = np.frombuffer(self.received, ">u2", count // 2, HEADER.size).reshape(-1, len(self._constants))
        counters, samples = self._numbered(samples, information if status == RECOVERED else None)
        self._delimited = status == RECOVERING and bool(np.all(samples[-1] == HIGHEST_SAMPLE))
        self.received = self.received[HEADER.size + count :]
        self._packet = (packet + 1) % (1 << 16)
        return Frames(counters, self._volts(samples))

    def _numbered(self, samples: Any, left_out: int | None) -> tuple[IntArray, Any]:
        """Return numbers and samples of the frames of a packet.

        ``left_out``: number of frames that are missing at its delimiter or before it; None: no buffer was full. If
        several frames look like the delimiter, those between are of unknown number and count as lost.
        """
        counters = self._next + np.arange(len(samples))
        delimiters = np.flatnonzero(np.all(samples == HIGHEST_SAMPLE, axis=1))
        if left_out is None or not len(delimiters):
            skipped = max(0, left_out - self._delimited) if left_out else 0
            self._next += skipped + len(samples)
            return counters + skipped, samples
        first, last = delimiters[0], delimiters[-1]
        counters[last:] += left_out - 1
        self._next += left_out - 1 + len(samples)
        whole = np.r_[:first, last + 1 : len(samples)]
        return counters[whole], samples[whole]

    def _volts(self, samples: Any) -> FloatArray:
        """Return the voltages of samples, (n, c)."""
        above, below, centre, _ = self._constants.T
        from_centre = samples - centre
        volts = np.where(from_centre < 0.0, -from_centre * below, from_centre * above)
        return np.where((samples == 0) | (samples == HIGHEST_SAMPLE), np.nan, volts)

    def close(self) -> None:
        """Stop the stream, and close both connections."""
        if self._registers is not None:
            with suppress(DeviceError):  # of a connection that is broken
                self._registers.write_number(ENABLE, 0)
            self._registers.close()
            self._registers = None
        super().close()
