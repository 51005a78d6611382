# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What is whole in an MCAP file that may be damaged: its records in order, and the damaged places between them."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import TYPE_CHECKING

from mcap.opcode import Opcode
from mcap.records import ChunkIndex

from posor.bags.mcap_file import (
    MAGIC,
    MESSAGE,
    NOT_MCAP,
    OF_MESSAGES,
    Damage,
    DamagedError,
    Definitions,
    after_header,
    check_place,
    index_begin,
    read_head,
    read_index,
    read_record,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator
    from mmap import mmap

    from mcap.records import McapRecord

    from posor.bags.mcap_file import Record

OF_SUMMARY = {0x02, 0x03, 0x04, 0x08, 0x0A, 0x0B, 0x0D, 0x0E}
"""Records after the end of the data."""
MAY_BE_CHUNK = re.compile(rb"(?s)(?=\x06.{5}\x00{3})")  # where a chunk of less than 2^40 bytes may begin
MAY_BE_MESSAGE = re.compile(rb"(?s)(?=\x05.{5}\x00{3})")
HEADS = 4  # number of successive heads of records that arbitrary bytes do not resemble


def read_records(data: mmap | bytes) -> Iterator[list[Record] | Damage]:
    """Yield the records of every whole chunk, every whole record outside of chunks, and what is damaged, in order.

    After a damaged record, reading resumes at the next intact chunk; in a file with messages outside of chunks, at the
    next message, if that comes first.
    Message indices are left out; records of unknown types are not.
    """
    index, records = index_begin(data), read_index(data)
    position = after_header(data)
    listed = [] if isinstance(records, Damage) else records
    is_checked = not isinstance(index, Damage) and index.checked
    end = index.offset if is_checked else len(data)
    search = _Search(data, end, listed, is_checked=is_checked)
    if data[: len(MAGIC)] != MAGIC:
        yield NOT_MCAP
    while position < end:
        try:
            opcode, found, after = search.read_record(position)
        except DamagedError as error:
            after = search.find_next(position)
            yield Damage(position, after - position, str(error))
        else:
            if opcode == Opcode.DATA_END:
                appended = data.find(2 * MAGIC, after) + len(MAGIC)
                if appended > after:
                    what = "another MCAP file begins here, to be cut off to a file of its own"
                    yield Damage(appended, len(data) - appended, what)
                return
            if found:
                yield found
        position = after
    if isinstance(index, Damage):
        yield index


class _Search:
    """Reads the data of a file that may be damaged."""

    def __init__(
        self, data: mmap | bytes, end: int, index: Collection[McapRecord], *, is_checked: bool = False
    ) -> None:
        self._data, self._end, self._is_checked = data, end, is_checked
        self._listed = {each.chunk_start_offset: each for each in index if isinstance(each, ChunkIndex)}
        self._definitions = Definitions(index)
        self._has_chunks, self._has_messages = bool(self._listed), False  # messages outside of chunks
        self._may_have_chunks = True

    def read_record(self, position: int) -> tuple[int, list[Record], int]:
        """Return type, content and end of the record at an offset."""
        opcode, found, after = read_record(self._data, position)
        if position in self._listed and opcode != Opcode.CHUNK:
            raise DamagedError(f"a chunk is damaged: its type is 0x{opcode:02x}")
        is_last = after == self._end or self._data[after] in OF_SUMMARY
        check_place(opcode, has_chunks=self._has_chunks, is_last=is_last)
        self._has_chunks |= opcode == Opcode.CHUNK
        self._has_messages |= opcode == Opcode.MESSAGE
        if opcode in OF_MESSAGES and not self._is_followed(after) and self._find_message(position + 1, after) < after:
            raise DamagedError("the length of a record is damaged")
        self._add_definitions(found, is_chunk=opcode == Opcode.CHUNK)
        if self._is_checked and position in self._listed:
            after += self._listed[position].message_index_length
        return opcode, found, after

    def _add_definitions(self, records: Iterable[Record], *, is_chunk: bool) -> None:
        """Add the definitions among some records; in a chunk, invalid ones are left out."""
        for each in records:
            if each.opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                try:
                    self._definitions.add(each)
                except ValueError as error:
                    if not is_chunk:
                        raise DamagedError(f"a definition is damaged: {error}") from error

    def find_next(self, position: int) -> int:
        """Return the offset where reading resumes after a damaged record."""
        chunk = _find_chunk(self._data, position + 1, self._end) if self._may_have_chunks else self._end
        self._may_have_chunks = chunk < self._end
        may_be_chunk = self._has_chunks or not self._has_messages
        is_chunk = position in self._listed or (self._data[position] == Opcode.CHUNK and may_be_chunk)
        is_in_chunks = not self._has_messages and (self._has_chunks or self._may_have_chunks)
        return chunk if is_chunk or is_in_chunks else self._find_message(position + 1, chunk)

    def _find_message(self, begin: int, end: int) -> int:
        """Return the offset of the next whole message of a known channel between two offsets; ``end`` without any."""
        for candidate in MAY_BE_MESSAGE.finditer(self._data, begin, end):
            position = candidate.start()
            with suppress(DamagedError):
                _, after = read_head(self._data, position, self._end)
                _, channel, _, _ = MESSAGE.unpack_from(self._data, position + 1)
                if self._definitions.has_channel(channel) and self._is_followed(after):
                    return position
        return end

    def _is_followed(self, position: int) -> bool:
        """Return whether the heads of the next records are sane."""
        with suppress(DamagedError):
            for _ in range(HEADS):
                if position == self._end:
                    return True
                opcode, position = read_head(self._data, position, self._end)
                if opcode == Opcode.DATA_END:
                    return True
            return True
        return False


def _find_chunk(data: mmap | bytes, begin: int, end: int) -> int:
    """Return the offset of the next whole chunk between two offsets; ``end`` without any."""
    for candidate in MAY_BE_CHUNK.finditer(data, begin, end):
        try:
            read_record(data, candidate.start())
        except DamagedError:
            continue
        return candidate.start()
    return end
