# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Source ``looped``: recorded scans played forwards and backwards without end, at any rate, as a load for tests.

Every second scan is played forwards, the others backwards. So no scan is played twice in a row, not even where ticks
are missed while the direction changes: the estimator would report a scan that repeats to the last bit as frozen.
One scan is published at each tick of the ROS clock; stamp and scan number are those of the tick, all other fields are
as recorded. All scans are read and prepared in ``open``, so a tick costs little.
"""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from posor.bags.bag_reader import checked_type, opened_bag, scan_topic
from posor.bags.block_reader import read_messages
from posor.errors import BagError, TopicError
from posor.messages.raw_scan import ScanTemplate
from posor.numerics.stamps import tick_stamp_ns
from posor.ros_names import RAW_SCAN, RAW_TOPIC
from pydantic import Field

from posor_drivers.quantity_limits import MAX_RATE_HZ
from posor_drivers.sources.bag_source import RecordedTopicParameters
from posor_drivers.sources.source import LiveSource, SourceMessage, Topic

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.bags.ordered_reader import OrderedReader

MAX_SCANS = 100_000
"""Limit of the scans held in memory."""


class LoopedParameters(RecordedTopicParameters):
    """Parameters of the source ``looped``."""

    rate: Annotated[int, Field(ge=1, le=MAX_RATE_HZ)] = Field(
        description="scans per second, whatever the rate of the record [Hz]"
    )
    scans: Annotated[int, Field(ge=0, le=MAX_SCANS)] = Field(
        default=0, description="how many of the recorded scans to play, from the first one on; 0: all"
    )


class LoopedSource(LiveSource[LoopedParameters]):
    """Plays one joint's recorded scans forwards and backwards without end.

    The tick alone determines the scan, so joints played from one bag stay together, in one process or in several, if
    each has the same number of scans.
    """

    Parameters = LoopedParameters

    _scans: list[ScanTemplate]

    @property
    def record(self) -> str:
        """The file."""
        return self.parameters.path

    def open(self) -> Sequence[Topic]:
        """Read and prepare all scans.

        Raises:
            BagError: The bag cannot be read, holds too few or too many scans, or one that cannot be decoded.

        """
        where = self.parameters.path
        with opened_bag(Path(where)) as reader:
            name = scan_topic(reader.connections, self.parameters.topic, where, "parameter 'looped.topic'")
            checked_type(reader.connections, name, where, self.types, (RAW_SCAN,), filled=True)
            count = self._scan_count(reader, name)
            records = islice(enumerate(read_messages(reader, (name,), where), start=1), count)
            self._scans = [_scan_template(data, f"{where}, message {n} of {name}") for n, (_, _, data) in records]
        return [Topic(RAW_TOPIC, RAW_SCAN)]

    def _scan_count(self, reader: OrderedReader, name: str) -> int | None:
        """Return the number of scans to read; None: all."""
        wanted, where = self.parameters.scans, self.parameters.path
        recorded = sum(connection.msgcount for connection in reader.connections if connection.topic == name)
        if wanted > recorded:
            expected = f"at most {recorded}, the scans of {name} in {where}"
            raise BagError(f"{wanted} scans are wanted", where="parameter 'looped.scans'", expected=expected)
        if (wanted or recorded) > MAX_SCANS:
            expected = f"at most {MAX_SCANS}, or parameter 'looped.scans' to limit the scans that are played"
            raise BagError(f"topic {name} holds {recorded} scans", where=where, expected=expected)
        return wanted or None

    @property
    def rate(self) -> int:
        """Scans per second."""
        return self.parameters.rate

    def read_tick(self, tick: int) -> Sequence[SourceMessage]:
        """Return the scan of a tick."""
        stamp_ns = tick_stamp_ns(tick, self.rate)
        position = 2 * (tick % len(self._scans))
        scan = self._scans[min(position, 2 * len(self._scans) - 1 - position)]
        return (SourceMessage(RAW_TOPIC, stamp_ns, scan.at(stamp_ns, tick)),)


def _scan_template(data: bytes, where: str) -> ScanTemplate:
    """Return the template of a recorded scan; an error names where it was recorded."""
    try:
        return ScanTemplate(data)
    except TopicError as error:
        raise BagError(error.what, where=where, expected=error.expected) from None
