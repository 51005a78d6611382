# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterator
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from posor.errors import BagError, ParameterError
from posor.messages.message_definitions import MessageTypes
from posor.numerics.stamps import NS
from posor_drivers.conditioning import stamp_ns
from posor_drivers.driver_parameters import ReplayParameters
from posor_drivers.replay_publisher import ReplayPublisher, schedule_replay
from posor_drivers.sources.bag_source import BagParameters, BagSource
from posor_drivers.sources.source import SourceMessage
from posor_drivers.tick_scheduler import RunCalls
from posor_msgs.msg import RawScan
from posor_ros.message_classes import message_class
from rclpy.serialization import deserialize_message

from .sample_bags import Record, point, scan, text, write_bag

START = 1000 * NS
TENTH = NS // 10
RECORDS = [
    Record(*record)
    for number in range(5)
    for record in (scan(10 + number, START + number * TENTH), point(START + number * TENTH + 7))
]
NOW = 2_000_000 * NS


def replay(path: Path, records: list[Record], **options: Any) -> Iterator[SourceMessage]:
    others = tuple(sorted({record.topic for record in records} - {"/joint1/raw"}))
    bag = path / "bag"
    if not bag.exists():
        write_bag(bag, records)
    source = BagSource(BagParameters(path=str(bag), other_topics=others), MessageTypes())
    classes = {topic.name: message_class(topic.type_name) for topic in source.open()}
    return schedule_replay(source, classes, ReplayParameters(**options), NOW)


def decoded(items: list[SourceMessage]) -> list[RawScan]:
    return [
        deserialize_message(item.data, RawScan) if isinstance(item.data, bytes) else item.data
        for item in items
        if item.topic == "raw"
    ]


def stamps(items: list[SourceMessage]) -> list[int]:
    return [stamp_ns(content) for content in decoded(items)]


def test_recorded_bytes_are_published_unchanged_at_the_recorded_pace(tmp_path: Path) -> None:
    items = list(replay(tmp_path, RECORDS))
    assert [item.data for item in items] == [record.data for record in RECORDS]
    assert [item.after_s for item in items] == [(record.time_ns - START) / NS for record in RECORDS]


def test_rate_divides_the_intervals_and_zero_removes_them(tmp_path: Path) -> None:
    fast = list(replay(tmp_path, RECORDS, rate=4.0))
    assert [item.after_s for item in fast] == pytest.approx([(record.time_ns - START) / NS / 4 for record in RECORDS])
    at_once = list(replay(tmp_path, RECORDS, rate=0.0))
    assert {item.after_s for item in at_once} == {0.0}
    assert [item.data for item in at_once] == [record.data for record in RECORDS]


@pytest.mark.parametrize(
    ("start", "stop", "scans"),
    [
        (0.0, math.inf, [10, 11, 12, 13, 14]),
        (0.1, math.inf, [11, 12, 13, 14]),
        (0.15, 0.4, [12, 13]),
        (0.0, 0.1, [10]),
        (0.4, 9.0, [14]),
    ],
)
def test_offsets_select_a_part_that_starts_at_once(tmp_path: Path, start: float, stop: float, scans: list[int]) -> None:
    items = list(replay(tmp_path, RECORDS, start_offset=start, stop_offset=stop))
    assert [content.scan for content in decoded(items)] == scans
    assert items[0].after_s == 0.0


def test_offsets_that_leave_no_scan_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError) as caught:
        list(replay(tmp_path, RECORDS, start_offset=5.0, stop_offset=6.0))
    assert str(caught.value) == (
        "no scan lies between 'start_offset' 5.0 and 'stop_offset' 6.0; expected offsets within the record."
    )


def test_loop_continues_stamps_scan_numbers_and_pace(tmp_path: Path) -> None:
    items = list(itertools.islice(replay(tmp_path, RECORDS, loop=True), 30))
    assert [item.data for item in items[:10]] == [record.data for record in RECORDS]
    scans = decoded(items)
    assert [content.scan for content in scans] == list(range(10, 25))
    assert stamps(items) == [START + number * TENTH for number in range(15)]
    assert [item.after_s for item in items if item.topic == "raw"] == pytest.approx(
        [number * 0.1 + 7e-9 * (number // 5) for number in range(15)], abs=1e-12
    )
    truth = [item.data for item in items[10:] if item.topic != "raw"]
    assert truth[0].header.stamp.nanosec == 500_000_007


def test_loop_continues_stamps_where_the_log_times_were_compressed(tmp_path: Path) -> None:
    records = [scan(3 * number, START + number, stamp_ns=number * NS) for number in range(4)]
    scans = decoded(list(itertools.islice(replay(tmp_path, records, loop=True), 8)))
    assert [content.header.stamp.sec for content in scans] == list(range(8))
    assert [content.scan for content in scans] == [0, 3, 6, 9, 12, 15, 18, 21]


def test_loop_is_as_long_for_a_joint_that_lacks_scans(tmp_path: Path) -> None:
    """Else its stamps are those of no other joint from the second pass on, and the arm has no endpoint."""
    passes = []
    for name, lost in (("whole", ()), ("lacking", (3, 4, 8))):
        records = [scan(n, START + n * TENTH) for n in range(10) if n not in lost]
        looped = decoded(list(itertools.islice(replay(tmp_path / name, records, loop=True), 3 * len(records))))
        passes.append({content.scan: (content.header.stamp.sec, content.header.stamp.nanosec) for content in looped})
    assert passes[1].items() < passes[0].items()


def test_loop_over_a_single_scan_has_a_period_of_a_second(tmp_path: Path) -> None:
    items = list(itertools.islice(replay(tmp_path, [scan(4, START)], loop=True), 3))
    assert [content.scan for content in decoded(items)] == [4, 5, 6]
    assert [item.after_s for item in items] == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(("rate", "distance"), [(1.0, TENTH), (2.0, TENTH // 2), (0.0, TENTH)])
def test_restamped_replay_starts_now_and_follows_the_rate(tmp_path: Path, rate: float, distance: int) -> None:
    items = list(replay(tmp_path, RECORDS, restamp=True, rate=rate))
    assert stamps(items) == [NOW + number * distance for number in range(5)]
    assert [content.scan for content in decoded(items)] == [10, 11, 12, 13, 14]
    assert math.isnan(decoded(items)[0].gap_voltages[1])


def test_restamped_loop_is_one_long_record(tmp_path: Path) -> None:
    items = list(itertools.islice(replay(tmp_path, RECORDS, restamp=True, loop=True, rate=2.0), 30))
    assert stamps(items) == [NOW + number * TENTH // 2 for number in range(15)]
    assert [content.scan for content in decoded(items)] == list(range(10, 25))


def test_message_without_header_is_unchanged(tmp_path: Path) -> None:
    records = [scan(1, START), text(START + 1), scan(2, START + 2)]
    items = list(replay(tmp_path, records, restamp=True))
    assert items[1].data == records[1].data


def test_undecodable_bytes_are_refused(tmp_path: Path) -> None:
    broken = scan(2, START + 1)._replace(data=scan(2, START + 1).data[:40])
    with pytest.raises(BagError) as caught:
        list(replay(tmp_path, [scan(1, START), broken], restamp=True))
    assert str(caught.value) == f"topic raw: the 40 bytes recorded at {START + 1} ns cannot be decoded."


class PublisherHarness:
    """Replaces the node around a ReplayPublisher and records what happens."""

    def __init__(self, *scheduled: SourceMessage, failure: Exception | None = None) -> None:
        self.scheduled = scheduled
        self.failure = failure
        self.listening = True
        self.asked = Event()
        self.published: list[tuple[str, float]] = []
        self.first = Event()
        self.begun = False
        self.error: Exception | None = None
        self.over = Event()
        calls = RunCalls(self.publish, self.has_subscribers, self.on_begin, self.on_end)
        self.publisher = ReplayPublisher(self.publications, calls)

    def publications(self) -> Iterator[SourceMessage]:
        yield from self.scheduled
        if self.failure is not None:
            raise self.failure

    def has_subscribers(self) -> bool:
        self.asked.set()
        return self.listening

    def publish(self, publication: SourceMessage) -> None:
        self.published.append((publication.topic, time.monotonic()))
        self.first.set()

    def on_begin(self) -> None:
        self.begun = True

    def on_end(self, error: Exception | None) -> None:
        self.error = error
        self.over.set()


def test_messages_are_not_published_early() -> None:
    harness = PublisherHarness(*(SourceMessage(str(number), 0, b"", 0.02 * number) for number in range(6)))
    begin = time.monotonic()
    harness.publisher.start()
    assert harness.over.wait(30.0)
    assert [topic for topic, _ in harness.published] == [str(number) for number in range(6)]
    assert all(at - begin >= 0.02 * number for number, (_, at) in enumerate(harness.published))
    assert harness.begun
    assert harness.error is None
    assert not harness.publisher.stop()


@pytest.mark.parametrize("listening", [True, False])
def test_replay_waits_for_subscribers_and_can_be_stopped_meanwhile(*, listening: bool) -> None:
    harness = PublisherHarness(SourceMessage("a", 0, b""))
    harness.listening = False
    harness.publisher.start()
    assert harness.asked.wait(30.0)
    assert harness.published == []
    harness.listening = listening
    if listening:
        assert harness.over.wait(30.0)
    assert harness.publisher.stop() is not listening
    assert len(harness.published) == listening
    assert harness.begun is listening


def test_replay_can_be_stopped_between_messages() -> None:
    harness = PublisherHarness(SourceMessage("a", 0, b""), SourceMessage("b", 0, b"", 1000.0))
    harness.publisher.start()
    assert harness.first.wait(30.0)
    assert harness.publisher.stop()
    assert [topic for topic, _ in harness.published] == ["a"]
    assert harness.begun
    assert not harness.over.is_set()


def test_failure_of_the_source_is_reported() -> None:
    for failure in (BagError("is broken"), KeyError("a bug")):
        harness = PublisherHarness(SourceMessage("a", 0, b""), failure=failure)
        harness.publisher.start()
        assert harness.over.wait(30.0)
        assert harness.error is failure
        assert len(harness.published) == 1
        harness.publisher.stop()
