# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Opens rosbag2 bags, MCAP or SQLite, and checks their topics; every error is one sentence that names the bag.

The checksums of MCAP files are checked: that of the index when a bag is opened, that of a chunk when it is read. SQLite
files have none.
"""

from __future__ import annotations

import logging
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from posor.bags.mcap_file import RECOVER
from posor.bags.ordered_reader import OrderedReader, stored_name
from posor.bags.recorded_topics import EXPECTED, METADATA
from posor.errors import BagError, PosorError, clause_of
from posor.messages.message_definitions import schema_of_topic
from posor.messages.raw_scan import check_raw_scan_schema
from posor.ros_names import RAW_SCAN

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from rosbags.interfaces import Connection

    from posor.messages.cdr_schema import Schema
    from posor.messages.message_definitions import MessageTypes

ADVICE = {".mcap": f"it; {RECOVER} with {METADATA}", ".db3": "it, as 'ros2 bag reindex' makes it"}
"""What helps if the metadata are missing, by the suffix of the files."""


@contextmanager
def opened_bag(path: Path, *, log_notes: bool = True) -> Iterator[OrderedReader]:
    """Open a bag; errors of the storage layers, also later ones, become one sentence that names the bag.

    ``log_notes``: whether what is left out is logged as a warning, once in a process. Raises BagError: the bag does not
    exist, cannot be read, holds no messages, or the order of its files is unknown.
    """
    if not path.exists():
        raise BagError("does not exist", where=str(path), expected=EXPECTED)
    if not (path.is_dir() or path.is_file()):
        raise BagError("is neither a folder nor a file", where=str(path), expected=EXPECTED)
    _check_metadata(path)
    try:
        with OrderedReader(path) as reader:
            if log_notes:
                for note in reader.notes():
                    log_once(f"{path}: {note}")
            _check_not_empty(reader, path)
            reader.check_files(storage_files(path, *ADVICE))
            yield reader
    except PosorError:
        raise
    except Exception as error:
        expected = f"{EXPECTED}; {RECOVER}" if storage_files(path, ".mcap") else EXPECTED
        raise BagError(f"the bag cannot be read, {clause_of(error)}", where=str(path), expected=expected) from error


@cache
def log_once(note: str) -> None:
    """Log a sentence about a bag as a warning, unless this process has done so."""
    logging.getLogger(__name__).warning("%s.", note)


def scan_topic(connections: Sequence[Connection], wanted: str, where: str, setting: str) -> str:
    """Return the topic of the scans: the requested one, or the only one of the bag.

    ``wanted``: the requested topic; empty: the only one; ``where``: name of the bag in errors; ``setting``: the option
    that selects a topic, for errors. Raises BagError: the bag has no such topic, or several.
    """
    if wanted:
        return wanted
    names = sorted({connection.topic for connection in connections if connection.msgtype == RAW_SCAN})
    if len(names) == 1:
        return names[0]
    if names:
        what, expected = f"scans are on {len(names)} topics", f"{setting} as one of " + ", ".join(names)
    else:
        what, expected = f"there is no topic of type {RAW_SCAN}", f"one among {_listed(connections)}"
    raise BagError(what, where=where, expected=expected)


def checked_type(
    connections: Sequence[Connection],
    topic: str,
    where: str,
    types: MessageTypes | None,
    allowed: Collection[str] = (),
    *,
    filled: bool = False,
) -> str:
    """Return the type of a recorded topic after checking that all its connections have the same type and version.

    ``where``: name of the bag in errors; ``types``: the installed types, whose version the topic must have; None: any
    version; ``allowed``: types that the topic may have; empty: any; ``filled``: whether it must hold messages. Raises
    BagError: there is no such topic, it has another type or version, or several, or it holds no messages.
    """
    found = [connection for connection in connections if connection.topic == topic]
    if not found:
        raise BagError(f"there is no topic {topic}", where=where, expected=f"one of {_listed(connections)}")
    first, *others = sorted({connection.msgtype for connection in found})
    allowed_types = " or ".join(sorted(allowed))
    if others:
        listed = ", ".join([first, *others])
        raise BagError(
            f"topic {topic} holds messages of several types, {listed}",
            where=where,
            expected=f"only {allowed_types or 'one'}",
        )
    if allowed and first not in allowed:
        raise BagError(f"topic {topic} is of type {first}", where=where, expected=allowed_types)
    recorded = sorted({connection.digest for connection in found if connection.digest})
    if recorded:
        expected = recorded[0] if types is None else types.definition(first).type_hash
        for digest in recorded:
            if digest != expected:
                what = f"topic {topic} was recorded with another version of {first}, {digest}"
                raise BagError(what, where=where, expected=expected)
    if filled and not sum(connection.msgcount for connection in found):
        raise BagError(f"topic {topic} holds no messages", where=where)
    return first


def scan_schema(connections: Sequence[Connection], topic: str, where: str) -> Schema:
    """Return the schema of a topic of raw scans, as its bag defines it.

    Raises BagError: there is no such topic, it is of another type or holds no messages, or its definition is invalid.
    """
    checked_type(connections, topic, where, None, (RAW_SCAN,), filled=True)
    schema = schema_of_topic(connections, topic, where)
    check_raw_scan_schema(schema, f"{where}, topic {topic}")
    return schema


def _listed(connections: Sequence[Connection]) -> str:
    """Return the topics of a bag with their types, for errors."""
    return ", ".join(sorted({f"{connection.topic} ({connection.msgtype})" for connection in connections})) or "none"


def storage_files(path: Path, *suffixes: str) -> list[Path]:
    """Return the files of a bag (a folder or a single file) with one of some suffixes, ``x_2`` before ``x_10``.

    Files that are compressed (``.zstd``) are among them, unless the decompressed file is there, too; hidden files, such
    as the ``._x_2.mcap`` of macOS, are not.
    """
    files = sorted(path.iterdir(), key=lambda file: (len(stored_name(file)), file.name)) if path.is_dir() else [path]
    visible = [file for file in files if file == path or not file.name.startswith(".")]
    own = [file for file in visible if Path(stored_name(file)).suffix in suffixes]
    return [file for file in own if file.name == stored_name(file) or file.with_name(stored_name(file)) not in own]


def _check_metadata(path: Path) -> None:
    if not path.is_dir() or (path / METADATA).exists():
        return
    files = storage_files(path, *ADVICE)
    if not files:
        raise BagError("the folder holds no bag", where=str(path), expected=EXPECTED)
    expected = ADVICE[Path(stored_name(files[0])).suffix] + (
        f"; or name the file '{files[0]}' itself" if len(files) == 1 else ""
    )
    raise BagError(f"{METADATA} is missing in the folder of the bag", where=str(path), expected=expected)


def _check_not_empty(reader: OrderedReader, path: Path) -> None:
    if not reader.message_count:
        unread = ", ".join(sorted(f"{topic} {why}" for topic, why, _ in reader.unread))
        if unread:
            raise BagError(f"holds no messages but of {unread}", where=str(path), expected="messages in CDR")
        raise BagError("holds no messages", where=str(path))
