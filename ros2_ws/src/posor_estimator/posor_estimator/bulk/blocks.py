"""The messages of some topics of a bag, thousands at a time, in the order in which rosbags reads them.

rosbags opens the bag and knows its files, chunks and topics. MCAP files are read a whole chunk at a time; every other
kind of bag (SQLite, MCAP without an index, messages compressed one by one) is read message by message by rosbags.
"""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader

from posor_estimator.bulk.block import Block
from posor_estimator.bulk.chunks import Chunks
from posor_estimator.bulk.waiting import Waiting
from posor_estimator.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rosbags.rosbag2 import Reader

BLOCK = 4 << 20
"""Bytes that are read at a time, about; a single chunk may be larger."""
MESSAGES = 16_384
"""Messages that are read at a time where rosbags reads them one by one."""


def blocks(reader: Reader, topics: Sequence[str], where: str) -> Iterator[Block]:
    """Yield the messages of some topics in the very order of ``reader.messages``.

    In a file of the bag, that is by log time; those of equal log time in the order in which they lie in it.

    Args:
        reader: The bag, opened.
        topics: Which topics; a block numbers them in this order.
        where: What to call the bag.

    Raises:
        BagError: A chunk is cut short or damaged, or chunks overlap so much that too many messages wait; at the end,
            when there were fewer or more messages than the bag's index says.

    """
    promised = sum(connection.msgcount for connection in reader.connections if connection.topic in topics)
    count = 0
    for block in _blocks(reader, topics, where):
        count += len(block)
        yield block
    if count != promised:
        raise BagError(
            f"holds {count} messages of {', '.join(topics)}", where=where, expected=f"{promised}, as its index says"
        )


def _blocks(reader: Reader, topics: Sequence[str], where: str) -> Iterator[Block]:
    storage = reader.storage
    files = storage.storages if isinstance(storage, DirectoryReader) else [storage]
    chunked = [file for file in files if isinstance(file, McapReader) and file.chunks]
    if len(chunked) == len(files) and reader.compression_mode != "message":
        for file in chunked:
            yield from _of_chunks(file, topics, where)
    else:
        yield from _one_by_one(reader, topics)


def _one_by_one(reader: Reader, topics: Sequence[str]) -> Iterator[Block]:
    numbers = {topic: number for number, topic in enumerate(topics)}
    messages = reader.messages([connection for connection in reader.connections if connection.topic in numbers])
    while some := list(islice(messages, MESSAGES)):
        lengths = np.fromiter((len(data) for _, _, data in some), np.int64, len(some))
        yield Block(
            data=np.frombuffer(b"".join(data for _, _, data in some), dtype=np.uint8),
            topics=np.fromiter((numbers[connection.topic] for connection, _, _ in some), np.int64, len(some)),
            times_ns=np.fromiter((time_ns for _, time_ns, _ in some), np.int64, len(some)),
            starts=np.cumsum(lengths) - lengths,
            lengths=lengths,
        )


def _of_chunks(file: McapReader, topics: Sequence[str], where: str) -> Iterator[Block]:
    """Yield the messages of an MCAP file; those that a later chunk may precede wait for it."""
    chunks, waiting = Chunks(file, topics, where), Waiting(BLOCK, topics, where)
    while chunks:
        size = 0
        while chunks and (not size or size + chunks.size <= BLOCK):
            size += chunks.size
            waiting.add(*chunks.read())
        yield from waiting.before(chunks.first)
