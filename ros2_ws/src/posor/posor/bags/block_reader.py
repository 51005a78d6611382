"""Reads the messages of some topics of a bag thousands at a time, in the order of rosbags' ``Reader.messages``.

rosbags opens the bag and knows its files, chunks and topics. MCAP files are read a whole chunk at a time; every other
kind of bag (SQLite, MCAP without an index, messages compressed one by one) is read message by message by rosbags.
"""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader

from posor.bags.chunk_merger import ChunkMerger
from posor.bags.chunk_reader import ChunkReader
from posor.bags.message_block import MessageBlock
from posor.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rosbags.rosbag2 import Reader

BLOCK_BYTES = 4 << 20
"""Approximate bytes that are read at a time; a single chunk may be larger."""
BLOCK_MESSAGES = 16_384
"""Messages that are read at a time where rosbags reads them one by one."""


def read_blocks(reader: Reader, topics: Sequence[str], where: str) -> Iterator[MessageBlock]:
    """Yield the messages of some topics in the order of ``reader.messages``.

    In a file of the bag, the order is that of the log times; messages of equal log time keep their order in the file.

    Args:
        reader: The opened bag.
        topics: The topics; a block numbers them in this order.
        where: Name of the bag in errors.

    Raises:
        BagError: A chunk is cut short or damaged, or chunks overlap so much that too many messages wait; at the end,
            when the number of messages differs from that in the bag's index.

    """
    expected = sum(connection.msgcount for connection in reader.connections if connection.topic in topics)
    count = 0
    for block in _read_blocks(reader, topics, where):
        count += len(block)
        yield block
    if count != expected:
        raise BagError(
            f"holds {count} messages of {', '.join(topics)}", where=where, expected=f"{expected}, as its index says"
        )


def _read_blocks(reader: Reader, topics: Sequence[str], where: str) -> Iterator[MessageBlock]:
    storage = reader.storage
    files = storage.storages if isinstance(storage, DirectoryReader) else [storage]
    chunked = [file for file in files if isinstance(file, McapReader) and file.chunks]
    if len(chunked) == len(files) and reader.compression_mode != "message":
        for file in chunked:
            yield from _read_chunks(file, topics, where)
    else:
        yield from _read_messages(reader, topics)


def _read_messages(reader: Reader, topics: Sequence[str]) -> Iterator[MessageBlock]:
    """Yield blocks of messages that rosbags reads one by one."""
    numbers = {topic: number for number, topic in enumerate(topics)}
    messages = reader.messages([connection for connection in reader.connections if connection.topic in numbers])
    while group := list(islice(messages, BLOCK_MESSAGES)):
        lengths = np.fromiter((len(data) for _, _, data in group), np.int64, len(group))
        yield MessageBlock(
            data=np.frombuffer(b"".join(data for _, _, data in group), dtype=np.uint8),
            topics=np.fromiter((numbers[connection.topic] for connection, _, _ in group), np.int64, len(group)),
            times_ns=np.fromiter((time_ns for _, time_ns, _ in group), np.int64, len(group)),
            starts=np.cumsum(lengths) - lengths,
            lengths=lengths,
        )


def _read_chunks(file: McapReader, topics: Sequence[str], where: str) -> Iterator[MessageBlock]:
    """Yield the messages of an MCAP file; a message that one of a later chunk may precede waits for that chunk."""
    chunks, merger = ChunkReader(file, topics, where), ChunkMerger(BLOCK_BYTES, topics, where)
    while chunks:
        size = 0
        while chunks and (not size or size + chunks.next_size <= BLOCK_BYTES):
            size += chunks.next_size
            merger.add(*chunks.read_next())
        yield from merger.take_before(chunks.next_position)
