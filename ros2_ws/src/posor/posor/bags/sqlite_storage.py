# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A closed SQLite file of any version of rosbag2."""

from __future__ import annotations

import sqlite3
import struct
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Any

from posor.bags.recorded_topics import EXPECTED, StoredTopic, Unread
from posor.bags.stored_file import StoredFile
from posor.errors import BagError, clause_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping
    from pathlib import Path

    from rosbags.interfaces import Connection

    from posor.bags.recorded_topics import BagMetadata

MAGIC = b"SQLite format 3\0"
EXPECTED_LOG = "the one that was written with the file"
WAL_MAGIC = (b"\x37\x7f\x06\x82", b"\x37\x7f\x06\x83")
WAL_HEAD, WAL_FRAME_HEAD = 32, 24  # bytes before the first page, and before each page
WAL_SALTS, WAL_SALTS_OF_FRAME = slice(16, 24), slice(8, 16)
LAST_OF_HEAD = struct.Struct(">H10xI")  # after the magic bytes: size of a page, ..., number of pages


class SqliteFile(StoredFile):
    """An SQLite file; columns that an older version of rosbag2 does not have are empty."""

    def __init__(self, path: Path, storage: Path, metadata: BagMetadata) -> None:
        """Read the topics.

        ``storage``: the file to read; another one than ``path`` if that is compressed or has unfinished transactions.
        Raises BagError: the file is damaged, or no bag.
        """
        super().__init__(path)
        is_copy = storage != path
        log = storage.with_name(f"{storage.name}-wal")
        if not is_copy:
            _check_size(path)
        frames = _frames_of(log, path) if is_copy and log.is_file() else 0
        without_log = _count_without_log(storage) if frames else 0
        with self._errors():
            self._database = sqlite3.connect(
                f"{storage.absolute().as_uri()}{'' if is_copy else '?immutable=1'}", uri=True, check_same_thread=False
            )
            if frames and frames > self._database.execute("PRAGMA wal_checkpoint").fetchone()[1]:
                self.notes.append(f"{log.name} ends within a transaction, which is left out")
            tables = {name for (name,) in self._database.execute("SELECT name FROM sqlite_master")}
            if missing := [name for name in ("topics", "messages") if name not in tables]:
                raise BagError(f"has no table {missing[0]}", where=str(path), expected=EXPECTED)
            topics = self._rows("topics")
            definitions = self._rows("message_definitions") if "message_definitions" in tables else []
            no_message = "typeof(timestamp) != 'integer' OR timestamp < 0 OR typeof(data) != 'blob'"
            extents = (
                "SELECT topic_id, count(*), min(timestamp), max(timestamp), "  # noqa: S608  own text
                f"min(CASE WHEN {no_message} THEN rowid END) FROM messages GROUP BY topic_id"
            )
            counts = dict[int, int]()
            for number, count, start_ns, end_ns, invalid in self._database.execute(extents):
                if invalid is not None:
                    what, expected = (
                        f"row {invalid} of the table messages is no message",
                        "a time of whole ns, and bytes",
                    )
                    raise BagError(what, where=str(path), expected=expected)
                counts[number] = count
                self.start_ns, self.end_ns = min(self.start_ns, start_ns), max(self.end_ns, end_ns)
        if (count := sum(counts.values())) < without_log:  # a recorder only adds
            what = f"the log leaves {count} of the {without_log} messages of {path.name}"
            raise BagError(what, where=f"{path}-wal", expected=EXPECTED_LOG)
        for topic in topics:
            self._add_topic(_topic_of(topic, definitions), counts.pop(topic["id"], 0), metadata)
        for number, count in counts.items():
            self.unread.append(Unread(f"of number {number}", "of no topic in the table of topics", count))

    def messages(
        self, connections: Collection[Connection], start: int | None, stop: int | None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield the messages of topics by log time [ns], from ``start`` to before ``stop``; None: without this limit.

        Raises BagError: the file is damaged.
        """
        by_number = {each.id: each for each in connections}
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({','.join('?' * len(by_number))})"  # noqa: S608  placeholders only
        limits = [(sign, limit) for sign, limit in ((">=", start), ("<", stop)) if limit is not None]
        query += "".join(f" AND timestamp {sign} ?" for sign, _ in limits)
        with self._errors(), closing(self._database.cursor()) as cursor:
            values = [*by_number, *(limit for _, limit in limits)]
            for number, time_ns, data in cursor.execute(f"{query} ORDER BY timestamp, rowid", values):
                yield by_number[number], time_ns, data

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def _rows(self, table: str) -> list[dict[str, Any]]:
        """Return the rows of a table by column."""
        with closing(self._database.execute(f"SELECT * FROM {table}")) as cursor:  # noqa: S608  own names
            names = [column for column, *_ in cursor.description]
            return [dict(zip(names, row, strict=True)) for row in cursor]

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Turn errors of SQLite into a BagError that names the file."""
        try:
            yield
        except (sqlite3.Error, KeyError, TypeError) as error:
            what = f"cannot be read, {clause_of(error)}"
            raise BagError(what, where=str(self.path), expected=_advice(self.path)) from error


def _topic_of(row: Mapping[str, Any], definitions: Collection[Mapping[str, Any]]) -> StoredTopic:
    """Return a topic with its definition, that of the same type hash if there are several."""
    type_hash = row.get("type_description_hash") or ""
    of_type = [each for each in definitions if each["topic_type"] == row["type"]]
    same = [each for each in of_type if each.get("type_description_hash") == type_hash]
    found = next(iter(same or of_type), {"encoding": "", "encoded_message_definition": ""})
    return StoredTopic(
        row["id"],
        row["name"],
        row["type"],
        row["serialization_format"],
        found["encoding"],
        str(found["encoded_message_definition"]).encode(),
        type_hash,
        row.get("offered_qos_profiles") or "",
    )


def _frames_of(log: Path, path: Path) -> int:
    """Return the number of pages in a write-ahead log, with a page that is cut short (https://sqlite.org/walformat.html).

    After the last one, the log may hold pages of former transactions, which have other salts. Raises BagError: the log
    of the file is not one.
    """
    with log.open("rb") as file:
        size, head, count = log.stat().st_size, file.read(WAL_HEAD), 0
        if len(head) < WAL_HEAD or head[:4] not in WAL_MAGIC:
            raise BagError("is not a write-ahead log of SQLite", where=f"{path}-wal", expected=EXPECTED_LOG)
        page_size = int.from_bytes(head[8:12])
        while (begin := WAL_HEAD + count * (WAL_FRAME_HEAD + page_size)) + WAL_FRAME_HEAD <= size:
            file.seek(begin)
            if file.read(WAL_FRAME_HEAD)[WAL_SALTS_OF_FRAME] != head[WAL_SALTS]:
                break
            count += 1
    return count


def _count_without_log(storage: Path) -> int:
    """Return the number of messages of a file without its write-ahead log; 0 where it cannot be read without."""
    try:
        with closing(sqlite3.connect(f"{storage.absolute().as_uri()}?immutable=1", uri=True)) as database:
            return int(database.execute("SELECT count(*) FROM messages").fetchone()[0])
    except sqlite3.Error:
        return 0


def _check_size(path: Path) -> None:
    """Refuse a truncated file; SQLite itself notices only when it reads beyond the end."""
    with path.open("rb") as file:
        head = file.read(len(MAGIC) + LAST_OF_HEAD.size)
    if len(head) == len(MAGIC) + LAST_OF_HEAD.size and head.startswith(MAGIC):
        page_size, pages = LAST_OF_HEAD.unpack(head[len(MAGIC) :])
        if path.stat().st_size < (page_size if page_size > 1 else 65536) * pages:
            raise BagError("the file is cut short", where=str(path), expected=_advice(path))


def _advice(path: Path) -> str:
    return f"{EXPECTED}; 'sqlite3 {path.name} .recover' writes what is whole"
