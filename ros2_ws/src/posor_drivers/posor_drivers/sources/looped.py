"""Source ``looped``: one joint's recorded scans over and over, at any rate: a load to try one's own machine with.

The scans are played forth and back, so that the motion has no jump, one at each tick of the ROS clock; stamp and scan
number are the tick's, all else is as recorded. All is read and prepared beforehand: a tick costs next to nothing.
"""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from posor_estimator.errors import BagError, TopicError
from posor_estimator.ros.bag_reader import check_filled, checked_type, counted_messages, opened_bag, scan_topic
from posor_estimator.ros.cdr_scan import ScanTemplate
from posor_estimator.ros.message_types import RAW_SCAN
from posor_estimator.ros.parameters import ParameterGroup
from posor_estimator.ros.qos import RAW_TOPIC
from pydantic import Field

from posor_drivers.simulator.ticks import first_tick_after, stamp_of
from posor_drivers.sources.base import LiveSource, SourceMessage, Topic

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rosbags.rosbag2 import Reader

    from posor_drivers.sources.base import Input

MOST_SCANS = 100_000
"""They are all held in memory."""
FASTEST_HZ = 10_000


class LoopedParameters(ParameterGroup):
    """Parameters of the source ``looped``."""

    path: Annotated[str, Field(min_length=1)] = Field(
        description="bag: folder with metadata.yaml, or a single .mcap or .db3 file"
    )
    topic: str = Field(default="", description="recorded topic of this joint's scans; empty: the only one there is")
    rate: Annotated[int, Field(ge=1, le=FASTEST_HZ)] = Field(
        description="scans per second, whatever the rate of the record [Hz]"
    )
    scans: Annotated[int, Field(ge=0, le=MOST_SCANS)] = Field(
        default=0, description="how many of the recorded scans to play, from the first one on; 0: all"
    )


class LoopedSource(LiveSource[LoopedParameters]):
    """Plays one joint's recorded scans forth and back, for ever.

    Which scan belongs to a tick depends on nothing but the tick: joints that are played from one bag stay together, in
    one process or in several, as long as each has the same number of scans.
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
            BagError: The bag cannot be read, holds too few scans or too many, or one that cannot be decoded.

        """
        where = self.parameters.path
        with opened_bag(Path(where)) as reader:
            name = scan_topic(reader.connections, self.parameters.topic, where, "parameter 'looped.topic'")
            checked_type(reader.connections, name, where, self.types, (RAW_SCAN,))
            check_filled(reader.connections, name, where)
            count = self._count(reader, name)
            records = islice(enumerate(counted_messages(reader, (name,), where), start=1), count)
            self._scans = [_template(data, f"{where}, message {n} of {name}") for n, (_, _, data) in records]
        return [Topic(RAW_TOPIC, RAW_SCAN)]

    def _count(self, reader: Reader, name: str) -> int | None:
        """Return how many scans to read; None: all, to the end of the bag."""
        wanted, where = self.parameters.scans, self.parameters.path
        there = sum(connection.msgcount for connection in reader.connections if connection.topic == name)
        if wanted > there:
            raise BagError(
                f"{wanted} scans are wanted",
                where="parameter 'looped.scans'",
                expected=f"at most {there}, the scans of {name} in {where}",
            )
        if (wanted or there) > MOST_SCANS:
            raise BagError(
                f"topic {name} holds {there} scans",
                where=where,
                expected=f"at most {MOST_SCANS}, or parameter 'looped.scans' to say how many of them to play",
            )
        return wanted or None

    @property
    def rate(self) -> int:
        """Scans per second."""
        return self.parameters.rate

    def inputs(self) -> Sequence[Input]:
        """Listen to nothing."""
        return []

    def begin(self, now_ns: int) -> tuple[int, int | None]:
        """Begin with the next tick; never end."""
        return first_tick_after(now_ns, self.parameters.rate), None

    def newest(self, now_ns: int) -> int:
        """Return the newest tick that has happened."""
        return first_tick_after(now_ns, self.parameters.rate) - 1

    def due_ns(self, tick: int) -> int:
        """Return the time of a tick [ns]."""
        return stamp_of(tick, self.parameters.rate)

    def messages(self, tick: int) -> Sequence[SourceMessage]:
        """Return the scan of a tick."""
        stamp_ns = stamp_of(tick, self.parameters.rate)
        return (SourceMessage(RAW_TOPIC, stamp_ns, self._scans[self._index(tick)].at(stamp_ns, tick)),)

    def _index(self, tick: int) -> int:
        last = len(self._scans) - 1
        at = tick % (2 * last) if last else 0
        return at if at <= last else 2 * last - at


def _template(data: bytes, where: str) -> ScanTemplate:
    try:
        return ScanTemplate(data)
    except TopicError as error:
        raise BagError(error.what, where=where, expected=error.expected) from None
