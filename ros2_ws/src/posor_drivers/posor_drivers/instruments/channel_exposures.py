# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Exposures of the channels of a device: when each channel of a frame is read.

A multiplexing device reads the channels of a frame one after another. The offset of a channel is the middle of its
exposure minus the time of its frame, which is the middle between the first and the last exposure. Devices find the
interval from channel to channel from their settings; the key ``exposures`` of a device in an instruments file
overrides it::

    exposures: simultaneous
    exposures: unknown
    exposures: {interval: {value: 1.5e-5, unit: s}}
    exposures: {offsets: {gap1: {value: -2.0e-5, unit: s}, plate: unknown}}
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, Self

import numpy as np
from posor.calibration.file_model import EntryError, FrozenModel
from posor.calibration.quantity import Quantity, measured
from pydantic import Field, model_validator

from posor_drivers.quantity_limits import NOT_NEGATIVE

if TYPE_CHECKING:
    from collections.abc import Sequence

Unknown = Literal["unknown"]


class ExposureEntry(FrozenModel):
    """Interval from channel to channel in the order of reading, and offsets of single channels."""

    interval: Annotated[Quantity, measured("s"), NOT_NEGATIVE] | None = None
    offsets: dict[str, Annotated[Quantity, measured("s")] | Unknown] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.interval is None and not self.offsets:
            raise EntryError("neither interval nor offsets", expected="one of them, 'simultaneous' or 'unknown'")
        return self


class Exposures(NamedTuple):
    """When the channels of a frame are read."""

    offsets_s: tuple[float, ...]  # middle of each channel's exposure after the time of the frame [s]; NaN: unknown
    span_s: float  # time from the first to the last exposure, or within which the unknown ones lie [s]

    @property
    def half_span_s(self) -> float:
        """Time from the first exposure to the time of the frame [s]; 0 where an exposure is unknown."""
        return 0.0 if math.isnan(sum(self.offsets_s)) else -min(self.offsets_s)


def find_exposures(
    names: Sequence[str],
    order: Sequence[int],
    interval_s: float,
    period_s: float,
    entry: ExposureEntry | Literal["simultaneous", "unknown"] | None,
) -> Exposures:
    """Return the exposures of the channels of a device.

    Args:
        names: Names of the channels.
        order: Place of each channel in the order of reading, from 0 on.
        interval_s: Time from channel to channel by the settings of the device [s]; 0: all at one time; NaN: unknown.
        period_s: Time from frame to frame [s].
        entry: What the instruments file states; None: nothing.

    """
    if isinstance(entry, ExposureEntry):
        interval_s = interval_s if entry.interval is None else entry.interval.number
    elif entry is not None:
        interval_s = 0.0 if entry == "simultaneous" else math.nan
    places = np.array(order, dtype=np.float64)
    offsets = np.zeros(len(places)) if places.max() == 0.0 else interval_s * (places - 0.5 * places.max())
    if isinstance(entry, ExposureEntry):
        for name, offset in entry.offsets.items():
            offsets[names.index(name)] = math.nan if isinstance(offset, str) else offset.number
    return Exposures(tuple(offsets.tolist()), period_s if np.isnan(offsets).any() else float(np.ptp(offsets)))
