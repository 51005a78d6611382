from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import pytest
from posor_drivers.sources.bag import BagParameters, BagSource
from posor_drivers.timeline import Due, ReplayParameters, timeline
from posor_estimator.errors import BagError, ParameterError
from posor_estimator.ros.message_types import MessageTypes, message_class
from posor_estimator.ros.parameters import validate
from posor_msgs.msg import RawScan
from rclpy.serialization import deserialize_message

from .bags import SECOND, Record, point, scan, text, write_bag

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

START = 1000 * SECOND
TENTH = SECOND // 10
RECORDS = [
    Record(*record)
    for number in range(5)
    for record in (scan(10 + number, START + number * TENTH), point(START + number * TENTH + 7))
]
NOW = 2_000_000 * SECOND


def replay(path: Path, records: list[Record], **options: Any) -> Iterator[Due]:
    others = tuple(sorted({record.topic for record in records} - {"/joint1/raw"}))
    bag = path / "bag"
    if not bag.exists():
        write_bag(bag, records)
    source = BagSource(BagParameters(path=str(bag), other_topics=others), MessageTypes())
    classes = {topic.name: message_class(topic.type_name) for topic in source.open()}
    return timeline(source, classes, ReplayParameters(**options), NOW)


def stamps(dues: list[Due]) -> list[int]:
    return [
        due.content.header.stamp.sec * SECOND + due.content.header.stamp.nanosec for due in dues if due.topic == "raw"
    ]


def decoded(dues: list[Due]) -> list[RawScan]:
    return [
        deserialize_message(due.content, RawScan) if isinstance(due.content, bytes) else due.content
        for due in dues
        if due.topic == "raw"
    ]


def test_recorded_bytes_go_out_untouched_at_the_recorded_pace(tmp_path: Path) -> None:
    dues = list(replay(tmp_path, RECORDS))
    assert [due.content for due in dues] == [record.data for record in RECORDS]
    assert [due.after_s for due in dues] == [(record.time_ns - START) / SECOND for record in RECORDS]


def test_rate_divides_the_distances_and_zero_takes_them_away(tmp_path: Path) -> None:
    fast = list(replay(tmp_path, RECORDS, rate=4.0))
    assert [due.after_s for due in fast] == pytest.approx([(record.time_ns - START) / SECOND / 4 for record in RECORDS])
    at_once = list(replay(tmp_path, RECORDS, rate=0.0))
    assert {due.after_s for due in at_once} == {0.0}
    assert [due.content for due in at_once] == [record.data for record in RECORDS]


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
def test_offsets_choose_a_part_that_begins_at_once(tmp_path: Path, start: float, stop: float, scans: list[int]) -> None:
    dues = list(replay(tmp_path, RECORDS, start_offset=start, stop_offset=stop))
    assert [content.scan for content in decoded(dues)] == scans
    assert dues[0].after_s == 0.0


def test_offsets_that_leave_no_scan_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError) as caught:
        list(replay(tmp_path, RECORDS, start_offset=5.0, stop_offset=6.0))
    assert str(caught.value) == (
        "no scan lies between 'start_offset' 5.0 and 'stop_offset' 6.0; expected offsets within the record."
    )


def test_offsets_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(ParameterError, match=r"'stop_offset' .* is not greater than 'start_offset'"):
        validate(ReplayParameters, {"start_offset": 1.0, "stop_offset": 1.0}, node="/n")


def test_loop_continues_stamps_scan_numbers_and_pace(tmp_path: Path) -> None:
    dues = list(itertools.islice(replay(tmp_path, RECORDS, loop=True), 30))
    assert [due.content for due in dues[:10]] == [record.data for record in RECORDS]
    scans = decoded(dues)
    assert [content.scan for content in scans] == list(range(10, 25))
    times = [content.header.stamp.sec * SECOND + content.header.stamp.nanosec for content in scans]
    assert times == [START + number * TENTH for number in range(15)]
    assert [due.after_s for due in dues if due.topic == "raw"] == pytest.approx(
        [number * 0.1 + 7e-9 * (number // 5) for number in range(15)], abs=1e-12
    )
    truth = [due.content for due in dues[10:] if due.topic != "raw"]
    assert truth[0].header.stamp.nanosec == 500_000_007


def test_loop_continues_stamps_where_the_log_times_were_compressed(tmp_path: Path) -> None:
    records = [scan(3 * number, START + number, stamp_ns=number * SECOND) for number in range(4)]
    scans = decoded(list(itertools.islice(replay(tmp_path, records, loop=True), 8)))
    assert [content.header.stamp.sec for content in scans] == list(range(8))
    assert [content.scan for content in scans] == [0, 3, 6, 9, 10, 13, 16, 19]


def test_loop_over_a_single_scan_takes_a_second_for_each(tmp_path: Path) -> None:
    dues = list(itertools.islice(replay(tmp_path, [scan(4, START)], loop=True), 3))
    assert [content.scan for content in decoded(dues)] == [4, 5, 6]
    assert [due.after_s for due in dues] == [0.0, 1.0, 2.0]


def test_restamped_replay_begins_now_and_keeps_distances(tmp_path: Path) -> None:
    dues = list(replay(tmp_path, RECORDS, restamp=True))
    assert stamps(dues) == [NOW + number * TENTH for number in range(5)]
    assert [content.scan for content in decoded(dues)] == [10, 11, 12, 13, 14]
    assert math.isnan(decoded(dues)[0].gap_voltages[1])


@pytest.mark.parametrize(("rate", "distance"), [(2.0, TENTH // 2), (0.0, TENTH)])
def test_restamping_follows_the_rate(tmp_path: Path, rate: float, distance: int) -> None:
    dues = list(replay(tmp_path, RECORDS, restamp=True, rate=rate))
    assert stamps(dues) == [NOW + number * distance for number in range(5)]


def test_restamped_loop_is_one_long_record(tmp_path: Path) -> None:
    dues = list(itertools.islice(replay(tmp_path, RECORDS, restamp=True, loop=True, rate=2.0), 30))
    assert stamps(dues) == [NOW + number * TENTH // 2 for number in range(15)]
    assert [content.scan for content in decoded(dues)] == list(range(10, 25))


def test_message_without_header_is_left_alone(tmp_path: Path) -> None:
    records = [scan(1, START), text(START + 1), scan(2, START + 2)]
    dues = list(replay(tmp_path, records, restamp=True))
    assert dues[1].content == records[1].data


def test_bytes_that_cannot_be_decoded_are_told(tmp_path: Path) -> None:
    broken = scan(2, START + 1)._replace(data=scan(2, START + 1).data[:40])
    with pytest.raises(BagError) as caught:
        list(replay(tmp_path, [scan(1, START), broken], restamp=True))
    assert str(caught.value) == f"topic raw: the 40 bytes recorded at {START + 1} ns cannot be decoded."
