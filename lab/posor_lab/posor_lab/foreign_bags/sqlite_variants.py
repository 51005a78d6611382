# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""SQLite files of every version of rosbag2, closed or as a killed recorder leaves them."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from posor_lab.foreign_bags.mcap_variants import happens

if TYPE_CHECKING:
    from collections.abc import Sequence
    from random import Random

    from posor_lab.foreign_bags.mcap_variants import GivenMessage, GivenTopic

COLUMNS = {  # of the table of topics, by version of the tables: Dashing, Foxy, Iron, Jazzy
    1: "name, type, serialization_format",
    2: "name, type, serialization_format, offered_qos_profiles",
    3: "name, type, serialization_format, offered_qos_profiles",
    4: "name, type, serialization_format, offered_qos_profiles, type_description_hash",
}
WITH_SCHEMA = 3  # first version that states its number
STATES = ("closed", "closed", "empty side files", "wal", "wal with shm", "hot journal")


def write_sqlite(
    path: Path, messages: Sequence[GivenMessage], topics: Sequence[GivenTopic], qos: str, chance: Random
) -> str:
    """Write a file with these messages, and return its state: one of ``STATES``."""
    state = chance.choice(STATES)
    with TemporaryDirectory() as folder:
        made = Path(folder) / path.name
        with closing(sqlite3.connect(made, isolation_level=None)) as database:
            _write(database, messages, topics, qos, state, chance)
            suffixes = [""] if state.startswith("closed") else ["", "-wal", "-journal"]
            for suffix in [*suffixes, *(["-shm"] if state == "wal with shm" else [])]:
                if (file := made.with_name(made.name + suffix)).exists():
                    shutil.copyfile(file, path.with_name(path.name + suffix))
    if state == "empty side files":
        for suffix in ("-wal", "-journal"):
            path.with_name(path.name + suffix).touch()
    return state


def _write(
    database: sqlite3.Connection,
    messages: Sequence[GivenMessage],
    topics: Sequence[GivenTopic],
    qos: str,
    state: str,
    chance: Random,
) -> None:
    version = chance.choice(list(COLUMNS))
    database.execute("PRAGMA page_size = 512")
    _create_tables(database, version, indexed=happens(chance, 0.8))
    for number, topic in enumerate(topics, start=1):
        marks = ",".join("?" * (1 + len(COLUMNS[version].split(","))))
        values = (number, topic.name, topic.type_name, topic.encoding, qos, "")[: marks.count("?")]
        database.execute(f"INSERT INTO topics (id, {COLUMNS[version]}) VALUES ({marks})", values)  # noqa: S608  own names
        if version == max(COLUMNS):
            definition = (topic.type_name, topic.definition_encoding, topic.definition.decode(), "")
            database.execute("INSERT INTO message_definitions VALUES (NULL, ?, ?, ?, ?)", definition)
    if state.startswith("wal"):
        database.execute("PRAGMA journal_mode = wal")
        database.execute("PRAGMA wal_autocheckpoint = 0")
    numbers = {topic: number for number, topic in enumerate(topics, start=1)}
    rows = [(numbers[message.topic], message.time_ns, message.data) for message in messages]
    written = chance.randrange(len(rows) + 1)
    for part in (rows[:written], rows[written:]):
        database.execute("BEGIN")
        database.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", part)
        database.execute("COMMIT")
        if state.startswith("wal") and part is not rows[written:] and happens(chance, 0.5):
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
    if state == "hot journal":
        database.execute("PRAGMA cache_size = 1")
        database.execute("BEGIN")
        database.execute("UPDATE messages SET data = zeroblob(400), timestamp = timestamp + 7")


def _create_tables(database: sqlite3.Connection, version: int, *, indexed: bool) -> None:
    columns = ", ".join(f"{each} TEXT NOT NULL" for each in COLUMNS[version].split(", "))
    database.execute(f"CREATE TABLE topics (id INTEGER PRIMARY KEY, {columns})")
    database.execute(
        "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,"
        " data BLOB NOT NULL)"
    )
    if indexed:
        database.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
    if version >= WITH_SCHEMA:
        database.execute("CREATE TABLE schema (schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL)")
        database.execute("INSERT INTO schema VALUES (?, 'any')", [version])
        database.execute("CREATE TABLE metadata (id INTEGER PRIMARY KEY, metadata_version INTEGER, metadata TEXT)")
    if version == max(COLUMNS):
        database.execute(
            "CREATE TABLE message_definitions (id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT,"
            " encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL)"
        )
