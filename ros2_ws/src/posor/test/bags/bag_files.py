# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Writes bags of arbitrary bytes chunk by chunk, and reads them with rosbags and with the block reader."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path

from mcap.records import ChunkIndex
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from posor.bags.bag_reader import opened_bag
from posor.bags.block_reader import read_blocks
from posor.bags.mcap_file import checked_index
from posor.messages.message_definitions import MessageTypes
from posor.ros_names import RAW_SCAN
from posor_lab.harness.recorded_messages import read_bag
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

TOPICS = ("/one/raw", "/two/raw", "/other/raw")
WANTED = list(TOPICS[:2])
COMPRESSIONS = {CompressionMode.NONE: CompressionType.NONE, CompressionMode.STORAGE: CompressionType.ZSTD}
Record = tuple[str, int, bytes]  # topic, log time [ns], message


def write(
    path: Path,
    chunks: Iterable[Sequence[Record]],
    storage: StoragePlugin = StoragePlugin.MCAP,
    mode: CompressionMode = CompressionMode.NONE,
) -> None:
    """Write messages into a bag; where the storage has chunks, into these."""
    chunks = list(chunks)
    types = MessageTypes()
    text, type_hash = types.definition(RAW_SCAN)
    writer = Writer(path, version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {topic: writer.add_connection(topic, RAW_SCAN, msgdef=text, rihs01=type_hash) for topic in TOPICS}
        for topic, time_ns, data in chain.from_iterable(chunks):
            writer.write(connections[topic], time_ns, data)
    if storage == StoragePlugin.MCAP and mode in COMPRESSIONS:
        with (path / f"{path.name}.mcap").open("wb") as file:
            write_chunks(McapWriter(file, compression=COMPRESSIONS[mode], enable_crcs=False), chunks, text)


def write_chunks(writer: McapWriter, chunks: Iterable[Sequence[Record]], text: str) -> None:
    """Write an MCAP file chunk by chunk, without checksums."""
    writer.start("ros2")
    schema = writer.register_schema(RAW_SCAN, "ros2msg", text.encode())
    channels = {topic: writer.register_channel(topic, "cdr", schema) for topic in TOPICS}
    for chunk in chunks:
        for topic, time_ns, data in chunk:
            writer.add_message(channels[topic], time_ns, data, time_ns)
        writer.flush()
    writer.finish()


def chunk_indices(file: Path) -> list[ChunkIndex]:
    """Return the places of the chunks of an MCAP file."""
    return [record for record in checked_index(file, file.read_bytes()) if isinstance(record, ChunkIndex)]


def in_chunks(records: Sequence[Record], size: int) -> Iterator[list[Record]]:
    """Yield messages as a recorder would put them into chunks of so many bytes, about."""
    chunk: list[Record] = []
    for record in records:
        chunk.append(record)
        if sum(len(data) for _, _, data in chunk) >= size:
            yield chunk
            chunk = []
    if chunk:
        yield chunk


def damaged(path: Path, at: int, data: bytes) -> None:
    """Replace bytes of a file."""
    whole = bytearray(path.read_bytes())
    whole[at : at + len(data)] = data
    path.write_bytes(whole)


def by_rosbags(path: Path) -> list[Record]:
    """Return the messages of the wanted topics, as a replay takes them."""
    return read_bag(path, WANTED)


def by_blocks(path: Path) -> Iterator[Record]:
    """Yield the messages of the wanted topics, as the block reader reads them."""
    with opened_bag(path) as reader:
        for block in read_blocks(reader, WANTED, str(path)):
            for topic, time_ns, start, length in zip(
                block.topics, block.times_ns, block.starts, block.lengths, strict=True
            ):
                yield WANTED[topic], int(time_ns), block.data[start : start + length].tobytes()
