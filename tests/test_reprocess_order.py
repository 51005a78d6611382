"""Reprocessing takes scans in the order in which a replay of the bag would publish them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from posor.bags.bag_writer import BagWriter
from posor.bags.reprocess_command import main
from posor.messages.message_definitions import Definition
from posor_bringup.arms import find_arm
from rosbags.rosbag2 import Reader

from tests.rig_replay import read_bag_messages

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rosbags.interfaces import Connection

BAG = Path(__file__).resolve().parents[1] / "bags" / "five_axis"
ARM = ["--arm", str(find_arm("five_axis"))]
COARSE_NS = 10_000_000
Logged = tuple[str, int, bytes]
"""Topic, log time [ns], message."""


def raw_scans(bag: Path) -> tuple[list[Connection], list[Logged]]:
    """Return the topics of raw scans, and the scans in the order of a replay."""
    with Reader(bag) as reader:
        topics = [connection for connection in reader.connections if connection.topic.endswith("/raw")]
        return topics, [(each.topic, time_ns, bytes(data)) for each, time_ns, data in reader.messages(topics)]


def write(folder: Path, topics: Sequence[Connection], chunks: Sequence[Sequence[Logged]]) -> Path:
    with BagWriter(folder) as writer:
        for each in topics:
            writer.add_topic(each.topic, each.msgtype, Definition(each.msgdef.data, each.digest))
        for chunk in chunks:
            for topic, time_ns, data in chunk:
                writer.write(topic, time_ns, data)
            writer.flush()
    return folder


def test_scans_of_one_log_time_in_chunks_that_overlap_are_taken_as_a_replay_takes_them(tmp_path: Path) -> None:
    """Two scans a tick of 10 ms; a tick is split between two chunks, of which the second one begins first."""
    topics, (first, *scans) = raw_scans(BAG)
    coarse = [(topic, time_ns // COARSE_NS * COARSE_NS, data) for topic, time_ns, data in scans]
    logged = [scan[:2] for scan in coarse]
    middle = next(n for n in range(len(logged) // 2, len(logged)) if logged[n] in logged[n - len(topics) : n])
    chunks = [coarse[:middle], [*coarse[middle:], (first[0], coarse[0][1] - 1, first[2])]]
    bag = write(tmp_path / "bag", topics, chunks)
    replayed = write(tmp_path / "replayed", topics, [raw_scans(bag)[1]])
    for each in (bag, replayed):
        assert main([str(each), *ARM, "--output", str(tmp_path / "out" / each.name)]) == 0
    found, expected = (read_bag_messages(tmp_path / "out" / each.name) for each in (bag, replayed))
    assert len(expected["/five_axis/endpoint/pose"]) == len(read_bag_messages(BAG)["/five_axis/endpoint/pose"])
    assert found == expected
