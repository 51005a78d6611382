"""MCAP files read without trust in their index: whole records, damaged places, checksums (https://mcap.dev/spec).

A checksum of 0 means that the writer stated none.
"""

from __future__ import annotations

import re
from contextlib import ExitStack, contextmanager
from io import BytesIO
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
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

from posor.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator
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
MAY_BE_CHUNK = re.compile(rb"(?s)(?=\x06.{5}\x00{3})")  # where a chunk of less than 2^40 bytes may begin


class Record(NamedTuple):
    """A record: its type, and its content without the head."""

    opcode: int
    content: bytes


class Damage(NamedTuple):
    """A damaged place of a file."""

    offset: int  # where it begins [bytes]
    size: int  # up to the next whole chunk, or to the end of the data [bytes]
    what: str  # what is wrong, a clause


NOT_MCAP = Damage(0, len(MAGIC), "the file does not begin as MCAP files do")


class _DamagedError(Exception):
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


def checked_index(path: Path) -> list[McapRecord]:
    """Return the records of the index of a file; an empty list if the file has none.

    Raises BagError: the file is not MCAP, its index is damaged, or it cannot be read.
    """
    with mapped(path) as data:
        index = read_index(data) if data[: len(MAGIC)] == MAGIC else NOT_MCAP
    if isinstance(index, Damage):
        raise damage_error(path, index)
    return index


def first_damage(path: Path) -> Damage | None:
    """Return the first damaged place of a file; None: the file is whole. Raises BagError: the file cannot be read."""
    with mapped(path) as data:
        index = read_index(data)
        return next((piece for piece in read_records(data) if isinstance(piece, Damage)), None) or (
            index if isinstance(index, Damage) else None
        )


def damage_error(path: Path, damage: Damage) -> BagError:
    """Return the error that names a damaged place."""
    return BagError(damage.what, where=f"{path}, byte {damage.offset}", expected=ADVICE)


def read_index(data: mmap | bytes) -> list[McapRecord] | Damage:
    """Return the records of the index at the end of a file, or how it is damaged."""
    index = _index_begin(data)
    if isinstance(index, Damage):
        return index
    try:
        return list(StreamReader(BytesIO(data[index.offset :]), skip_magic=True).records)[:-1]  # without the footer
    except (McapError, ValueError, OverflowError, StructError):
        return Damage(index.offset, len(data) - index.offset, "the index holds an invalid record")


def read_records(data: mmap | bytes) -> Iterator[list[Record] | Damage]:
    """Yield the records of messages, schemas and channels of every whole chunk, and what is damaged, in order.

    After a damaged record, reading resumes at the next intact chunk.
    """
    index = _index_begin(data)
    position, end = _after_header(data), len(data)
    if not isinstance(index, Damage) and index.checked:
        end = index.offset
    if data[: len(MAGIC)] != MAGIC:
        yield NOT_MCAP
    while position < end:
        try:
            opcode, records, after = _read_record(data, position)
        except _DamagedError as error:
            after = _find_chunk(data, position + 1, end)
            yield Damage(position, after - position, str(error))
        else:
            if opcode == Opcode.DATA_END:
                return
            if records:
                yield records
        position = after
    if isinstance(index, Damage):
        yield index


class _IndexBegin(NamedTuple):
    """Where the index begins, and whether its checksum shows that this is true."""

    offset: int
    checked: bool


def _index_begin(data: mmap | bytes) -> _IndexBegin | Damage:
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


def _after_header(data: mmap | bytes) -> int:
    """Return the offset after the header record; after the magic bytes if there is no whole header."""
    begin = len(MAGIC)
    if len(data) < begin + RECORD_HEAD.size:
        return begin
    opcode, length = RECORD_HEAD.unpack_from(data, begin)
    after = begin + RECORD_HEAD.size + length
    return int(after) if opcode == Opcode.HEADER and after <= len(data) else begin


def _read_record(data: mmap | bytes, position: int) -> tuple[int, list[Record], int]:
    """Return type, records of messages, and end of the record at an offset."""
    content = position + RECORD_HEAD.size
    if content > len(data):
        raise _DamagedError("the file is cut short within a record")
    opcode, length = RECORD_HEAD.unpack_from(data, position)
    after = content + length
    if opcode not in OF_DATA:
        raise _DamagedError(f"there is no record, but a byte 0x{opcode:02x}")
    if after > len(data):
        raise _DamagedError(f"the file is cut short within a record of {length} bytes, or its length is damaged")
    records: list[Record] = []
    if opcode == Opcode.CHUNK:
        try:
            records = list(records_of(chunk_records(data[content:after])))
        except Exception as error:  # each compression raises errors of its own
            what = " ".join(str(error).split()).rstrip(".").lower()
            raise _DamagedError(f"a chunk is damaged: {what}") from error
    elif opcode in OF_MESSAGES:
        records = [Record(opcode, data[content:after])]
    elif opcode == Opcode.DATA_END and length != 4:  # noqa: PLR2004  its checksum
        raise _DamagedError(f"the end of the data has {length} bytes")
    elif opcode == Opcode.MESSAGE_INDEX:
        _, _, _, size = INDEX_HEAD.unpack_from(data, position) if length >= 6 else (0, 0, 0, -1)  # noqa: PLR2004
        if position + INDEX_HEAD.size + size != after or size % INDEX_ENTRY_SIZE:
            raise _DamagedError("the sizes in an index record contradict one another")
    return opcode, records, after


def chunk_records(content: bytes) -> bytes:
    """Return the records of a chunk, decompressed; ``content``: the chunk's record without its head.

    Raises ValueError: the compression is unknown, or sizes or the checksum differ from those that the chunk states;
    McapError, RuntimeError, zstandard.ZstdError: the content is damaged.
    """
    stream = ReadDataStream(BytesIO(content))
    chunk = Chunk.read(stream)
    if stream.count != len(content):
        raise ValueError("its sizes contradict one another")
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


def _find_chunk(data: mmap | bytes, begin: int, end: int) -> int:
    """Return the offset of the next whole chunk between two offsets; ``end`` without any."""
    for candidate in MAY_BE_CHUNK.finditer(data, begin, end):
        try:
            _read_record(data, candidate.start())
        except _DamagedError:
            continue
        return candidate.start()
    return end
