# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What parameters of the driver state on the times of scans, in place of what the source states."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

from posor.errors import ParameterError
from posor.ros_names import RAW_TOPIC

from posor_drivers.conditioning import READINGS, decode_scan
from posor_drivers.sources.source import SourceMessage
from posor_drivers.tick_scheduler import Pause

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from posor_drivers.driver_parameters import TimeParameters

ItemT = TypeVar("ItemT", bound=SourceMessage | Pause)


def state_times(items: Iterator[ItemT], parameters: TimeParameters) -> Iterator[ItemT | SourceMessage]:
    """Return what is to be published: scans with the stated fields, everything else unchanged.

    Raises:
        ParameterError: The offsets are not as many as the channels of a scan.
        PosorError: A scan cannot be decoded, or the source cannot be read.

    """
    stated = {name: value for name, value in parameters if value}
    return _state(items, stated) if stated else items


def _state(items: Iterator[ItemT], stated: Mapping[str, Any]) -> Iterator[ItemT | SourceMessage]:
    for item in items:
        if isinstance(item, Pause) or item.topic != RAW_TOPIC:
            yield item
            continue
        scan = decode_scan(item.data)
        channels, offsets = sum(len(getattr(scan, name)) for name in READINGS), stated.get("exposure_offsets", ())
        if len(offsets) not in (0, channels):
            expected = f"{channels}, one for each channel of scan {scan.scan}"
            raise ParameterError(
                f"{len(offsets)} offsets", where="parameter 'time.exposure_offsets'", expected=expected
            )
        for name, value in stated.items():
            setattr(scan, name, value)
        yield item._replace(data=scan)
