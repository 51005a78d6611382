# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags read and written in bulk are, message by message, what rosbags reads and writes.

The order of chunks that overlap in log time is that of rosbags to the last tie, and only what has to wait is kept.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posor.bags import chunk_reader, ordered_reader
from posor.bags.bag_reader import opened_bag
from posor.bags.bag_writer import BagWriter, TopicMessages
from posor.bags.block_reader import read_blocks
from posor.bags.message_block import TopicReader
from posor.errors import BagError
from posor.messages.byte_kernels import index_messages
from posor.messages.message_definitions import MessageTypes
from posor.messages.message_table import MessageTable, TableLayout
from posor.numerics.array_types import IntArray
from posor.ros_names import RAW_SCAN
from posor_msgs.msg import RawScan
from posor_ros.message_classes import schema_of_class
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import CompressionMode, Reader, StoragePlugin

from .bag_files import TOPICS, WANTED, Record, by_blocks, by_rosbags, chunk_indices, damaged, in_chunks, write

RANDOM = np.random.default_rng(11)


def scan(number: int, *, frame: str = "plate", diodes: int = 2) -> RawScan:
    message = RawScan(scan=number, samples=1, status=number % 7)
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = number // 1000, number % 1000 + 1
    message.gap_voltages = RANDOM.normal(size=3)
    message.diode_currents = RANDOM.normal(size=4 * diodes)
    message.lit_sources = list(range(diodes))
    message.temperature = float("nan") if number % 3 else 293.0
    return message


def records(count: int) -> list[Record]:
    """Return messages of all topics whose log times sometimes do not increase in the file; by log time, numbers do."""
    times = np.cumsum(RANDOM.integers(-3, 9, count)) + 1000
    ranks = np.argsort(np.argsort(times, kind="stable"))
    return [(TOPICS[n % 3], int(times[n]), serialize_message(scan(int(ranks[n])))) for n in range(count)]


@pytest.mark.parametrize("block", [8 << 20, 30_000], ids=["one block", "many blocks"])
@pytest.mark.parametrize(
    ("storage", "mode"),
    [
        (StoragePlugin.MCAP, CompressionMode.NONE),
        (StoragePlugin.MCAP, CompressionMode.STORAGE),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE),
        (StoragePlugin.MCAP, CompressionMode.FILE),
        (StoragePlugin.SQLITE3, CompressionMode.NONE),
    ],
    ids=lambda value: value.name.lower(),
)
def test_blocks_hold_the_messages_that_rosbags_reads_in_the_same_order(
    storage: StoragePlugin, mode: CompressionMode, block: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chunk_reader, "BLOCK_BYTES", block)
    monkeypatch.setattr(ordered_reader, "BLOCK_MESSAGES", 333)
    write(tmp_path / "bag", in_chunks(records(1000), 20_000), storage, mode)
    assert list(by_blocks(tmp_path / "bag")) == by_rosbags(tmp_path / "bag")


def test_a_file_without_an_index_is_read_too(tmp_path: Path) -> None:
    ordered = sorted(records(60), key=lambda one: one[1])
    write(tmp_path / "bag", [ordered])
    path = tmp_path / "bag" / "bag.mcap"
    whole = path.read_bytes()
    summary = struct.unpack("<Q", whole[-28:-20])[0]
    path.write_bytes(whole[:summary] + whole[-37:-28] + bytes(20) + whole[-8:])
    assert list(by_blocks(path)) == by_rosbags(path) == [one for one in ordered if one[0] in WANTED]


def test_a_record_beyond_the_end_of_its_chunk_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "bag", [records(90)])
    path = tmp_path / "bag" / "bag.mcap"
    begin = path.read_bytes().index(by_rosbags(path)[5][2]) - 31
    damaged(path, begin + 1, struct.pack("<Q", 10**6))
    with pytest.raises(
        BagError, match=r"bag.mcap, byte \d+: a chunk holds a record that runs beyond its end, after the "
    ):
        list(by_blocks(tmp_path / "bag"))


def test_fewer_messages_than_in_the_index_are_refused(tmp_path: Path) -> None:
    write(tmp_path / "bag", [records(90)])
    path = tmp_path / "bag" / "bag.mcap"
    damaged(path, path.read_bytes().index(by_rosbags(path)[5][2]) - 31, b"\x7f")
    with pytest.raises(
        BagError, match=r"holds 59 messages of /one/raw, /two/raw; expected 60, as the index of the bag states; 'rec"
    ):
        list(by_blocks(tmp_path / "bag"))


def read_tables(path: Path) -> list[tuple[IntArray, IntArray, MessageTable]]:
    with opened_bag(path) as reader:
        of_topic = TopicReader(0, WANTED[0], schema_of_class(RawScan), "the bag")
        return [table for block in read_blocks(reader, WANTED, str(path)) for table in of_topic.read_tables(block)]


def big_endian(message: RawScan) -> bytes:
    """Return a message that another machine has written."""
    types = MessageTypes()
    types.definition(RAW_SCAN)
    store: Any = types._store
    own = store.deserialize_cdr(schema_of_class(RawScan).serialize(message), RAW_SCAN)
    return bytes(store.serialize_cdr(own, RAW_SCAN, little_endian=False))


def test_tables_of_any_layout_hold_the_values_that_rclpy_reads(tmp_path: Path) -> None:
    kinds: list[dict[str, Any]] = [{}, {"frame": "another plate"}, {"diodes": 0}, {"diodes": 4}]
    messages = [scan(n, **kinds[int(RANDOM.integers(4)) if 20 < n < 40 else 0]) for n in range(60)]
    given = [
        (WANTED[0], 100 + n, big_endian(message) if n in (0, 45) else serialize_message(message) + bytes(n % 2))
        for n, message in enumerate(messages)
    ]
    write(tmp_path / "bag", [given])
    found = read_tables(tmp_path / "bag")
    assert len(found) < 30
    n = 0
    for times_ns, _, whole in found:
        for row in range(len(whole)):
            message, table = messages[n], whole.select(slice(row, row + 1))
            assert times_ns[row] == 100 + n
            assert table.layout.strings == {"header.frame_id": message.header.frame_id}
            again = deserialize_message(table.messages.tobytes(), RawScan)
            assert schema_of_class(RawScan).serialize(again) == schema_of_class(RawScan).serialize(message)
            assert table["header.stamp.nanosec"][0] == message.header.stamp.nanosec
            assert table["diode_currents"][0].tolist() == list(message.diode_currents)
            assert table["lit_sources"][0].tolist() == list(message.lit_sources)
            n += 1
    assert n == len(messages)


@pytest.mark.parametrize("cut", [0, 3, 30, 150])
def test_the_error_of_a_truncated_message_names_topic_and_time(cut: int, tmp_path: Path) -> None:
    given = [(WANTED[0], 100 + n, serialize_message(scan(n))) for n in range(20)]
    given[7] = (*given[7][:2], given[7][2][:cut])
    write(tmp_path / "bag", [given])
    with pytest.raises(BagError, match=r"^the bag, topic /one/raw, logged at 107 ns: [^;]*; expected [^;]*\.$"):
        read_tables(tmp_path / "bag")


def test_chunks_written_in_bulk_are_read_by_rosbags(tmp_path: Path) -> None:
    definition = MessageTypes().definition(RAW_SCAN)
    schema = schema_of_class(RawScan)
    layout = TableLayout.of(schema.serialize(scan(1)), schema)
    expected: list[Record] = []
    with BagWriter(tmp_path / "bag") as writer:
        channels = {topic: writer.add_topic(topic, RAW_SCAN, definition) for topic in WANTED}
        for begin in range(0, 300, 100):
            parts = []
            for topic, channel in channels.items():
                table, times = layout.copies(50), begin + 2 * np.arange(50) + channel
                table["scan"] = times
                parts.append(TopicMessages(channel, times, table.messages))
                expected += [
                    (topic, int(time_ns), data.tobytes()) for time_ns, data in zip(times, table.messages, strict=True)
                ]
            writer.write_messages(parts)
        writer.write_messages(
            [TopicMessages(channels[WANTED[0]], np.empty(0, dtype=np.int64), layout.copies(0).messages)]
        )
    assert by_rosbags(tmp_path / "bag") == sorted(expected, key=lambda one: one[1])
    assert list(by_blocks(tmp_path / "bag")) == by_rosbags(tmp_path / "bag")
    with Reader(tmp_path / "bag") as reader:
        assert {connection.topic: connection.msgcount for connection in reader.connections} == dict.fromkeys(
            WANTED, 150
        )
        assert (reader.start_time, reader.message_count) == (1, 300)


KILOBYTE = 1000
BAGS = 20  # of each kind of log times
LOGGED: dict[str, Callable[[np.random.Generator, int], IntArray]] = {  # log times [ns] of so many messages
    "five at a time": lambda _, count: np.arange(count) // 5,
    "twenty ticks, any order": lambda random, count: random.integers(20, size=count),
    "a little out of order": lambda random, count: 30 + np.arange(count) + random.integers(-30, 30, count),
    "any order": lambda random, count: random.integers(count, size=count),
}


@pytest.mark.long
@pytest.mark.parametrize("logged", LOGGED.values(), ids=LOGGED.keys())
def test_the_whole_sequence_is_that_of_rosbags(
    logged: Callable[[np.random.Generator, int], IntArray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed in range(BAGS):
        random = np.random.default_rng(seed)
        count = int(random.integers(1, 300))
        records = [
            (TOPICS[topic], time_ns, n.to_bytes(4, "little") + bytes(length))
            for n, (topic, time_ns, length) in enumerate(
                zip(
                    random.integers(len(TOPICS), size=count).tolist(),
                    logged(random, count).tolist(),
                    random.integers(300, size=count).tolist(),
                    strict=True,
                )
            )
        ]
        monkeypatch.setattr(chunk_reader, "BLOCK_BYTES", int(random.choice([1, 500, 5000, 4 << 20])))
        path = tmp_path / str(seed)
        write(path, in_chunks(records, int(random.choice([200, 2000, 20_000]))))
        assert list(by_blocks(path)) == by_rosbags(path), seed


def scans(begin: int, stop: int, step: int = 1) -> list[Record]:
    """Return messages of the wanted topics in turn, of 100 bytes each, logged at these times [ns]."""
    return [(WANTED[n % 2], n, n.to_bytes(100, "little")) for n in range(begin, stop, step)]


def early(n: int) -> list[Record]:
    """Return chunks in order, each with a message of another topic that was logged long before."""
    return [*scans(1000 + 100 * n, 1100 + 100 * n), (TOPICS[2], 1, bytes(100))]


def late(n: int) -> list[Record]:
    """Return chunks in order, mostly of another topic, each with a scan that was logged long after."""
    return [*scans(1000 + 5 * n, 1005 + 5 * n), (TOPICS[2], 1000 + 5 * n, bytes(10_000)), *scans(5000 + n, 5001 + n)]


def one_topic(n: int) -> list[Record]:
    """Return first all chunks of one topic, then those of the other."""
    topic, begin = divmod(n, 25)
    return [(WANTED[topic], 1000 + 100 * begin + k, bytes(100)) for k in range(100)]


@pytest.mark.parametrize("chunk", [early, late, one_topic])
def test_only_messages_that_have_to_wait_are_held(
    chunk: Callable[[int], list[Record]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "bag", [chunk(n) for n in range(50)])
    monkeypatch.setattr(chunk_reader, "BLOCK_BYTES", 15 * KILOBYTE)
    monkeypatch.setattr(chunk_reader, "MOST_WAITING", 30 * KILOBYTE)
    assert list(by_blocks(tmp_path / "bag")) == by_rosbags(tmp_path / "bag")


SPANNING = [scans(1000 + n, 6000, 49) for n in range(50)]  # chunks of 10 kB, each of which spans the whole record


def test_chunks_that_span_the_record_are_read_once_and_given_out_by_and_by(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "bag", SPANNING)
    parsed: list[int] = []

    def counted(data: Any, *others: Any) -> Any:
        parsed.append(len(data))
        return index_messages(data, *others)

    monkeypatch.setattr("posor.bags.chunk_reader.index_messages", counted)
    monkeypatch.setattr(chunk_reader, "BLOCK_BYTES", 25 * KILOBYTE)
    with opened_bag(tmp_path / "bag") as reader:
        found = list(read_blocks(reader, WANTED, "the bag"))
    assert parsed == [chunk.uncompressed_size for chunk in chunk_indices(tmp_path / "bag/bag.mcap")]
    assert len(found) > 15
    assert max(block.nbytes for block in found) < 60 * KILOBYTE
    assert list(by_blocks(tmp_path / "bag")) == by_rosbags(tmp_path / "bag")


def test_more_than_memory_may_hold_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "bag", SPANNING)
    monkeypatch.setattr(chunk_reader, "BLOCK_BYTES", 25 * KILOBYTE)
    monkeypatch.setattr(chunk_reader, "MOST_WAITING", 100 * KILOBYTE)
    with pytest.raises(
        BagError,
        match=r"^.*bag: chunks overlap so much in log time that more than 0 MiB of messages of /one/raw, /two/raw wait "
        r"for others, at 10\d\d ns; expected messages about in the order of their log times, as `mcap sort` writes",
    ):
        list(by_blocks(tmp_path / "bag"))


def test_a_damaged_message_index_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "bag", SPANNING)
    third = chunk_indices(tmp_path / "bag/bag.mcap")[2]
    damaged(tmp_path / "bag" / "bag.mcap", third.chunk_start_offset + third.chunk_length + 1, struct.pack("<Q", 10**6))
    with pytest.raises(
        BagError, match=rf"bag.mcap, byte {third.chunk_start_offset}: the chunk has a damaged message index; expected "
    ):
        list(by_blocks(tmp_path / "bag"))


def test_a_message_outside_the_times_of_its_chunk_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "bag", [scans(1000, 1100), scans(1050, 1150)])
    path = tmp_path / "bag" / "bag.mcap"
    begin = path.read_bytes().index((1060).to_bytes(100, "little")) - 16
    damaged(path, begin, struct.pack("<Q", 7))
    with pytest.raises(
        BagError,
        match=r"bag.mcap, byte \d+: the chunk holds messages logged from 7 to 1099 ns, not 1000 to 1099 ns as stated",
    ):
        list(by_blocks(tmp_path / "bag"))
