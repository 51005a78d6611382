"""Chunks that overlap in log time: the order is that of rosbags to the last tie, and only what has to wait is kept."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor.bags import block_reader
from posor.bags.bag_reader import opened_bag
from posor.errors import BagError
from posor.messages.byte_kernels import index_messages

from .bag_files import TOPICS, WANTED, Record, by_blocks, by_rosbags, chunk_indices, damaged, in_chunks, write

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from posor.numerics.array_types import IntArray

KILOBYTE = 1000
BAGS = 20
"""Of each kind of log times."""
LOGGED: dict[str, Callable[[np.random.Generator, int], IntArray]] = {
    "five at a time": lambda _, count: np.arange(count) // 5,
    "twenty ticks, any order": lambda random, count: random.integers(20, size=count),
    "a little out of order": lambda random, count: 30 + np.arange(count) + random.integers(-30, 30, count),
    "any order": lambda random, count: random.integers(count, size=count),
}
"""Log times [ns] of so many messages."""


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
        monkeypatch.setattr(block_reader, "BLOCK_BYTES", int(random.choice([1, 500, 5000, 4 << 20])))
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
    monkeypatch.setattr(block_reader, "BLOCK_BYTES", 15 * KILOBYTE)
    monkeypatch.setattr(block_reader, "MOST_WAITING", 30 * KILOBYTE)
    assert list(by_blocks(tmp_path / "bag")) == by_rosbags(tmp_path / "bag")


SPANNING = [scans(1000 + n, 6000, 49) for n in range(50)]
"""Chunks of 10 kB, each of which spans the whole record."""


def test_chunks_that_span_the_record_are_read_once_and_given_out_by_and_by(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "bag", SPANNING)
    parsed: list[int] = []

    def counted(data: Any, *others: Any) -> Any:
        parsed.append(len(data))
        return index_messages(data, *others)

    monkeypatch.setattr("posor.bags.block_reader.index_messages", counted)
    monkeypatch.setattr(block_reader, "BLOCK_BYTES", 25 * KILOBYTE)
    with opened_bag(tmp_path / "bag") as reader:
        found = list(block_reader.read_blocks(reader, WANTED, "the bag"))
    assert parsed == [chunk.uncompressed_size for chunk in chunk_indices(tmp_path / "bag/bag.mcap")]
    assert len(found) > 15
    assert max(block.nbytes for block in found) < 60 * KILOBYTE
    assert list(by_blocks(tmp_path / "bag")) == by_rosbags(tmp_path / "bag")


def test_more_than_memory_may_hold_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "bag", SPANNING)
    monkeypatch.setattr(block_reader, "BLOCK_BYTES", 25 * KILOBYTE)
    monkeypatch.setattr(block_reader, "MOST_WAITING", 100 * KILOBYTE)
    with pytest.raises(
        BagError,
        match=r"^.*bag: chunks overlap so much in log time that more than 0 MiB of messages of /one/raw, /two/raw wait "
        r"for others, at 10\d\d ns; expected messages about in the order of their log times, as `mcap sort` writes",
    ):
        list(by_blocks(tmp_path / "bag"))


def test_a_damaged_message_index_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "bag", SPANNING)
    third = chunk_indices(tmp_path / "bag/bag.mcap")[2]
    damaged(
        tmp_path / "bag" / "bag.mcap",
        third.chunk_start_offset + third.chunk_length + 1,
        struct.pack("<Q", 10**6),
    )
    with pytest.raises(
        BagError, match=rf"bag: the chunk at byte {third.chunk_start_offset} has a damaged message index; expected the"
    ):
        list(by_blocks(tmp_path / "bag"))


def test_a_message_outside_the_times_of_its_chunk_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "bag", [scans(1000, 1100), scans(1050, 1150)])
    path = tmp_path / "bag" / "bag.mcap"
    begin = path.read_bytes().index((1060).to_bytes(100, "little")) - 16
    damaged(path, begin, struct.pack("<Q", 7))
    with pytest.raises(
        BagError,
        match=r"bag: the chunk at byte \d+ holds messages logged from 7 to 1099 ns; expected from 1000 to 1099 ns",
    ):
        list(by_blocks(tmp_path / "bag"))
