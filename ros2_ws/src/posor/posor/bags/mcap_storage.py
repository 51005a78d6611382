# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A closed MCAP file of any writer: with or without chunks, with or without each part of an index, of any profile."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from mcap.opcode import Opcode
from mcap.records import Channel, Schema, Statistics

from posor.bags.mcap_file import (
    CHANNEL,
    Damage,
    Definitions,
    checked_index,
    damage_error,
    definitions_of,
    mapped,
    read_spans,
    records_of,
    span_records,
)
from posor.bags.recorded_topics import StoredTopic, Unread
from posor.bags.stored_file import LAST_TIME_NS, StoredFile
from posor.errors import BagError, clause_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from mcap.records import McapRecord

    from posor.bags.mcap_file import Span
    from posor.bags.recorded_topics import BagMetadata


class McapFile(StoredFile):
    """An MCAP file that was closed; of any profile, with or without chunks and each part of an index."""

    def __init__(self, path: Path, storage: Path, metadata: BagMetadata) -> None:
        """Read the index and where the messages are.

        ``storage``: the file to read; another one than ``path`` if that is compressed. Raises BagError: the file is
        damaged.
        """
        super().__init__(path)
        self._storage = storage
        with mapped(storage) as data:
            self.index = checked_index(path, data)
            self.spans = list(read_spans(path, data, self.index))
        filled = [span for span in self.spans if span.end_ns >= span.start_ns and (span.end_ns or span.start_ns)]
        filled = filled or self.spans
        schemas, channels, counts = self._topics()
        for number, channel in sorted(channels.items()):
            if not channel.schema_id or channel.schema_id in schemas:
                self._add_topic(topic_of(channel, schemas), counts[number], metadata)
            elif counts[number]:
                self.unread.append(Unread(channel.topic, "of a schema that the file lacks", counts[number]))
        for number in sorted(counts.keys() - channels.keys()):
            self.unread.append(Unread(f"of channel {number}", "of no defined topic", counts[number]))
        if sum(counts.values()):
            self.start_ns = min(span.start_ns for span in filled)
            self.end_ns = max(span.end_ns for span in filled)
        if self.end_ns > LAST_TIME_NS:
            raise BagError(f"messages are logged at {self.end_ns} ns", where=str(path), expected="at most 2^63 ns")

    def records(self, span: Span) -> bytes:
        """Return the records of a span. Raises BagError: they are damaged."""
        content = self.read(span.offset, span.length)
        try:
            return span_records(content, is_chunk=span.is_chunk)
        except Exception as error:
            raise self.damage(span, f"a chunk is damaged: {clause_of(error).lower()}") from error

    def read(self, offset: int, length: int) -> bytes:
        """Return bytes of the file."""
        with self._storage.open("rb") as opened:
            opened.seek(offset)
            return opened.read(length)

    def damage(self, span: Span, what: str) -> BagError:
        """Return the error of a span that is damaged; ``what``: a clause."""
        return damage_error(self.path, Damage(span.offset, span.length, what))

    def close(self) -> None:
        """Nothing is kept open."""

    def _topics(self) -> tuple[dict[int, Schema], dict[int, Channel], Mapping[int, int]]:
        """Return schemas, channels and the number of messages by channel: of the index, or of the whole file."""
        statistics = next((each for each in self.index if isinstance(each, Statistics)), None)
        schemas, channels = definitions_by_number(self.index)
        if statistics is not None:
            counts = Counter({number: count for number, count in statistics.channel_message_counts.items() if count})
            known = {number for number, each in channels.items() if each.schema_id in schemas or not each.schema_id}
            if counts.total() == statistics.message_count and counts.keys() <= known:
                return schemas, channels, counts
        counts, definitions = Counter[int](), Definitions(self.index)
        for span in self.spans:
            try:
                records = list(records_of(self.records(span)))
                for record in records:
                    if record.opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                        definitions.add(record)
            except ValueError as error:
                raise self.damage(span, f"a chunk is damaged: {clause_of(error).lower()}") from error
            more_schemas, more_channels = definitions_by_number(definitions_of(records))
            schemas, channels = schemas | more_schemas, channels | more_channels
            counts.update(
                CHANNEL.unpack_from(content)[0]
                for opcode, content in records
                if opcode == Opcode.MESSAGE and len(content) >= CHANNEL.size
            )
        return schemas, channels, counts


def definitions_by_number(records: Iterable[McapRecord]) -> tuple[dict[int, Schema], dict[int, Channel]]:
    """Return the schemas and the channels among some records by their numbers."""
    schemas, channels = dict[int, Schema](), dict[int, Channel]()
    for each in records:
        if isinstance(each, Schema):
            schemas[each.id] = each
        elif isinstance(each, Channel):
            channels[each.id] = each
    return schemas, channels


def topic_of(channel: Channel, schemas: Mapping[int, Schema]) -> StoredTopic:
    """Return the topic of a channel; ``schemas``: by number."""
    schema = schemas.get(channel.schema_id) or Schema(data=b"", encoding="", id=0, name="")
    return StoredTopic(
        channel.id,
        channel.topic,
        schema.name,
        channel.message_encoding,
        schema.encoding,
        schema.data,
        qos=channel.metadata.get("offered_qos_profiles", ""),
    )
