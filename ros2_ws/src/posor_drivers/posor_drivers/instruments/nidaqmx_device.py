# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Device ``nidaqmx``: analogue inputs of National Instruments hardware through the package ``nidaqmx`` and NI's driver.

Never run against hardware or NI's driver. Install ``nidaqmx`` and the driver yourself; neither is a dependency.

::

    kind: nidaqmx
    rate: {value: 1000, unit: Hz}
    channels:
      gap1: {input: Dev1/ai0, range: {value: 10, unit: V}}
      gap2: {input: Dev1/ai1, range: {value: 10, unit: V}}

Channels are in volts; a value at an end of the range is invalid, NaN. All inputs are read by one task with a hardware
clock, so they belong to one device or one chassis. A device without simultaneous sampling converts its inputs in the
order of ``channels`` by its AI convert clock, whose rate is read from the task, or set by ``convert_rate: {value:
50000, unit: Hz}``; of several such devices in a task the exposures are unknown. Source: documentation of the package
``nidaqmx``.
"""

from __future__ import annotations

import importlib
import math
import time
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from posor.calibration.file_model import FrozenModel
from posor.calibration.quantity import Quantity, measured
from pydantic import Field

from posor_drivers.instruments.device import Device, DeviceError, DeviceSettings, Frames, starting_channels
from posor_drivers.quantity_limits import POSITIVE

if TYPE_CHECKING:
    from collections.abc import Mapping

BUFFER_S = 2.0
"""Frames that the driver keeps."""
POLL_S = 0.002


class NiChannel(FrozenModel):
    """An analogue input by its physical name, and the end of its range."""

    unit: ClassVar[str] = "V"
    input: Annotated[str, Field(min_length=1)]
    range: Annotated[Quantity, measured("V"), POSITIVE] = Quantity(value=10.0, unit="V")


class NiSettings(DeviceSettings):
    """Keys of an NI-DAQmx device."""

    kind: Literal["nidaqmx"]
    channels: Annotated[dict[str, NiChannel], Field(min_length=1)]
    convert_rate: Annotated[Quantity, measured("Hz"), POSITIVE] | None = None


class NiDevice(Device[NiSettings]):
    """Reads a continuous task."""

    Settings = NiSettings

    def __init__(self, name: str, settings: NiSettings) -> None:
        """Store the settings."""
        super().__init__(name, settings)
        self._ranges = np.array([channel.range.number for channel in settings.channels.values()])
        self._failures: tuple[type[Exception], ...] = ()
        self._read = 0
        self.channel_interval_s = math.nan

    @classmethod
    def starting_settings(cls, units: Mapping[str, str]) -> dict[str, Any]:
        """Return an input for each reading that is not a whole number."""
        channels = starting_channels(units, lambda n: {"input": f"Dev1/ai{n}"})
        return {"rate": {"value": 1000, "unit": "Hz"}, "channels": channels}

    @property
    def address(self) -> str:
        """The physical inputs."""
        return ", ".join(channel.input for channel in self.settings.channels.values())

    def connect(self, timeout_s: float) -> str:
        """Make a continuous task of all inputs and start it."""
        del timeout_s
        try:
            nidaqmx = importlib.import_module("nidaqmx")
            errors = importlib.import_module("nidaqmx.errors")
        except ImportError as error:
            raise self.error(str(error), "the package nidaqmx, which is not installed here") from None
        self._failures = (errors.DaqError, errors.DaqNotFoundError)
        rate_hz = self.frame_rate
        try:
            self.connection = task = nidaqmx.Task()
            for channel in self.settings.channels.values():
                end_v = channel.range.number
                task.ai_channels.add_ai_voltage_chan(channel.input, min_val=-end_v, max_val=end_v)
            continuous = nidaqmx.constants.AcquisitionType.CONTINUOUS
            task.timing.cfg_samp_clk_timing(rate_hz, sample_mode=continuous, samps_per_chan=round(BUFFER_S * rate_hz))
            if self.settings.convert_rate is not None:
                task.timing.ai_conv_rate = self.settings.convert_rate.number
            task.start()
            simultaneous = all(device.ai_simultaneous_sampling_supported for device in task.devices)
            interval_s = 1.0 / task.timing.ai_conv_rate if len(task.devices) == 1 and not simultaneous else math.nan
            self.channel_interval_s = 0.0 if simultaneous else interval_s
        except self._failures as error:
            raise self.error(str(error), "NI-DAQmx with these inputs") from None
        self._read = 0
        return f"NI-DAQmx task of {len(self.settings.channels)} inputs"

    def read(self, timeout_s: float) -> Frames | None:
        """Return the frames that the driver has."""
        deadline_s = time.monotonic() + timeout_s
        try:
            while not (count := self.connection.in_stream.avail_samp_per_chan):
                if time.monotonic() > deadline_s:
                    return None
                time.sleep(POLL_S)
            arrived_ns = time.time_ns()
            values = np.reshape(self.connection.read(number_of_samples_per_channel=count), (len(self._ranges), count)).T
        except self._failures as error:
            raise self.error(str(error), "a running task") from None
        counters = self._read + np.arange(count)
        self._read += count
        return Frames(counters, np.where(np.abs(values) < self._ranges, values, np.nan), arrived_ns=arrived_ns)

    def error(self, what: str, expected: str) -> DeviceError:
        """Return an error with the first line of what the driver says."""
        return super().error(what.splitlines()[0] if what else "failed", expected)
