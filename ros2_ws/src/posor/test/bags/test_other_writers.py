# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags that MCAP and rosbag2 allow but no recorder of this stack writes; their arrangements: ``make foreign-bags``."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zstandard
from mcap.writer import IndexType
from mcap.writer import Writer as McapWriter
from posor.bags.bag_reader import opened_bag, scan_schema
from posor.bags.block_reader import read_messages
from posor.bags.mcap_file import Damage
from posor.bags.recorded_topics import METADATA
from posor.bags.recover_command import recover
from posor.bags.reprocess_command import print_summary
from posor.bags.reprocess_task import Summary
from posor.errors import BagError
from posor.messages.message_definitions import MessageTypes, installed_schema
from posor.ros_names import RAW_SCAN
from posor_lab.harness.full_disk import contents_of
from rich.console import Console
from rosbags.rosbag2 import StoragePlugin

from .bag_files import TOPICS, Record, chunk_indices, damaged, write

ONE = TOPICS[0]
MESSAGES: list[Record] = [(ONE, 1000 + n, n.to_bytes(40, "little")) for n in range(60)]
REPAIR = "'sqlite3 bag.db3 \"PRAGMA wal_checkpoint(TRUNCATE)\" .tables'"
Channel = tuple[str, str, str, bytes]  # topic, encoding of the messages, encoding and text of the schema


def definition(change: Callable[[str], str] = str) -> bytes:
    return change(MessageTypes().definition(RAW_SCAN).text).encode()


CDR: Channel = (ONE, "cdr", "ros2msg", definition())


def mcap(channels: Mapping[Channel, int], *, type_name: str = RAW_SCAN, first_ns: int = 1000, **options: Any) -> bytes:
    """Return a file with some messages of each channel; ``type_name``: of all schemas; empty: there are none."""
    file = BytesIO()
    writer = McapWriter(file, **options)
    writer.start()
    for (topic, encoding, form, text), count in channels.items():
        schema = writer.register_schema(type_name, form, text) if type_name else 0
        channel = writer.register_channel(topic, encoding, schema)
        for n in range(count):
            writer.add_message(channel, first_ns + n, n.to_bytes(40, "little"), 0)
    writer.finish()
    return file.getvalue()


def unindexed(**options: Any) -> dict[str, Any]:
    """Return the options of a file without a summary."""
    parts = ("use_statistics", "repeat_channels", "repeat_schemas", "use_summary_offsets")
    return {"index_types": IndexType.NONE, **dict.fromkeys(parts, False), **options}


def read(bag: Path) -> tuple[list[bytes], list[str]]:
    """Return the messages of a bag's topics, and what is noted."""
    with opened_bag(bag) as reader:
        topics = sorted({each.topic for each in reader.connections})
        return [data for _, _, data in read_messages(reader, topics, "bag")], reader.notes()


def test_topics_of_other_encodings_are_left_out_and_listed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    others: dict[Channel, int] = {
        ("/notes", "json", "jsonschema", b"{}"): 3,
        ("/log", "protobuf", "protobuf", b"\xff\xfe"): 2,
        ("/empty", "json", "jsonschema", b"{}"): 0,
        ("/own", "cdr", "own", b""): 1,
    }
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap({CDR: 5} | others))
    messages, notes = read(path)
    assert len(messages) == 5
    assert notes == [
        "topic /notes is left out: 3 messages encoded as 'json', not 'cdr'",
        "topic /log is left out: 2 messages encoded as 'protobuf', not 'cdr'",
        "topic /own is left out: 1 messages defined in 'own', not as a ROS 2 message",
    ]
    read(path)
    assert [record.getMessage() for record in caplog.records] == [f"{path}: {note}." for note in notes]
    console = Console(file=StringIO(), width=200)
    print_summary(Summary(path, None, {}, None, notes=tuple(notes)), console)
    assert all(f"warning: {note}\n" in console.file.getvalue() for note in notes)  # type: ignore[attr-defined]
    (rescue,) = recover(path, tmp_path / "out")
    assert (rescue.messages, rescue.damages, rescue.stated) == (11, [], 11)
    assert not capsys.readouterr().err


VERSIONS: dict[str, tuple[dict[Channel, int], str]] = {
    "another encoding on the same topic": (
        {CDR: 5, (ONE, "json", "jsonschema", b"{}"): 3},
        "topic /one/raw also holds 3 messages encoded as 'json', not 'cdr'; expected one encoding",
    ),
    "two definitions": (
        {CDR: 5, (ONE, "cdr", "ros2msg", definition(lambda text: "float64 more\n" + text)): 3},
        "topic /one/raw is recorded with several definitions of RawScan whose fields differ; expected one definition",
    ),
    "an invalid definition": (
        {(ONE, "cdr", "ros2msg", b"nonsense " * 1000): 3},
        r"the definition of posor_msgs/msg/RawScan cannot be read, .{1,140}; expected the definition of a message in",
    ),
}


@pytest.mark.parametrize(("channels", "sentence"), VERSIONS.values(), ids=VERSIONS.keys())
def test_a_topic_of_several_kinds_is_refused(channels: dict[Channel, int], sentence: str, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(mcap(channels))
    with pytest.raises(BagError, match=sentence):
        read(tmp_path / "a.mcap")


def idl() -> str:
    """Return the definition of a scan as rosbag2 stores that of a type which is defined in IDL."""
    texts = []
    for name, fields in IDL_FIELDS.items():
        package, _, leaf = name.split("/")
        struct = f"    struct {leaf} {{\n      {' '.join(fields)}\n    }};\n"
        head = f'{"=" * 80}\nIDL: {name}\n#include "any.idl"\n'
        texts.append(f"{head}module {package} {{\n  module msg {{\n{struct}  }};\n}};\n")
    return "\n".join(texts)


def idl_fields() -> Iterator[str]:
    words = {"float64": "double", "uint64": "uint64", "uint32": "uint32", "uint16": "uint16", "uint8": "uint8"}
    for line in MessageTypes().definition(RAW_SCAN).text.partition("=" * 80)[0].splitlines():
        kind, _, name = line.partition("#")[0].strip().partition(" ")
        basic, _, bound = kind.partition("[<=")
        if "=" in name or not name:
            continue
        word = words.get(basic, "std_msgs::msg::Header")
        yield f"sequence<{word}, {bound[:-1]}> {name};" if bound else f"{word} {name};"


IDL_FIELDS = {
    RAW_SCAN: list(idl_fields()),
    "std_msgs/msg/Header": ["builtin_interfaces::msg::Time stamp;", "string frame_id;"],
    "builtin_interfaces/msg/Time": ["int32 sec;", "uint32 nanosec;"],
}
DEFINITIONS = {
    "line ends of Windows": ("ros2msg", lambda text: text.replace("\n", "\r\n")),
    "line ends of old Macs": ("ros2msg", lambda text: text.replace("\n", "\r")),
    "a byte order mark": ("ros2msg", lambda text: "\ufeff" + text),
    "a NUL at the end": ("ros2msg", lambda text: text + "\0"),
    "comments": ("ros2msg", lambda text: f"# \u00b5m\n{text}"),
    "IDL": ("ros2idl", lambda _: idl()),
    "none": ("", lambda _: ""),
}


@pytest.mark.parametrize(("form", "change"), DEFINITIONS.values(), ids=DEFINITIONS.keys())
def test_a_definition_of_any_form_gives_the_same_fields(
    form: str, change: Callable[[str], str], tmp_path: Path
) -> None:
    (tmp_path / "a.mcap").write_bytes(mcap({CDR: 1, (ONE, "cdr", form, definition(change)): 1}))
    with opened_bag(tmp_path / "a.mcap") as reader:
        assert scan_schema(reader.connections, ONE, "bag").fields == installed_schema(RAW_SCAN).fields


def folder_of(bag: Path, files: Mapping[str, bytes], **changes: Any) -> Path:
    """Write a bag with metadata.yaml; ``changes``: of its content, None: left out."""
    bag.mkdir()
    for name, data in files.items():
        (bag / name).write_bytes(data)
    topic = {"name": ONE, "type": RAW_SCAN, "serialization_format": "cdr", "offered_qos_profiles": ""}
    content = {
        "version": 4,
        "storage_identifier": "mcap",
        "relative_file_paths": list(files),
        "topics_with_message_count": [{"topic_metadata": topic, "message_count": 5}],
    } | changes
    content = {key: value for key, value in content.items() if value is not None}
    (bag / METADATA).write_text(yaml.safe_dump({"rosbag2_bagfile_information": content}))
    return bag


WHOLE = mcap({CDR: 5})
TOPIC = {"name": ONE, "type": RAW_SCAN, "type_description_hash": "MD5_1"}
METADATA_FAULTS: dict[str, tuple[dict[str, bytes], dict[str, Any], str]] = {
    "a missing file": (
        {"a.mcap": WHOLE},
        {"relative_file_paths": ["a.mcap", "sub/b.mcap"]},
        "b.mcap is missing; expected all files that metadata.yaml lists, or a list of those that are there, by 'ros2 b",
    ),
    "an unlisted file": (
        {"a.mcap": WHOLE, "b.mcap": WHOLE},
        {"relative_file_paths": ["a.mcap"]},
        "metadata.yaml does not list b.mcap, but a.mcap; expected all files",
    ),
    "another compression": (
        {"a.mcap": WHOLE},
        {"compression_format": "bz2", "compression_mode": "FILE"},
        "the bag is compressed with bz2; expected zstd",
    ),
    "no list": (
        {"a.mcap": WHOLE},
        {"relative_file_paths": None},
        "metadata.yaml: cannot be read, no 'relative_file_pa",
    ),
    "two storages": ({"a.mcap": WHOLE, "b.db3": b""}, {}, r"b.db3: has no table topics; expected a rosbag2 bag"),
    "another file": ({"a.bag": b"#ROSBAG"}, {}, "a.bag: is no file that ends in .mcap or .db3; expected a ros"),
    "an unlisted compressed file": (
        {"a_0.mcap.zstd": zstandard.compress(WHOLE), "a_1.mcap": WHOLE},
        {"relative_file_paths": ["a_1.mcap"]},
        "metadata.yaml does not list a_0.mcap.zstd, but a_1.mcap; expected all files",
    ),
    "two files of one name": (
        {"a.mcap": WHOLE},
        {"relative_file_paths": ["a.mcap", "part2/a.mcap"]},
        "metadata.yaml: lists two files of the name a.mcap; expected each file once, in the folder of metadata.yaml",
    ),
}


@pytest.mark.parametrize(("files", "changes", "sentence"), METADATA_FAULTS.values(), ids=METADATA_FAULTS.keys())
def test_invalid_metadata_are_refused(
    files: dict[str, bytes], changes: dict[str, Any], sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(BagError, match=sentence):
        read(folder_of(tmp_path / "bag", files, **changes))


def test_metadata_add_only_what_the_files_do_not_state(tmp_path: Path) -> None:
    rows = [{"topic_metadata": TOPIC, "message_count": n} for n in (2, 3)]
    changes = {"storage_identifier": "", "topics_with_message_count": rows}
    bag = folder_of(tmp_path / "bag", {"a.mcap": mcap({(ONE, "cdr", "", b""): 4}, type_name="")}, **changes)
    messages, notes = read(bag)
    assert len(messages) == 4
    assert notes == ["metadata.yaml states 5 messages of /one/raw; the files hold 4"]
    with pytest.raises(BagError, match="holds no messages but of /one/raw of no stated type"):
        read(bag / "a.mcap")


def test_a_file_that_was_decompressed_by_hand_is_read_once(tmp_path: Path) -> None:
    files = {"a.mcap.zstd": zstandard.compress(WHOLE), "a.mcap": WHOLE}
    bag = folder_of(tmp_path / "bag", files, relative_file_paths=["a.mcap.zstd"])
    messages, notes = read(bag)
    assert (len(messages), notes) == (5, [])


def test_hidden_files_beside_a_bag_are_no_part_of_it(tmp_path: Path) -> None:
    bag = folder_of(tmp_path / "bag", {"a.mcap": WHOLE})
    (bag / "._a.mcap").write_bytes(b"\0\5\x16\7Mac OS X")
    assert len(read(bag)[0]) == 5
    assert [rescue.path.name for rescue in recover(bag, tmp_path / "out")] == ["a.mcap"]


def test_compressed_files_of_a_killed_recorder_are_named(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "a_0.mcap.zstd").write_bytes(zstandard.compress(WHOLE))
    with pytest.raises(BagError, match=r"metadata.yaml is missing .*; or name the file '.*a_0.mcap.zstd' itself"):
        read(bag)
    (bag / "a_1.mcap").write_bytes(WHOLE)
    with pytest.raises(BagError, match=r"metadata.yaml is missing .*'recover' of posor .* with metadata.yaml\.$"):
        read(bag)
    with pytest.raises(BagError, match=r"a_0.mcap.zstd: is compressed; expected its content, as 'unzstd' writes it"):
        recover(bag, tmp_path / "out")
    (bag / "a_0.mcap").write_bytes(WHOLE)
    assert [rescue.messages for rescue in recover(bag, tmp_path / "out")] == [5, 5]


FORMS: dict[str, tuple[bytes, dict[str, Any]]] = {
    "a path of Windows": (WHOLE, {"relative_file_paths": [r"C:\bags\a.mcap"]}),
    "a file that is listed twice": (WHOLE, {"relative_file_paths": ["a.mcap", "a.mcap"]}),
    "no compression by the mode": (WHOLE, {"compression_format": "bz2", "compression_mode": "NONE"}),
    "a hash of another kind": (WHOLE, {"topics_with_message_count": [{"topic_metadata": TOPIC, "message_count": 5}]}),
    "a type name of ROS 1": (mcap({CDR: 5}, type_name=RAW_SCAN.replace("/msg/", "/")), {}),
    "topics that only the data define": (mcap({CDR: 5}, repeat_channels=False, repeat_schemas=False), {}),
}


@pytest.mark.parametrize(("file", "changes"), FORMS.values(), ids=FORMS.keys())
def test_metadata_and_files_of_other_forms_are_read_whole(file: bytes, changes: dict[str, Any], tmp_path: Path) -> None:
    bag = folder_of(tmp_path / "bag", {"a.mcap": file}, **changes)
    messages, notes = read(bag)
    assert (len(messages), notes) == (5, [])
    with opened_bag(bag) as reader:
        assert [(each.msgtype, each.digest) for each in reader.connections] == [(RAW_SCAN, "")]


def test_messages_of_a_missing_schema_are_listed(tmp_path: Path) -> None:
    file = BytesIO()
    writer = McapWriter(file)
    writer.start()
    channels = [writer.register_channel(topic, "cdr", 7) for topic in TOPICS]
    for _ in range(3):
        writer.add_message(channels[0], 0, bytes(40), 0)  # no log time
    schema = writer.register_schema(RAW_SCAN, "ros2msg", definition())
    writer.add_message(writer.register_channel("/four/raw", "cdr", schema), 0, bytes(40), 0)
    writer.finish()
    (tmp_path / "a.mcap").write_bytes(file.getvalue())
    messages, notes = read(tmp_path / "a.mcap")
    assert (len(messages), notes) == (1, ["topic /one/raw is left out: 3 messages of a schema that the file lacks"])


def test_log_times_beyond_the_range_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(mcap({CDR: 3}, first_ns=1 << 63))
    with pytest.raises(
        BagError, match=r"a.mcap: messages are logged at 9223372036854775810 ns; expected at most 2\^63"
    ):
        read(tmp_path / "a.mcap")
    with pytest.raises(BagError, match="holds no whole message, 3 messages lost, their log times are damaged"):
        recover(tmp_path / "a.mcap", tmp_path / "out")


def test_a_chunk_that_is_not_where_the_index_lists_it_is_damage(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap({CDR: 60}, chunk_size=1000))
    damaged(path, chunk_indices(path)[1].chunk_start_offset, b"\x90")
    with pytest.raises(
        BagError, match=r"a.mcap, byte \d+: there is no chunk, which the index lists; expected an undam"
    ):
        read(tmp_path / "a.mcap")


@pytest.mark.parametrize("flips", [60, pytest.param(1500, marks=pytest.mark.long)])
def test_a_flipped_bit_of_a_file_without_chunks_costs_two_messages_at_most(flips: int, tmp_path: Path) -> None:
    whole, chance = mcap({CDR: 60}, **unindexed(use_chunking=False)), np.random.default_rng(43)
    sent = [n.to_bytes(40, "little") for n in range(60)]
    begin = whole.index(sent[1]) - 2 * 31 - 40  # of the first message
    for n in range(flips):
        data, at = bytearray(whole), int(chance.integers(begin, len(whole) - 60))
        data[at] ^= 1 << int(chance.integers(8))
        (tmp_path / "a.mcap").write_bytes(data)
        (rescue,) = recover(tmp_path / "a.mcap", tmp_path / f"out{n}")
        with opened_bag(tmp_path / f"out{n}") as reader:
            found = [bytes(message) for _, _, message in reader.messages()]
        assert len(set(sent) - set(found)) <= 2
        if len(found) < 60:
            assert rescue.damages or rescue.skipped or rescue.lost
        shutil.rmtree(tmp_path / f"out{n}")


def test_a_second_file_that_was_appended_is_damage(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(WHOLE + mcap({CDR: 7}))
    (rescue,) = recover(path, tmp_path / "out")
    what = "another MCAP file begins here, to be cut off to a file of its own"
    assert (rescue.messages, rescue.damages) == (5, [Damage(len(WHOLE), path.stat().st_size - len(WHOLE), what)])


def test_an_end_of_the_data_before_their_last_record_is_damage(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap({CDR: 60}, **unindexed(use_chunking=False)))
    at = path.read_bytes().index((7).to_bytes(40, "little")) - 31
    damaged(path, at, b"\x0f")
    with pytest.raises(BagError, match=rf"a.mcap, byte {at}: the record that ends the data is not the last"):
        read(path)
    (rescue,) = recover(path, tmp_path / "out")
    assert (rescue.messages, [damage.offset for damage in rescue.damages]) == (59, [at])


def sqlite_bag(folder: Path, change: Callable[[sqlite3.Connection], object], suffixes: tuple[str, ...]) -> Path:
    """Return an SQLite file as a recorder leaves it that is killed after a change of the file."""
    write(folder / "made/bag", [MESSAGES[:20]], StoragePlugin.SQLITE3)
    made = folder / "made/bag/bag.db3"
    (folder / "bag").mkdir()
    with closing(sqlite3.connect(made, isolation_level=None)) as database:
        change(database)
        for suffix in ("", *suffixes):
            shutil.copyfile(f"{made}{suffix}", folder / f"bag/bag.db3{suffix}")
    return folder / "bag/bag.db3"


def insert_rows(database: sqlite3.Connection) -> None:
    database.execute("PRAGMA journal_mode = wal")
    rows = [(1, time_ns, data) for _, time_ns, data in MESSAGES[20:]]
    database.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows)


def spoil_rows(database: sqlite3.Connection) -> None:
    database.execute("PRAGMA cache_size = 1")
    database.execute("BEGIN")
    database.execute("UPDATE messages SET data = zeroblob(9000)")


@pytest.mark.parametrize(
    ("change", "suffixes", "count"),
    [(insert_rows, ("-wal",), 60), (insert_rows, ("-wal", "-shm"), 60), (spoil_rows, ("-journal",), 20)],
    ids=["wal", "wal with shm", "hot journal"],
)
def test_transactions_that_a_killed_recorder_left_beside_the_file_count(
    change: Callable[[sqlite3.Connection], object], suffixes: tuple[str, ...], count: int, tmp_path: Path
) -> None:
    path = sqlite_bag(tmp_path, change, suffixes)
    before = contents_of(path.parent)
    messages, notes = read(path)
    assert messages == [data for _, _, data in MESSAGES[:count]]
    expected = (
        f"bag.db3{suffixes[0]} holds transactions that bag.db3 lacks, so a copy of both is read; {REPAIR} completes it"
    )
    assert notes == [expected]
    assert contents_of(path.parent) == before


@pytest.mark.parametrize("linked", [("",), ("", "-wal")], ids=["file", "file and log"])
def test_the_log_of_a_linked_file_counts(linked: tuple[str, ...], tmp_path: Path) -> None:
    path, folder = sqlite_bag(tmp_path, insert_rows, ("-wal",)), tmp_path / "links"
    folder.mkdir()
    for suffix in linked:
        (folder / f"run.db3{suffix}").symlink_to(f"{path}{suffix}")
    messages, notes = read(folder / "run.db3")
    assert messages == [data for _, _, data in MESSAGES]
    assert len(notes) == 1


def test_a_cut_write_ahead_log_is_noted(tmp_path: Path) -> None:
    path = sqlite_bag(tmp_path, insert_rows, ("-wal",))
    log = path.with_name("bag.db3-wal")
    log.write_bytes(log.read_bytes()[:-2000])
    messages, notes = read(path)
    assert len(messages) == 59
    assert notes[1:] == ["bag.db3-wal ends within a transaction, which is left out"]
    log.write_bytes(bytes(5000))
    with pytest.raises(
        BagError, match=r"bag.db3-wal: is not a write-ahead log of SQLite; expected the one that was .*"
    ):
        read(path)
    log.write_bytes(log.read_bytes()[:0])
    assert len(read(path)[0]) == 20


def test_a_log_that_takes_messages_away_is_refused(tmp_path: Path) -> None:
    def write_whole(database: sqlite3.Connection) -> None:
        insert_rows(database)
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")

    def shorten(database: sqlite3.Connection) -> None:
        database.execute("PRAGMA journal_mode = wal")
        database.execute("DELETE FROM messages WHERE id > 5")

    whole = sqlite_bag(tmp_path / "whole", write_whole, ())
    shutil.copy(sqlite_bag(tmp_path / "short", shorten, ("-wal",)).with_name("bag.db3-wal"), whole.parent)
    with pytest.raises(BagError, match=r"bag.db3-wal: the log leaves 5 of the 60 messages of bag.db3; "):
        read(whole)


def test_a_log_of_another_name_is_refused(tmp_path: Path) -> None:
    path = sqlite_bag(tmp_path, insert_rows, ("-wal",))
    renamed = path.rename(path.with_name("run 1.db3"))
    with pytest.raises(
        BagError, match=r"run 1.db3: bag.db3-wal belongs to no file beside it; expected .*run 1.db3-wal"
    ):
        read(renamed)


UNREADABLE_ROWS = {"text": "data = 'abc'", "half a nanosecond": "timestamp = 1000.5", "negative": "timestamp = -5"}


@pytest.mark.parametrize("change", UNREADABLE_ROWS.values(), ids=UNREADABLE_ROWS.keys())
def test_a_row_that_is_no_message_is_named(change: str, tmp_path: Path) -> None:
    query = f"UPDATE messages SET {change} WHERE id = 3"  # noqa: S608  own
    path = sqlite_bag(tmp_path, lambda database: database.execute(query), ())
    with pytest.raises(BagError, match=r"bag.db3: row 3 of the table messages is no message; expected a time of whole"):
        read(path)


def test_a_copy_that_finds_no_space_names_the_command_that_repairs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = sqlite_bag(tmp_path, insert_rows, ("-wal",))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "none"))
    with pytest.raises(BagError, match=rf"bag.db3-wal cannot be copied, No such .*; expected space in .*{REPAIR[:8]}"):
        read(path)


def test_rows_of_no_topic_are_listed(tmp_path: Path) -> None:
    path = sqlite_bag(tmp_path, lambda database: database.execute("UPDATE messages SET topic_id = 7 WHERE id > 15"), ())
    messages, notes = read(path)
    assert len(messages) == 15
    assert notes == ["topic of number 7 is left out: 5 messages of no topic in the table of topics"]


def with_largest_pages(database: sqlite3.Connection) -> None:
    database.execute("PRAGMA page_size = 65536")  # stated as 1 in the file
    database.execute("VACUUM")


def test_a_file_of_the_largest_pages_is_read_whole_or_refused(tmp_path: Path) -> None:
    path = sqlite_bag(tmp_path, with_largest_pages, ())
    assert len(read(path)[0]) == 20
    path.write_bytes(path.read_bytes()[:-65536])
    with pytest.raises(BagError, match="the file is cut short"):
        read(path)


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_messages_are_read_from_a_time_to_before_another(storage: StoragePlugin, tmp_path: Path) -> None:
    write(tmp_path / "bag", [MESSAGES], storage)
    with opened_bag(tmp_path / "bag") as reader:
        found = [time_ns for _, time_ns, _ in reader.messages(reader.connections, start=1010, stop=1020)]
    assert found == list(range(1010, 1020))


def test_of_several_definitions_of_a_type_that_of_the_topics_hash_counts(tmp_path: Path) -> None:
    def add_another(database: sqlite3.Connection) -> None:
        columns = "id, topic_type, encoding, encoded_message_definition, type_description_hash"
        database.execute("UPDATE message_definitions SET id = id + 100")
        other = (1, RAW_SCAN, "ros2msg", "float64 other", "RIHS01_" + "0" * 64)
        database.execute(f"INSERT INTO message_definitions ({columns}) VALUES (?, ?, ?, ?, ?)", other)  # noqa: S608  own

    with opened_bag(sqlite_bag(tmp_path, add_another, ())) as reader:
        assert scan_schema(reader.connections, ONE, "bag").by_path.keys() == installed_schema(RAW_SCAN).by_path.keys()
