# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""MCAP files read without trust in their index: whole records, damaged places, checksums (https://mcap.dev/spec).

A checksum of 0 means that the writer stated none.
"""

from __future__ import annotations

from contextlib import ExitStack, contextmanager, suppress
from io import BytesIO
from itertools import pairwise
from mmap import ACCESS_READ, mmap
from struct import Struct
from struct import error as StructError
from typing import TYPE_CHECKING, NamedTuple
from zlib import crc32

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, Schema
from mcap.stream_reader import StreamReader

from posor.errors import BagError, clause_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from mcap.records import McapRecord

RECOVER = "'recover' of posor writes what is whole to a new bag"
ADVICE = f"an undamaged file; {RECOVER}"
MAGIC = b"\x89MCAP0\r\n"  # first and last bytes of a file
RECORD_HEAD = Struct("<BQ")  # opcode, and length of what follows
INDEX_HEAD = Struct("<BQHI")  # head of a topic's index record: opcode, length, channel, length of the entries
INDEX_ENTRY_SIZE = 16
FOOTER = Struct("<BQQQI")  # head, offset of the index, offset of its table of contents, checksum of the index
OF_MESSAGES = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE}
OF_DATA = OF_MESSAGES | {Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END}
"""Records between the header and the index."""
SHORTEST = {Opcode.MESSAGE: 22, Opcode.CHUNK: 40, Opcode.MESSAGE_INDEX: 6, Opcode.DATA_END: 4}
"""Bytes of the shortest content of a record. Longer ones may end with fields of a later version, but for messages."""
UNKNOWN = range(0x10, 0x100)
"""Records of applications and of later versions of the format, which every reader skips."""
PIECE_BYTES = 4 << 20
"""Most bytes of successive messages outside of chunks that are read at a time, but for a longer message."""
MESSAGE = Struct("<QHIQ")  # of a message after its opcode: length, channel, sequence number, log time
CHANNEL = Struct("<H")  # first of a message's content
CHUNK_TIMES = Struct("<QQQ")  # first of a chunk's content: first and last log time, size of the decompressed records


class Record(NamedTuple):
    """A record: its type, and its content without the head."""

    opcode: int
    content: bytes


class Damage(NamedTuple):
    """A damaged place of a file."""

    offset: int  # where it begins [bytes]
    size: int  # up to the next whole chunk, or to the end of the data [bytes]
    what: str  # what is wrong, a clause


class Span(NamedTuple):
    """Bytes of a file that hold messages: a chunk, or successive messages outside of chunks with their definitions."""

    offset: int
    length: int  # with the head of a chunk [bytes]
    size: int  # of the decompressed records [bytes]
    start_ns: int  # first log time
    end_ns: int  # last log time; before the first one: there is no message
    channels: frozenset[int] | None  # channels of the messages; None: unknown
    is_chunk: bool
    index_length: int = 0  # of the message index records after a chunk; 0: there are none, or their place is unknown


NOT_MCAP = Damage(0, len(MAGIC), "the file does not begin as MCAP files do")


class DamagedError(Exception):
    """A record is damaged; the text is a clause that says how."""


@contextmanager
def mapped(path: Path) -> Iterator[mmap]:
    """Map a file into memory. Raises BagError: there is no regular file, it is empty, or it cannot be read."""
    with ExitStack() as stack:
        try:
            if not path.is_file():
                raise BagError("is not a file", where=str(path), expected="an MCAP file")
            if not path.stat().st_size:
                raise BagError("the file is empty", where=str(path), expected=ADVICE)
            file = stack.enter_context(path.open("rb"))
            data = stack.enter_context(mmap(file.fileno(), 0, access=ACCESS_READ))
        except OSError as error:
            raise BagError(f"the bag cannot be read, {error.strerror}", where=str(path)) from error
        yield data


def checked_index(path: Path, data: mmap | bytes) -> list[McapRecord]:
    """Return the records of the index of a file; an empty list if the file has none.

    ``path``: names the file in errors. Raises BagError: the file is not MCAP, or its index is damaged.
    """
    index = read_index(data) if data[: len(MAGIC)] == MAGIC else NOT_MCAP
    if isinstance(index, Damage):
        raise damage_error(path, index)
    return index


def damage_error(path: Path, damage: Damage) -> BagError:
    """Return the error that names a damaged place."""
    return BagError(damage.what, where=f"{path}, byte {damage.offset}", expected=ADVICE)


def read_index(data: mmap | bytes) -> list[McapRecord] | Damage:
    """Return the records of the index at the end of a file, or how it is damaged."""
    index = index_begin(data)
    if isinstance(index, Damage):
        return index
    try:
        return list(StreamReader(BytesIO(data[index.offset :]), skip_magic=True).records)[:-1]  # without the footer
    except (McapError, ValueError, OverflowError, StructError):
        return Damage(index.offset, len(data) - index.offset, "the index holds an invalid record")


def read_spans(path: Path, data: mmap | bytes, index: Iterable[McapRecord]) -> Iterator[Span]:
    """Yield all bytes between the header and the index of an undamaged file that hold messages.

    The index only shortens the way: chunks that it does not list are found, too, and so are messages outside of chunks.
    Raises BagError: a record is damaged.
    """
    listed = {each.chunk_start_offset: each for each in index if isinstance(each, ChunkIndex)}
    begin = index_begin(data)
    end = len(data) if isinstance(begin, Damage) else begin.offset
    position, piece, has_chunks = after_header(data), _Piece(), False
    while position < end:
        try:
            opcode, after = read_head(data, position, end)
            check_place(opcode, has_chunks=has_chunks, is_last=after == end)
        except DamagedError as error:
            raise damage_error(path, Damage(position, end - position, str(error))) from error
        if piece.size and (opcode not in OF_MESSAGES or piece.size + after - position > PIECE_BYTES):
            yield piece.span(position)
            piece = _Piece()
        if opcode == Opcode.DATA_END:
            break
        if opcode in OF_MESSAGES:
            piece.add(data, opcode, position, after)
        elif opcode == Opcode.CHUNK:
            has_chunks = True
            chunk = listed.pop(position, None)
            yield _chunk_span(data, position, after, chunk)
            after += chunk.message_index_length if chunk else 0
        position = after
    if piece.size:
        yield piece.span(end)
    if listed:
        raise damage_error(path, Damage(min(listed), 0, "there is no chunk, which the index lists"))


def check_place(opcode: int, *, has_chunks: bool, is_last: bool) -> None:
    """Refuse the end of the data before the last record, and a message index before any chunk."""
    if opcode == Opcode.DATA_END and not is_last:
        raise DamagedError("the record that ends the data is not the last one")
    if opcode == Opcode.MESSAGE_INDEX and not has_chunks:
        raise DamagedError("an index record follows no chunk")


class _Piece:
    """Successive records of messages and definitions outside of chunks."""

    def __init__(self) -> None:
        self.size = 0
        self._start_ns, self._end_ns = 1 << 64, -1
        self._channels = set[int]()

    def add(self, data: mmap | bytes, opcode: int, position: int, after: int) -> None:
        self.size += after - position
        if opcode == Opcode.MESSAGE:
            _, channel, _, time_ns = MESSAGE.unpack_from(data, position + 1)
            self._start_ns, self._end_ns = min(self._start_ns, time_ns), max(self._end_ns, time_ns)
            self._channels.add(channel)

    def span(self, end: int) -> Span:
        channels = frozenset(self._channels)
        return Span(end - self.size, self.size, self.size, self._start_ns, self._end_ns, channels, is_chunk=False)


def _chunk_span(data: mmap | bytes, position: int, after: int, chunk: ChunkIndex | None) -> Span:
    """Return the span of a chunk; ``chunk``: what the index says of it, if anything."""
    if chunk is None:
        start_ns, end_ns, size = CHUNK_TIMES.unpack_from(data, position + RECORD_HEAD.size)
        return Span(position, after - position, size, start_ns, end_ns, None, is_chunk=True)
    return Span(
        position,
        after - position,
        chunk.uncompressed_size,
        chunk.message_start_time,
        chunk.message_end_time,
        _channels_of(chunk),
        is_chunk=True,
        index_length=chunk.message_index_length,
    )


def _channels_of(chunk: ChunkIndex) -> frozenset[int] | None:
    """Return the channels whose message index records, of 15 bytes and more, have entries; None: unknown."""
    begin = chunk.chunk_start_offset + chunk.chunk_length
    end = begin + chunk.message_index_length
    offsets = sorted((offset, number) for number, offset in chunk.message_index_offsets.items())
    if not offsets or offsets[0][0] < begin or offsets[-1][0] >= end:
        return None
    found = frozenset(
        number for (first, number), (last, _) in pairwise([*offsets, (end, 0)]) if last - first > INDEX_HEAD.size
    )
    return found or None


def span_records(content: bytes, *, is_chunk: bool) -> bytes:
    """Return the records of a span, decompressed. Raises: see ``chunk_records``."""
    return chunk_records(content[RECORD_HEAD.size :]) if is_chunk else content


def definitions_of(records: Iterable[Record]) -> Iterator[Schema | Channel]:
    """Yield the schemas and channels among some records; invalid ones, and schemas of the number 0, are left out."""
    for record in records:
        with suppress(ValueError):
            if record.opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                found = _definition(record)
                if isinstance(found, Channel) or found.id:
                    yield found


def _definition(record: Record) -> Schema | Channel:
    """Return a schema or a channel. Raises ValueError: the record is invalid."""
    kind = Schema if record.opcode == Opcode.SCHEMA else Channel
    try:
        found: Schema | Channel = kind.read(ReadDataStream(BytesIO(record.content)))
    except (McapError, OverflowError, StructError) as error:
        raise ValueError(str(error)) from error
    return found


class Definitions:
    """Schemas and channels of a file, of which those of one number must be equal."""

    def __init__(self, index: Iterable[McapRecord] = ()) -> None:
        self._known = {(type(each), each.id): each for each in index if isinstance(each, (Schema, Channel))}

    def add(self, record: Record) -> None:
        """Add a definition. Raises ValueError: it is invalid, or differs from the one of the same number."""
        found = _definition(record)
        if self._known.setdefault((type(found), found.id), found) != found:
            kind = type(found).__name__.lower()
            message = f"{kind} {found.id} differs from another one of the same number"
            raise ValueError(message)

    def has_channel(self, number: int) -> bool:
        """Return whether there is a channel of a number."""
        return (Channel, number) in self._known


class _IndexBegin(NamedTuple):
    """Where the index begins, and whether its checksum shows that this is true."""

    offset: int
    checked: bool


def index_begin(data: mmap | bytes) -> _IndexBegin | Damage:
    """Return where the index begins, or how it is damaged."""
    footer_at = len(data) - FOOTER.size - len(MAGIC)
    if footer_at < len(MAGIC) or data[-len(MAGIC) :] != MAGIC:
        return Damage(len(data), 0, "the file was not closed or is cut short")
    opcode, length, begin, _, checksum = FOOTER.unpack_from(data, footer_at)
    if opcode != Opcode.FOOTER or length != FOOTER.size - RECORD_HEAD.size or not begin <= footer_at:
        return Damage(footer_at, FOOTER.size, "the footer is damaged")
    begin = begin or footer_at
    if checksum and crc32(data[begin : footer_at + FOOTER.size - 4]) != checksum:
        return Damage(begin, footer_at - begin, "the index does not have its checksum")
    return _IndexBegin(begin, bool(checksum))


def records_of(data: bytes) -> Iterator[Record]:
    """Yield successive records. Raises ValueError: the last record runs beyond the end."""
    position = 0
    while position < len(data):
        content = position + RECORD_HEAD.size
        opcode, length = RECORD_HEAD.unpack_from(data, position) if content <= len(data) else (0, len(data))
        position = content + length
        if position > len(data):
            message = "a record runs beyond the end"
            raise ValueError(message)
        yield Record(opcode, data[content:position])


def after_header(data: mmap | bytes) -> int:
    """Return the offset after the header record; after the magic bytes if there is no whole header."""
    begin = len(MAGIC)
    if len(data) < begin + RECORD_HEAD.size:
        return begin
    opcode, length = RECORD_HEAD.unpack_from(data, begin)
    after = begin + RECORD_HEAD.size + length
    return int(after) if opcode == Opcode.HEADER and after <= len(data) else begin


def read_head(data: mmap | bytes, position: int, end: int) -> tuple[int, int]:
    """Return type and end of the record at an offset in the data, which end at ``end``."""
    if position + RECORD_HEAD.size > end:
        raise DamagedError("the file is cut short within a record")
    opcode, length = RECORD_HEAD.unpack_from(data, position)
    after = position + RECORD_HEAD.size + length
    if opcode not in OF_DATA and opcode not in UNKNOWN:
        raise DamagedError(f"there is no record, but a byte 0x{opcode:02x}")
    if after > end:
        raise DamagedError(f"the file is cut short within a record of {length} bytes, or its length is damaged")
    if length < SHORTEST.get(opcode, 0):
        raise DamagedError(f"a record of type 0x{opcode:02x} has only {length} bytes")
    return opcode, after


def read_record(data: mmap | bytes, position: int) -> tuple[int, list[Record], int]:
    """Return type, records of messages, and end of the record at an offset."""
    opcode, after = read_head(data, position, len(data))
    content, records = position + RECORD_HEAD.size, list[Record]()
    if opcode == Opcode.CHUNK:
        try:
            records = list(records_of(chunk_records(data[content:after])))
        except Exception as error:  # each compression raises errors of its own
            raise DamagedError(f"a chunk is damaged: {clause_of(error).lower()}") from error
    elif opcode not in {Opcode.MESSAGE_INDEX, Opcode.DATA_END}:
        records = [Record(opcode, data[content:after])]
    elif opcode == Opcode.MESSAGE_INDEX:
        _, _, _, size = INDEX_HEAD.unpack_from(data, position)
        if position + INDEX_HEAD.size + size > after or size % INDEX_ENTRY_SIZE:
            raise DamagedError("the sizes in an index record contradict one another")
    return opcode, records, after


def chunk_records(content: bytes) -> bytes:
    """Return the records of a chunk, decompressed; ``content``: the chunk's record without its head.

    Raises ValueError: the compression is unknown, or sizes or the checksum differ from those that the chunk states;
    McapError, RuntimeError, zstandard.ZstdError: the content is damaged.
    """
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    if chunk.compression == "zstd":
        data = zstandard.decompress(chunk.data, chunk.uncompressed_size)
    elif chunk.compression == "lz4":
        data = lz4.frame.decompress(chunk.data)
    elif chunk.compression:
        raise ValueError(f"unknown compression '{chunk.compression}'")
    else:
        data = chunk.data
    if len(data) != chunk.uncompressed_size:
        raise ValueError(f"chunk size mismatch: expected {chunk.uncompressed_size} bytes, got {len(data)}")
    if chunk.uncompressed_crc and crc32(data) != chunk.uncompressed_crc:
        raise ValueError("chunk checksum mismatch")
    return data
