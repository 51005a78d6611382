# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Base class of devices that send nothing by themselves: they are asked for each frame."""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from posor.numerics.stamps import NS

from posor_drivers.instruments.device import Device, DeviceSettings, Frames

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


LEAST_ANSWER_TIME_S = 0.2
"""With the period of a device that is asked five times per second, a stall is known within half a second."""

EXPOSURES_EVERY = 100
"""Frames after which the exposures, which are final when the device is connected, are asked for again."""
CHECK_S = 1.0
"""Time between two looks at the settings of a device."""
MOST_PERIODS = 3
"""Periods between two frames that are interpolated: a device may answer late."""


class PolledSettings(DeviceSettings):
    """Keys of every polled device; ``rate`` is the number of questions per second."""

    @property
    def answer_time_s(self) -> float:
        """Time limit of an answer [s]: a period, and at least 0.2 s."""
        return max(LEAST_ANSWER_TIME_S, 1.0 / self.rate.number)


SettingsT = TypeVar("SettingsT", bound=PolledSettings)


class PolledDevice(Device[SettingsT]):
    """Asks for a frame in each period of the stated rate, or as soon as the device has answered.

    The device measures between question and answer. The time of a frame is the middle of the two, and its standard
    uncertainty that of a uniform distribution over the time between them that the exposures leave.
    """

    def __init__(self, name: str, settings: SettingsT) -> None:
        """Store the settings; ``connect`` opens the connection."""
        super().__init__(name, settings)
        self._next_s, self._asked, self._span_s = 0.0, 0, 0.0
        self._in_force: Mapping[str, object] | None = None  # None: not asked for yet
        self._next_check_s = 0.0

    @property
    def longest_interval_s(self) -> float:
        """Several periods, because a device may answer late [s]."""
        return MOST_PERIODS / self.frame_rate

    @abstractmethod
    def ask(self) -> Sequence[float]:
        """Ask the device for one frame and return the value of each channel; NaN where the device flags it as invalid.

        Raises:
            DeviceError: The connection was lost, or the answer is no frame.

        """

    def settings_in_force(self) -> Mapping[str, object]:
        """Ask for settings of the device that decide what it measures, by name. Raises DeviceError: no answer."""
        return {}

    def before_query(self) -> None:
        """Once a second, compare the settings in force with those of the first frame; not within the time of a frame.

        Raises DeviceError: a setting has changed, by another user of the device or by its restart.
        """
        if time.monotonic() < self._next_check_s:
            return
        found = self.settings_in_force()
        self._next_check_s = time.monotonic() + CHECK_S
        self._in_force = found if self._in_force is None else self._in_force
        for name, value in found.items():
            if value != self._in_force[name]:
                expected = "nobody else who sets up the device while the driver runs"
                raise self.error(f"{name} has changed from {self._in_force[name]} to {value}", expected)

    def close(self) -> None:
        """Close the connection; the next one may begin with other settings."""
        super().close()
        self._in_force, self._next_check_s = None, 0.0

    def read(self, timeout_s: float) -> Frames | None:
        """Wait for the next period and return its frame; None if it begins after the time."""
        wait_s = self._next_s - time.monotonic()
        time.sleep(min(max(0.0, wait_s), timeout_s))
        if wait_s > timeout_s:
            return None
        self._next_s = max(self._next_s, time.monotonic() - 1.0 / self.frame_rate) + 1.0 / self.frame_rate
        self.before_query()
        asked_s, asked_ns = time.monotonic(), time.time_ns()
        values = np.array([self.ask()])
        answered_ns, elapsed_s = time.time_ns(), time.monotonic() - asked_s
        step_s = (answered_ns - asked_ns) / NS - elapsed_s  # of a clock that was set meanwhile
        if not self._asked % EXPOSURES_EVERY:
            exposures = self.exposures
            self._span_s = 0.0 if math.isnan(sum(exposures.offsets_s)) else exposures.span_s
        self._asked += 1
        uncertainty_s = max(0.0, elapsed_s + abs(step_s) - self._span_s) / (2.0 * math.sqrt(3.0))
        return Frames(np.array([self._asked]), values, np.array([(asked_ns + answered_ns) // 2]), uncertainty_s)
