"""The messages of some topics of a bag, thousands at a time, in the order of their log times.

rosbags opens the bag and knows its files, chunks and topics. The records of whole chunks of an MCAP file are found by a
compiled loop; of every other kind of bag (SQLite, MCAP without an index, messages compressed one by one) rosbags reads
message by message.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader, decompress, read_exact

from posor_estimator.bulk.scanning import MESSAGE_HEAD, RECORD_HEAD, index_messages
from posor_estimator.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rosbags.rosbag2 import Reader
    from rosbags.rosbag2.storage_mcap import ChunkInfo

    from posor_estimator.core.types import ByteArray, IntArray

BLOCK = 4 << 20
"""Bytes that are read at a time, about; a single chunk may be larger."""
MESSAGES = 16_384
"""Messages that are read at a time where rosbags reads them one by one."""
CHUNK_HEAD = 9 + 40
"""Bytes of a chunk record before its compression's name and its records, as rosbags counts them."""
CRC_AT = 9 + 24


@dataclass(frozen=True)
class Block:
    """Messages, n of them, in the order of their log times.

    Attributes:
        data: Where their bytes lie.
        topics: Of each message, which of the wanted topics it is of, shape (n,).
        times_ns: Log times, shape (n,).
        starts: Where each begins in ``data``, shape (n,).
        lengths: How many bytes each has, shape (n,).

    """

    data: ByteArray
    topics: IntArray
    times_ns: IntArray
    starts: IntArray
    lengths: IntArray

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.times_ns)

    def chosen(self, which: IntArray | slice) -> Block:
        """Return some of the messages, which share their bytes with this block."""
        return Block(self.data, self.topics[which], self.times_ns[which], self.starts[which], self.lengths[which])


def blocks(reader: Reader, topics: Sequence[str], where: str) -> Iterator[Block]:
    """Yield the messages of some topics; log times never go back within a file of the bag, as rosbags has it.

    Args:
        reader: The bag, opened.
        topics: Which topics; a block numbers them in this order.
        where: What to call the bag.

    Raises:
        BagError: A chunk is cut short or damaged; at the end, when there were fewer or more messages than the bag's
            index says.

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
    numbers = np.full(1 << 16, -1, dtype=np.int64)
    for connection in file.connections:
        if connection.topic in topics:
            numbers[connection.id] = topics.index(connection.topic)
    chunks = [chunk for chunk in file.chunks if any(numbers[channel] >= 0 for channel in chunk.channel_count)]
    chunks.sort(key=lambda chunk: (chunk.message_start_time, chunk.chunk_start_offset))
    waiting = b""
    while chunks:
        size = 0
        several: list[ChunkInfo] = []
        while chunks and (not several or size + chunks[0].uncompressed_size <= BLOCK):
            several.append(chunks.pop(0))
            size += several[-1].uncompressed_size
        records = [_records(file, each) for each in several]  # a single one is not copied when it is joined
        data = b"".join([waiting, *records] if waiting else records)
        block = _sorted(_found(np.frombuffer(data, np.uint8), numbers, where))
        ready = len(block)
        if chunks:
            ready = int(np.searchsorted(block.times_ns, chunks[0].message_start_time, side="left"))
        waiting = b"".join(
            block.data[start - MESSAGE_HEAD - RECORD_HEAD : start + length].tobytes()
            for start, length in zip(block.starts[ready:].tolist(), block.lengths[ready:].tolist(), strict=True)
        )
        yield block.chosen(slice(ready))


def _records(file: McapReader, chunk: ChunkInfo) -> bytes:
    """Return the records of a chunk, decompressed."""
    bio = file.bio
    if bio is None:
        message = "the file is closed"
        raise ValueError(message)
    bio.seek(chunk.chunk_start_offset + CRC_AT)
    crc = int.from_bytes(read_exact(bio, 4), "little")
    bio.seek(chunk.chunk_start_offset + CHUNK_HEAD + len(chunk.compression))
    return decompress(read_exact(bio, chunk.compressed_size), chunk.compression, chunk.uncompressed_size, crc)


def _found(data: ByteArray, numbers: IntArray, where: str) -> Block:
    """Return the messages of wanted topics among the records of chunks; ``numbers`` are these topics', by channel."""
    most = len(data) // (RECORD_HEAD + MESSAGE_HEAD) + 1
    topics, times, starts, lengths = (np.empty(most, dtype=np.int64) for _ in range(4))
    count, end = index_messages(data, numbers, topics, times, starts, lengths)
    if end != len(data):
        when = f", after the message logged at {times[count - 1]} ns" if count else ""
        raise BagError(f"a chunk holds a record that runs beyond its end{when}", where=where, expected="whole records")
    return Block(data, topics[:count], times[:count], starts[:count], lengths[:count])


def _sorted(block: Block) -> Block:
    if np.all(block.times_ns[1:] >= block.times_ns[:-1]):
        return block
    return block.chosen(np.argsort(block.times_ns, kind="stable"))
