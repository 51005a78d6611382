"""Writes MCAP bags whose chunks and index state their checksums, and which can be flushed while they are written.

rosbags writes schemas, channels, the index and metadata.yaml; it states no checksums. That of the whole data section is
not stated: the chunks hold all messages, and a reader would have to read the file twice.
"""

from __future__ import annotations

from collections import defaultdict
from io import BytesIO
from struct import Struct
from typing import TYPE_CHECKING, Literal
from zlib import crc32

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter, PendingChunk

from posor.bags.mcap_file import CHUNK_HEAD, FOOTER, INDEX_HEAD, MAGIC, PACKED_SIZE, RECORD_HEAD, Opcode

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from posor.numerics.array_types import IntArray

METADATA_VERSION: Literal[9] = 9
CHUNK_INDEX, INDEX_OFFSET, CHUNK_INDEX_END = Struct("<QQQQI"), Struct("<HQ"), Struct("<QIQQ")
"""A chunk in the index of the file: times and place; index record of each channel; sizes, without compression."""
CHECKSUM = Struct("<I")


class ChecksummedMcapWriter(McapWriter):
    """A rosbags MCAP writer that states the checksums of chunks and index; chunks are not compressed."""

    def append_chunk(
        self, records: bytes | memoryview, first_ns: int, last_ns: int, entries: Mapping[int, IntArray]
    ) -> None:
        """Write a chunk.

        Args:
            records: Its records.
            first_ns: Earliest log time of its messages.
            last_ns: Latest log time.
            entries: Log time and offset of each message, shape (n, 2), by channel.

        """
        size, begin = len(records), self.bio.tell()
        length = CHUNK_HEAD.size - RECORD_HEAD.size + PACKED_SIZE.size + size
        self.bio.write(CHUNK_HEAD.pack(Opcode.CHUNK, length, first_ns, last_ns, size, crc32(records), 0))
        self.bio.write(PACKED_SIZE.pack(size))
        self.bio.write(records)
        end = self.bio.tell()
        offsets = b""
        for channel, index in entries.items():
            offsets += INDEX_OFFSET.pack(channel, self.bio.tell())
            head_length = INDEX_HEAD.size - RECORD_HEAD.size
            self.bio.write(INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, head_length + index.nbytes, channel, index.nbytes))
            self.bio.write(index.data)
        summary = BytesIO()
        summary.write(CHUNK_INDEX.pack(first_ns, last_ns, begin, end - begin, len(offsets)))
        summary.write(offsets)
        summary.write(CHUNK_INDEX_END.pack(self.bio.tell() - end, 0, size, size))
        self.chunks.append(summary)

    def close_chunk(self) -> None:
        """Write the messages since the last chunk as a chunk."""
        chunk = self.chunk
        self.chunk = PendingChunk(2**63 - 1, 0, BytesIO(), defaultdict(list))
        entries = {channel: np.array(index, dtype="<i8") for channel, index in chunk.msgs.items()}
        self.append_chunk(chunk.bio.getvalue(), chunk.message_start_time, chunk.message_end_time, entries)

    def flush(self) -> None:
        """Hand all messages so far to the operating system, in a chunk of their own."""
        if self.chunk.msgs:
            self.close_chunk()
        self.bio.flush()

    def close(self, version: int, metadata: str) -> None:
        """Write the index with its checksum, and close the file."""
        super().close(version, metadata)
        with self.path.open("r+b") as file:
            checksum_at = file.seek(-len(MAGIC) - CHECKSUM.size, 2)
            file.seek(checksum_at + CHECKSUM.size - FOOTER.size)
            _, _, index_at, _, _ = FOOTER.unpack(file.read(FOOTER.size))
            file.seek(index_at)
            checksum = crc32(file.read(checksum_at - index_at))
            file.seek(checksum_at)
            file.write(CHECKSUM.pack(checksum))


class McapBagWriter(Writer):
    """A rosbags writer of bags in MCAP with checksums."""

    STORAGE_PLUGINS = {StoragePlugin.MCAP: ChecksummedMcapWriter}  # noqa: RUF012  as rosbags has it

    def __init__(self, path: Path) -> None:
        """Write a bag into a folder that does not exist yet."""
        super().__init__(path, version=METADATA_VERSION, storage_plugin=StoragePlugin.MCAP)

    def flush(self) -> None:
        """Hand all messages so far to the operating system; they survive the end of this process."""
        if isinstance(self.storage, ChecksummedMcapWriter):
            self.storage.flush()
