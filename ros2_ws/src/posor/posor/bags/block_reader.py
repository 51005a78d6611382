# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reads the messages of some topics of a bag, thousands at a time or one by one, in the order of ``read_order.py``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor.bags.mcap_file import RECOVER
from posor.bags.read_order import order_scans
from posor.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from rosbags.interfaces import Connection

    from posor.bags.message_block import MessageBlock
    from posor.bags.ordered_reader import OrderedReader


def read_blocks(reader: OrderedReader, topics: Sequence[str], where: str) -> Iterator[MessageBlock]:
    """Yield the messages of some topics in the order of their log times, scans in the order of their numbers.

    Messages of equal log time keep their order in the file. ``topics``: the topics; a block numbers them in this order;
    ``where``: name of the bag in errors. Raises BagError: a topic also holds messages that cannot be read, a chunk is
    cut short or damaged, chunks overlap so much that too many messages wait, or the order of the scans is unknown; at
    the end, when the number of messages differs from that in the bag's index.
    """
    for topic, why, messages in reader.unread:
        if topic in topics:
            raise BagError(f"topic {topic} also holds {messages} messages {why}", where=where, expected="one encoding")
    count = 0
    for block in order_scans(reader.read_blocks(topics, where), reader, topics, where):
        count += len(block)
        yield block
    expected = sum(connection.msgcount for connection in reader.connections if connection.topic in topics)
    if count != expected:
        raise BagError(
            f"holds {count} messages of {', '.join(topics)}",
            where=where,
            expected=f"{expected}, as the index of the bag states; {RECOVER}",
        )


def read_messages(
    reader: OrderedReader, topics: Collection[str], where: str
) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield the messages of some topics one by one, as ``read_blocks``: topic, log time [ns], bytes."""
    connections = {connection.topic: connection for connection in reader.connections}
    names = list(topics)
    for block in read_blocks(reader, names, where):
        columns = (block.topics, block.times_ns, block.starts, block.lengths)
        for topic, time_ns, start, length in zip(*(column.tolist() for column in columns), strict=True):
            yield connections[names[topic]], time_ns, block.data[start : start + length].tobytes()
