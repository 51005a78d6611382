# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Source ``bag``: scans recorded in a rosbag2 bag, MCAP or SQLite.

Scans that were recorded with another version of RawScan are published in the present one.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from posor.bags.bag_reader import checked_type, opened_bag, scan_schema, scan_topic
from posor.bags.block_reader import read_messages
from posor.errors import BagError
from posor.messages.message_definitions import installed_schema
from posor.parameter_model import ParameterGroup
from posor.ros_names import RAW_SCAN, RAW_TOPIC
from pydantic import Field

from posor_drivers.sources.source import RecordedSource, SourceMessage, Topic

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from posor.messages.cdr_schema import Schema, Value

NOT_MEASURED: dict[str, Value] = {"reference_voltage": math.nan}
"""What an older recording lacks and is not zero."""


class RecordedTopicParameters(ParameterGroup):
    """Parameters of every source that reads the scans of one topic of a bag."""

    path: Annotated[str, Field(min_length=1)] = Field(
        description="bag: folder with metadata.yaml, or a single .mcap or .db3 file"
    )
    topic: str = Field(default="", description="recorded topic of this joint's scans; empty: the only one there is")


class BagParameters(RecordedTopicParameters):
    """Parameters of the source ``bag``."""

    other_topics: tuple[str, ...] = Field(
        default=(), description="further recorded topics to replay, under their recorded names"
    )


class BagSource(RecordedSource[BagParameters]):
    """Replays the recorded bytes of the chosen topics."""

    Parameters = BagParameters

    _names: dict[str, str]
    _older: Schema | None  # of the recorded scans, where it is not the installed one

    @property
    def record(self) -> str:
        """The file."""
        return self.parameters.path

    def open(self) -> Sequence[Topic]:
        """Check that the bag's index is readable and holds the topics, in the versions installed here."""
        where = self.parameters.path
        with opened_bag(Path(where)) as reader:
            scans = scan_topic(reader.connections, self.parameters.topic, where, "parameter 'bag.topic'")
            if scans in self.parameters.other_topics:
                what, place = f"topic {scans} holds this joint's scans", "parameter 'bag.other_topics'"
                raise BagError(what, where=place, expected="other topics only")
            self._names = {scans: RAW_TOPIC} | {name: name for name in self.parameters.other_topics}
            known = reader.connections
            schema = scan_schema(known, scans, where)
            self._older = None if schema.fields == installed_schema(RAW_SCAN).fields else schema
            others = [
                Topic(name, checked_type(known, name, where, self.types)) for name in self.parameters.other_topics
            ]
            return [Topic(RAW_TOPIC, RAW_SCAN), *others]

    def read_messages(self) -> Iterator[SourceMessage]:
        """Yield the recorded messages in the order of their log times."""
        with opened_bag(Path(self.parameters.path)) as reader:
            for connection, time_ns, data in read_messages(reader, self._names, self.parameters.path):
                topic = self._names[connection.topic]
                if topic == RAW_TOPIC and self._older is not None:
                    values = NOT_MEASURED | self._older.values(data)
                    yield SourceMessage(topic, time_ns, installed_schema(RAW_SCAN).encode(values))
                else:
                    yield SourceMessage(topic, time_ns, data)
