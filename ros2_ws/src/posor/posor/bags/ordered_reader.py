# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reads all files of a bag in the order of time; see ``read_order.py`` for the order of scans.

metadata.yaml only says which files belong to the bag, and what these do not state themselves. No file is changed. A
file that is compressed with zstd, or whose last transactions are in SQLite's ``-wal`` or ``-journal``, is read from a
copy in a temporary folder, in which SQLite completes or takes back the transactions.
"""

from __future__ import annotations

import shutil
from collections import Counter
from contextlib import ExitStack
from heapq import merge
from itertools import islice
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import TYPE_CHECKING, Self

import numpy as np
import zstandard

from posor.bags.chunk_reader import ChunkReader
from posor.bags.mcap_storage import McapFile
from posor.bags.message_block import MessageBlock
from posor.bags.recorded_topics import EXPECTED, METADATA, BagMetadata, Unread
from posor.bags.sqlite_storage import WAL_HEAD, SqliteFile
from posor.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Collection, Generator, Iterator, Sequence

    from rosbags.interfaces import Connection

    from posor.bags.stored_file import StoredFile
    from posor.numerics.array_types import IntArray

    Messages = Iterator[tuple[Connection, int, bytes]]

KINDS: dict[str, type[McapFile | SqliteFile]] = {".mcap": McapFile, ".db3": SqliteFile}
ZSTD, ZSTD_MAGIC = ".zstd", b"\x28\xb5\x2f\xfd"
WAL_MODE_AT, WAL_MODE = 18, b"\x02"  # byte of an SQLite file that states that it is written through a log
JOURNAL_MAGIC = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"  # of a journal that has to be rolled back
BLOCK_MESSAGES = 16_384  # messages that are read at a time from SQLite
COPY_BYTES = 1 << 20


class OrderedReader:
    """A bag whose files and messages are read in the order of their log times.

    Attributes:
        path: The bag: a folder or a file.
        unread: What is left out: messages of another encoding, by topic.

    """

    def __init__(self, path: Path) -> None:
        """Open the files. Raises BagError: metadata.yaml is invalid, or a file is missing, damaged or of no bag."""
        self.path = path
        self.metadata = BagMetadata.load(path) if path.is_dir() else BagMetadata(files=[path.name])
        self._side_notes: list[str] = []
        with ExitStack() as stack:
            opened = [self._open_file(each, stack) for each in self._files()]
            if len({type(each) for each in opened}) > 1:
                raise BagError("holds both MCAP and SQLite files", where=str(path), expected="files of one kind")
            self._close = stack.pop_all().close
        self._listed = {each.path for each in opened}
        filled = [each for each in opened if each.start_ns <= each.end_ns]
        self._opened = sorted(filled, key=lambda each: each.start_ns)
        unread = Counter[tuple[str, str]]()
        for topic, why, messages in (each for file in opened for each in file.unread):
            unread[topic, why] += messages
        self.unread = [Unread(topic, why, messages) for (topic, why), messages in unread.items()]
        self.connections = list(self._connections(opened))

    @property
    def files(self) -> list[Path]:
        """The files with messages, by the log time of their first message."""
        return [each.path for each in self._opened]

    @property
    def message_count(self) -> int:
        """Number of messages that can be read."""
        return sum(connection.msgcount for connection in self.connections)

    @property
    def start_time(self) -> int:
        """First log time of the bag [ns]."""
        return min((each.start_ns for each in self._opened), default=0)

    @property
    def end_time(self) -> int:
        """Time after the last log time of the bag [ns]."""
        return max((each.end_ns for each in self._opened), default=-1) + 1

    def notes(self) -> list[str]:
        """Return what differs between the bag and what is read of it, one sentence each."""
        found = dict.fromkeys(self.metadata.counts, 0)
        for each in self.connections:
            found[each.topic] = found.get(each.topic, 0) + each.msgcount
        for topic, _, messages in self.unread:
            found[topic] = found.get(topic, 0) + messages
        left_out = [f"topic {topic} is left out: {messages} messages {why}" for topic, why, messages in self.unread]
        missing = [
            f"{METADATA} states {count} messages of {topic}; the files hold {found[topic]}"
            for topic, count in self.metadata.counts.items()
            if found[topic] < count
        ]
        return self._side_notes + left_out + missing

    def check_files(self, files: Sequence[Path]) -> None:
        """Raise a BagError if one of the ``files`` of the bag is not listed, or if one of several has no log times."""
        stored = {stored_name(each) for each in self._listed}
        if unlisted := [file.name for file in files if stored_name(file) not in stored]:
            listed = ", ".join(sorted(each.name for each in self._listed))
            what = f"metadata.yaml does not list {unlisted[0]}, but {listed}"
            raise BagError(what, where=str(self.path), expected="all files of the folder, as 'ros2 bag reindex' does")
        if len(self._opened) > 1 and self._opened[0].start_ns <= 0:
            first, second, *_ = self.files
            what = f"messages of {first.name} have no log time, so that they are neither before nor after {second.name}"
            raise BagError(what, where=str(self.path), expected="files with log times")

    def read_blocks(
        self, topics: Sequence[str], where: str, start: int | None = None, stop: int | None = None
    ) -> Iterator[MessageBlock]:
        """Yield the messages of topics by log time [ns], from ``start`` to before ``stop``; None: without this limit.

        A block numbers the topics as they are given. ``where``: name of the bag in errors. Raises BagError: a file is
        damaged, or chunks overlap so much that too many messages wait.
        """
        return self._read_files(self._opened, topics, where, start, stop)

    def messages(
        self, connections: Collection[Connection] = (), start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield the messages of topics (none: of all) one by one; see ``read_blocks``."""
        yield from self._messages(self._opened, connections or self.connections, start, stop)

    def by_file(
        self, connections: Sequence[Connection], start: int | None, stop: int | None
    ) -> Iterator[tuple[Path, Messages]]:
        """Yield each file with its messages, see ``messages``."""
        for file in self._opened:
            yield file.path, self._messages([file], connections, start, stop)

    def close(self) -> None:
        """Close the files and remove the copies."""
        self._close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def _messages(
        self, files: Sequence[StoredFile], connections: Collection[Connection], start: int | None, stop: int | None
    ) -> Messages:
        by_topic = {each.topic: each for each in connections}
        topics = list(by_topic)
        for block in self._read_files(files, topics, str(self.path), start, stop):
            columns = (block.topics, block.times_ns, block.starts, block.lengths)
            for number, time_ns, begin, length in zip(*(each.tolist() for each in columns), strict=True):
                yield by_topic[topics[number]], time_ns, block.data[begin : begin + length].tobytes()

    def _read_files(
        self, files: Sequence[StoredFile], topics: Sequence[str], where: str, start: int | None, stop: int | None
    ) -> Iterator[MessageBlock]:
        of_mcap = [each for each in files if isinstance(each, McapFile)]
        of_sqlite = [each for each in files if isinstance(each, SqliteFile)]
        blocks = ChunkReader(of_mcap, topics, where, start, stop).read_blocks()
        for block in blocks if of_mcap else _read_rows(of_sqlite, topics, start, stop):
            yield _decompressed(block, where)

    def _files(self) -> Iterator[Path]:
        """Yield the files of the bag, also those that were compressed or decompressed by hand since."""
        folder = self.path if self.path.is_dir() else self.path.parent
        for name in self.metadata.files:
            possible = [folder / each for each in (name, name.removesuffix(ZSTD), f"{name}{ZSTD}")]
            found = next((each for each in possible if each.is_file()), None)
            if found is None:
                expected = f"all files that {METADATA} lists, or a list of those that are there, by 'ros2 bag reindex'"
                raise BagError(f"{name} is missing", where=str(self.path), expected=expected)
            yield found

    def _open_file(self, path: Path, stack: ExitStack) -> StoredFile:
        """Open a file, or its copy; the stack closes the file and removes the copy."""
        storage, name, beside = path, stored_name(path), _side_files(path)
        kind = KINDS.get(Path(name).suffix)
        if kind is None:
            raise BagError(f"is no file that ends in {' or '.join(KINDS)}", where=str(path), expected=EXPECTED)
        if kind is SqliteFile and not beside:
            _refuse_log_of_other_name(path)
        if beside or _begins_with(path, ZSTD_MAGIC):
            repair = f"'sqlite3 {name} \"PRAGMA wal_checkpoint(TRUNCATE)\" .tables'"
            self._side_notes += [
                f"{each.name} holds transactions that {name} lacks, so a copy of both is read; {repair} completes it"
                for each in beside
            ]
            try:
                storage = Path(stack.enter_context(TemporaryDirectory(prefix="posor-bag-"))) / name
                before = _state([path, *beside])
                _copy(path, storage)
                for each in beside:
                    shutil.copyfile(each, storage.with_name(f"{name}-{each.name.rpartition('-')[2]}"))
                if _state([path, *beside]) != before:
                    raise BagError("the file is being written", where=str(path), expected="a bag that was closed")
            except OSError as error:
                what = f"{beside[0].name if beside else 'the decompressed file'} cannot be copied, {error.strerror}"
                expected = f"space in {gettempdir()}{f', or a file that {repair} has completed' if beside else ''}"
                raise BagError(what, where=str(path), expected=expected) from error
        file = kind(path, storage, self.metadata)
        stack.callback(file.close)
        self._side_notes += file.notes
        return file

    def _connections(self, files: Sequence[StoredFile]) -> Iterator[Connection]:
        """Yield the topics of all files, each with the number of its messages in all of them."""
        same: dict[tuple[object, ...], list[Connection]] = {}
        for each in (each for file in files for each in file.connections):
            same.setdefault((each.topic, each.msgtype, each.msgdef, each.digest), []).append(each)
        for number, group in enumerate(same.values(), start=1):
            yield group[0]._replace(id=number, msgcount=sum(each.msgcount for each in group))


def stored_name(path: Path) -> str:
    """Return the name of a file of a bag once it is decompressed."""
    return path.name.removesuffix(ZSTD)


def _begins_with(path: Path, magic: bytes) -> bool:
    with path.open("rb") as file:
        return file.read(len(magic)) == magic


def _side_files(path: Path) -> list[Path]:
    """Return the files beside an SQLite file that hold transactions which are not finished there.

    Of a link, they are beside it, or else beside the file that it leads to, where SQLite writes them.
    """
    for place in (path, path.resolve()):
        wal, journal = (place.with_name(f"{place.name}-{each}") for each in ("wal", "journal"))
        found = [wal] if wal.is_file() and wal.stat().st_size > WAL_HEAD else []
        found += [journal] if journal.is_file() and _begins_with(journal, JOURNAL_MAGIC) else []
        if found:
            return found
    return []


def _refuse_log_of_other_name(path: Path) -> None:
    """Refuse an SQLite file with a write-ahead log if a log is there whose file is not: one of them was renamed."""
    with path.open("rb") as file:
        head = file.read(WAL_MODE_AT + 1)
    if head[WAL_MODE_AT:] != WAL_MODE:
        return
    for each in sorted(path.parent.glob("*-wal")):
        if each.stat().st_size > WAL_HEAD and not each.with_name(each.name.removesuffix("-wal")).exists():
            expected = f"{path.name}-wal if it holds transactions of {path.name}, or the log elsewhere"
            raise BagError(f"{each.name} belongs to no file beside it", where=str(path), expected=expected)


def _state(files: Sequence[Path]) -> list[tuple[int, int]]:
    """Return sizes and times of change of files."""
    return [(state.st_size, state.st_mtime_ns) for state in map(Path.stat, files)]


def _copy(path: Path, target: Path) -> None:
    """Copy a file; if it is compressed with zstd, decompress it. Raises BagError: the compressed file is damaged."""
    if not _begins_with(path, ZSTD_MAGIC):
        shutil.copyfile(path, target)
        return
    decompressor = zstandard.ZstdDecompressor()
    frame = decompressor.decompressobj()
    try:
        with path.open("rb") as source, target.open("wb") as file:
            while data := source.read(COPY_BYTES):
                while data:
                    if frame.eof:
                        frame = decompressor.decompressobj()
                    file.write(frame.decompress(data))
                    data = frame.unused_data
    except zstandard.ZstdError as error:
        what = f"the file is damaged, {error}"
        raise BagError(what, where=str(path), expected="a whole file, compressed with zstd") from error
    if not frame.eof:
        raise BagError("the file is cut short", where=str(path), expected="a whole file, compressed with zstd")


def _decompressed(block: MessageBlock, where: str) -> MessageBlock:
    """Return the messages of a block decompressed, which begin with the magic number of zstd, unlike CDR."""
    filled = block.starts[block.lengths >= len(ZSTD_MAGIC)]
    if not np.any(block.data[filled] == ZSTD_MAGIC[0]):
        return block
    messages = []
    columns = (block.times_ns, block.starts, block.lengths)
    for time_ns, start, length in zip(*(each.tolist() for each in columns), strict=True):
        data = block.data[start : start + length].tobytes()
        if data.startswith(ZSTD_MAGIC):
            frame = zstandard.ZstdDecompressor().decompressobj()
            try:
                data = frame.decompress(data)
                whole = frame.eof
            except zstandard.ZstdError:
                whole = False
            if not whole:
                what = f"the message logged at {time_ns} ns cannot be decompressed"
                raise BagError(what, where=where, expected="a message compressed with zstd")
        messages.append(data)
    return _block_of(block.topics, block.times_ns, messages)


def _block_of(topics: IntArray, times_ns: IntArray, messages: Sequence[bytes]) -> MessageBlock:
    lengths = np.array([len(data) for data in messages], dtype=np.int64)
    data = np.frombuffer(b"".join(messages), dtype=np.uint8)
    return MessageBlock(data, topics, times_ns, np.cumsum(lengths) - lengths, lengths)


def _read_rows(
    files: Sequence[SqliteFile], topics: Sequence[str], start: int | None, stop: int | None
) -> Iterator[MessageBlock]:
    """Yield the messages of topics of SQLite files; files that overlap in log time are merged."""
    numbers = {topic: number for number, topic in enumerate(topics)}
    groups, end_ns = list[list[SqliteFile]](), -1
    for file in files:
        if file.start_ns > end_ns:
            groups.append([])
        groups[-1].append(file)
        end_ns = max(end_ns, file.end_ns)
    for group in groups:
        parts = [
            file.messages([each for each in file.connections if each.topic in numbers], start, stop) for file in group
        ]
        rows = merge(*parts, key=itemgetter(1))
        while some := list(islice(rows, BLOCK_MESSAGES)):
            yield _block_of(
                np.fromiter((numbers[each.topic] for each, _, _ in some), np.int64, len(some)),
                np.fromiter((time_ns for _, time_ns, _ in some), np.int64, len(some)),
                [data for _, _, data in some],
            )
