"""Source ``looped``: recorded scans at ticks of the ROS clock, forth and back, with new stamps and numbers only."""

from __future__ import annotations

from functools import partial
from threading import Event
from time import sleep
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_drivers.driver_node import DriverNode
from posor_drivers.driver_parameters import parameters_for
from posor_drivers.live import Misses, live
from posor_drivers.sources import looped
from posor_drivers.sources.base import Topic
from posor_drivers.sources.looped import LoopedParameters, LoopedSource
from posor_drivers.ticker import Beat, Ticker
from posor_estimator.errors import BagError, ParameterError
from posor_estimator.ros.message_types import RAW_SCAN, MessageTypes
from posor_estimator.ros.messages import stamp_ns
from posor_estimator.testing.graph import BEST_EFFORT, Graph, values_of
from posor_estimator.testing.program import Program, installed, ros_arguments
from posor_estimator.testing.refusal import refusal as refused
from posor_msgs.msg import RawScan
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.serialization import deserialize_message

from .bags import SECOND, Record, header, point, scan, write_bag

if TYPE_CHECKING:
    from pathlib import Path

    from posor_drivers.ros_time import RosTime
    from posor_drivers.timeline import Due

RATE = 2000
FAR = 1_800_000_000 * RATE
"""A tick of the year 2027."""


def voltages(number: int) -> np.ndarray[Any, Any]:
    return np.array([0.1 * number, float("nan"), 0.3])


def record(count: int, topic: str = "/joint1/raw") -> list[Record]:
    """Scans that tell by a voltage which one they are; their frames differ in length, so that everything shifts."""
    return [
        scan(
            100 + n, n * SECOND, topic=topic, gap_voltages=voltages(n), header=header(n * SECOND, "posor" + n % 9 * "x")
        )
        for n in range(count)
    ]


def opened(path: Path, **parameters: Any) -> LoopedSource:
    source = LoopedSource(LoopedParameters(path=str(path), **{"rate": RATE, **parameters}), MessageTypes())
    assert source.open() == [Topic("raw", RAW_SCAN)]
    return source


def refusal(path: Path, **parameters: Any) -> str:
    with pytest.raises(BagError) as caught:
        opened(path, **parameters)
    return str(caught.value).replace(str(path), "BAG")


def played(source: LoopedSource, tick: int) -> Any:
    (message,) = source.messages(tick)
    assert message.topic == "raw"
    scan = deserialize_message(message.data, RawScan)
    assert message.time_ns == stamp_ns(scan) == source.due_ns(tick)
    return scan


def test_scans_go_forth_and_back_and_only_stamp_and_number_are_new(tmp_path: Path) -> None:
    records = record(12)
    source = opened(write_bag(tmp_path / "bag", records))
    period = 22
    first = FAR - FAR % period
    for tick in range(first, first + 2 * period):
        at = (tick - first) % period
        original = deserialize_message(records[at if at < 12 else period - at].data, RawScan)
        scan = played(source, tick)
        assert scan.scan == tick
        assert stamp_ns(scan) == tick * SECOND // RATE
        scan.scan, scan.header.stamp = original.scan, original.header.stamp
        assert repr(scan) == repr(original)


def test_bytes_are_those_that_the_scan_would_have_had(tmp_path: Path) -> None:
    (original,) = record(1)
    source = opened(write_bag(tmp_path / "bag", [original]))
    (message,) = source.messages(7)
    own = scan(7, 7 * SECOND // RATE, gap_voltages=voltages(0), header=header(7 * SECOND // RATE, "posor"))
    assert message.data == own.data


def test_single_scan_stands_still(tmp_path: Path) -> None:
    source = opened(write_bag(tmp_path / "bag", record(1)))
    assert {played(source, tick).gap_voltages[0] for tick in range(FAR, FAR + 5)} == {0.0}


def test_first_scans_may_be_all_that_are_played(tmp_path: Path) -> None:
    source = opened(write_bag(tmp_path / "bag", record(9)), scans=2)
    assert [round(10.0 * played(source, tick).gap_voltages[0]) for tick in range(4)] == [0, 1, 0, 1]


def test_ticks_are_those_of_the_clock_whatever_the_rate(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", record(3))
    for rate in (1, 3, 2000, 10_000):
        source = opened(bag, rate=rate)
        now = 1_800_000_000 * SECOND + 123_456_789
        first, last = source.begin(now)
        assert last is None
        assert source.due_ns(first - 1) <= now < source.due_ns(first)
        assert source.newest(now) == first - 1
        assert source.newest(source.due_ns(first)) == first
    assert source.inputs() == []
    assert source.record == str(bag)


def test_one_of_several_joints_must_be_chosen(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", record(3) + record(2, "/joint2/raw"))
    assert refusal(bag) == (
        "BAG: scans are on 2 topics; expected parameter 'looped.topic' as one of /joint1/raw, /joint2/raw."
    )
    assert played(opened(bag, topic="/joint2/raw"), 1).gap_voltages[0] == 0.1


def test_more_scans_than_there_are_are_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", record(3))
    assert refusal(bag, scans=4) == (
        "parameter 'looped.scans': 4 scans are wanted; expected at most 3, the scans of /joint1/raw in BAG."
    )


def test_more_scans_than_memory_should_hold_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(looped, "MOST_SCANS", 2)
    bag = write_bag(tmp_path / "bag", record(3))
    assert refusal(bag) == (
        "BAG: topic /joint1/raw holds 3 scans; "
        "expected at most 2, or parameter 'looped.scans' to say how many of them to play."
    )
    assert opened(bag, scans=2).newest(0) == 0


@pytest.mark.parametrize("size", [0, 3, 11, 15, 30, 60, 150])
def test_scan_that_cannot_be_decoded_is_refused(tmp_path: Path, size: int) -> None:
    good = record(2)
    bag = write_bag(tmp_path / "bag", [*good, good[1]._replace(data=good[1].data[:size])])
    sentence = refusal(bag)
    assert sentence.startswith("BAG, message 3 of /joint1/raw: ")
    assert str(size) in sentence
    assert played(opened(bag, scans=2), 0).scan == 0


def test_bag_without_scans_and_no_bag_are_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path / "none").startswith("BAG: does not exist; ")
    assert refusal(write_bag(tmp_path / "bag", [point(1)]), topic="/truth/machining_centre").endswith(
        "is of type geometry_msgs/msg/PointStamped; expected posor_msgs/msg/RawScan."
    )


@pytest.mark.parametrize("pace", ["rate", "loop", "restamp"])
def test_parameters_of_a_replay_are_refused(pace: str) -> None:
    with pytest.raises(ParameterError, match="source 'looped' is live, its scans happen when they happen"):
        parameters_for({"source": "looped", pace: 1})


def test_joints_of_one_process_take_the_same_ticks_however_late_they_are(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", record(5))
    published: dict[str, list[int]] = {"one": [], "other": []}
    missed = {name: Misses() for name in published}
    enough = Event()

    def late(name: str, due: Due) -> None:
        published[name].append(due.stamp_ns)
        sleep(0.003)  # six periods
        if len(published["other"]) > 20:
            enough.set()

    def join(name: str) -> tuple[Ticker, Beat]:
        def beat(time: RosTime) -> Beat:
            return Beat(time, live(opened(bag), time, missed[name]), partial(late, name), lambda _error: None)

        return Ticker.joined(Clock(clock_type=ClockType.ROS_TIME), RATE, 0, beat)

    joined = [join(name) for name in published]
    assert enough.wait(60.0)
    for ticker, beat in joined:
        beat.end()
        ticker.remove(beat)
    first = published["other"][0]
    together = [stamp for stamp in published["one"] if stamp >= first]
    assert together[:20] == published["other"][:20]
    assert missed["other"].ticks > 20


def named(bag: Path, **parameters: object) -> dict[str, object]:
    return {"source": "looped", "looped.path": str(bag), **{f"looped.{name}": v for name, v in parameters.items()}}


@pytest.mark.usefixtures("ros_domain")
def test_driver_plays_at_the_rate(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", record(5))
    with Graph() as graph:
        raw = graph.collect(RawScan, "/joint1/raw", BEST_EFFORT, raw=True)
        graph.watch_diagnostics()
        command = [*installed("posor_drivers", "driver_node"), *ros_arguments(named(bag, rate=50), "/joint1")]
        with Program(command) as driver:
            graph.wait_until(lambda: len(raw) > 30, "scans")
            status = graph.wait_for_status("/joint1/driver_node: source", "running")
            assert driver.end() == 0
            assert driver.stderr == []
    assert values_of(status)["record"] == str(bag)
    source = opened(bag, rate=50)
    numbers = [deserialize_message(data, RawScan).scan for data in raw]
    assert numbers == sorted(set(numbers))
    assert [next(iter(source.messages(number))).data for number in numbers] == raw


@pytest.mark.usefixtures("ros_domain")
def test_driver_refuses_a_rate_that_cannot_be(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    bag = write_bag(tmp_path / "bag", record(5))
    for rate, said in ((0, "0"), (20_000, "20000"), (1.5, "1.5")):
        code, (sentence,) = refused(DriverNode, named(bag, rate=rate), capfd, "/joint1")
        assert code == 2
        assert "'looped.rate'" in sentence
        assert said in sentence
