# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Source ``looped``: recorded scans played forwards and backwards at ticks, with new stamps and numbers only."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from threading import Event
from time import sleep
from typing import Any

import numpy as np
import pytest
from posor.errors import BagError, ParameterError
from posor.messages.message_definitions import MessageTypes
from posor.numerics.stamps import NS
from posor.parameter_model import validate_parameters
from posor.ros_names import RAW_SCAN
from posor_drivers.driver_parameters import driver_parameters_for
from posor_drivers.ros_clock import TickClock
from posor_drivers.sources import looped_source as looped
from posor_drivers.sources.looped_source import LoopedParameters, LoopedSource
from posor_drivers.sources.source import SourceMessage, Topic
from posor_drivers.tick_scheduler import MissedTicks, TickScheduler, TickTask, schedule_ticks
from posor_lab.harness.graph import BEST_EFFORT, Graph, values_of
from posor_lab.harness.message_conversion import stamp_ns
from posor_msgs.msg import RawScan
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from rosgraph_msgs.msg import Clock as ClockMessage

from ..driver_program import driver_program
from ..sample_bags import Record, header, scan, write_bag

RATE = 2000
FAR = 1_800_000_000 * RATE  # a tick of the year 2027


def voltages(number: int) -> np.ndarray[Any, Any]:
    return np.array([0.1 * number, float("nan"), 0.3])


def record(count: int, topic: str = "/joint1/raw") -> list[Record]:
    """Return scans that a voltage identifies; frames of different length shift all later fields."""
    return [
        scan(100 + n, n * NS, topic=topic, gap_voltages=voltages(n), header=header(n * NS, "posor" + n % 9 * "x"))
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
    (message,) = source.read_tick(tick)
    assert message.topic == "raw"
    scan = deserialize_message(message.data, RawScan)
    assert message.time_ns == stamp_ns(scan) == source.publication_time_ns(tick)
    return scan


def test_scans_are_played_forwards_and_backwards_with_new_stamps_and_numbers(tmp_path: Path) -> None:
    records = record(12)
    source = opened(write_bag(tmp_path / "bag", records))
    order = [0, 2, 4, 6, 8, 10, 11, 9, 7, 5, 3, 1]
    first = FAR - FAR % len(order)
    for tick in range(first, first + 2 * len(order)):
        original = deserialize_message(records[order[(tick - first) % len(order)]].data, RawScan)
        scan = played(source, tick)
        assert scan.scan == tick
        assert stamp_ns(scan) == tick * NS // RATE
        scan.scan, scan.header.stamp = original.scan, original.header.stamp
        assert repr(scan) == repr(original)


def test_bytes_equal_those_of_a_new_scan(tmp_path: Path) -> None:
    (original,) = record(1)
    source = opened(write_bag(tmp_path / "bag", [original]))
    (message,) = source.read_tick(7)
    own = scan(7, 7 * NS // RATE, gap_voltages=voltages(0), header=header(7 * NS // RATE, "posor"))
    assert message.data == own.data


def test_number_of_played_scans_can_be_limited(tmp_path: Path) -> None:
    source = opened(write_bag(tmp_path / "bag", record(9)), scans=2)
    assert [round(10.0 * played(source, tick).gap_voltages[0]) for tick in range(4)] == [0, 1, 0, 1]


@pytest.mark.parametrize("rate", [1, 3, 10_000])
def test_ticks_are_those_of_the_clock_at_every_rate(tmp_path: Path, rate: int) -> None:
    source = opened(write_bag(tmp_path / "bag", record(3)), rate=rate)
    assert (source.rate, source.publication_time_ns(7 * rate)) == (rate, 7 * NS)
    assert source.start_run(7 * NS) == (7 * rate + 1, None)


def test_one_of_several_joints_must_be_chosen(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", record(3) + record(2, "/joint2/raw"))
    assert "expected parameter 'looped.topic' as one of /joint1/raw, /joint2/raw" in refusal(bag)
    assert played(opened(bag, topic="/joint2/raw"), 1).gap_voltages[0] == 0.1


def test_more_scans_than_recorded_or_than_memory_holds_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = write_bag(tmp_path / "bag", record(3))
    assert refusal(bag, scans=4) == (
        "parameter 'looped.scans': 4 scans are wanted; expected at most 3, the scans of /joint1/raw in BAG."
    )
    monkeypatch.setattr(looped, "MAX_SCANS", 2)
    assert refusal(bag) == (
        "BAG: topic /joint1/raw holds 3 scans; "
        "expected at most 2, or parameter 'looped.scans' to limit the scans that are played."
    )
    assert opened(bag, scans=2).newest_tick(0) == 0


@pytest.mark.parametrize("size", [0, 3, 11, 15, 30, 60, 150])
def test_scan_that_cannot_be_decoded_is_refused(tmp_path: Path, size: int) -> None:
    good = record(2)
    bag = write_bag(tmp_path / "bag", [*good, good[1]._replace(data=good[1].data[:size])])
    sentence = refusal(bag)
    assert sentence.startswith("BAG, message 3 of /joint1/raw: ")
    assert str(size) in sentence
    assert played(opened(bag, scans=2), 0).scan == 0


def test_late_joints_of_one_process_publish_the_same_ticks(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", record(5))
    published: dict[str, list[int]] = {"one": [], "other": []}
    missed = {name: MissedTicks() for name in published}
    enough = Event()

    def late(name: str, due: SourceMessage) -> None:
        published[name].append(due.time_ns)
        sleep(0.003)  # six periods
        if len(published["other"]) > 20:
            enough.set()

    def join(name: str) -> tuple[TickScheduler, TickTask]:
        def make_task(time: TickClock) -> TickTask:
            return TickTask(
                time, schedule_ticks(opened(bag), time, missed[name]), partial(late, name), lambda _error: None
            )

        return TickScheduler.add_task(Clock(clock_type=ClockType.ROS_TIME), RATE, 0, make_task)

    joined = [join(name) for name in published]
    assert enough.wait(60.0)
    for scheduler, task in joined:
        task.end()
        scheduler.remove_task(task)
    first = published["other"][0]
    together = [stamp for stamp in published["one"] if stamp >= first]
    assert together[:20] == published["other"][:20]
    assert missed["other"].ticks > 20


@pytest.mark.usefixtures("ros_domain")
def test_driver_plays_at_the_rate(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", record(5))
    with Graph() as graph:
        raw = graph.collect(RawScan, "/joint1/raw", BEST_EFFORT, raw=True)
        graph.watch_diagnostics()
        with driver_program(source="looped", looped__path=str(bag), looped__rate=50) as driver:
            graph.wait_until(lambda: len(raw) > 30, "scans")
            status = graph.wait_for_status("/joint1/driver_node: source", "running")
            assert driver.end() == 0
            assert driver.errors == []
    assert values_of(status)["record"] == str(bag)
    source = opened(bag, rate=50)
    numbers = [deserialize_message(data, RawScan).scan for data in raw]
    assert numbers == sorted(set(numbers))
    assert [next(iter(source.read_tick(number))).data for number in numbers] == raw


@pytest.mark.parametrize("rate", [0, 20_000, 1.5])
def test_an_invalid_rate_is_refused(rate: float) -> None:
    parameters = {"source": "looped", "looped.path": "bag", "looped.rate": rate}
    with pytest.raises(ParameterError, match=rf"parameter 'looped.rate': {rate} is"):
        validate_parameters(driver_parameters_for(parameters), parameters, node="/joint1/driver_node")


@pytest.mark.usefixtures("ros_domain")
def test_a_live_source_that_stops_is_an_error_and_its_return_is_reported(tmp_path: Path) -> None:
    """The ticks of simulated time stop with the clock."""
    write_bag(tmp_path / "bag", record(5))
    parameters: dict[str, Any] = {"use_sim_time": True, "wait_for_subscribers": 0}
    path = str(tmp_path / "bag")
    with driver_program(source="looped", looped__path=path, looped__rate=50, **parameters), Graph() as graph:
        graph.watch_diagnostics()
        scans = graph.collect(RawScan, "/joint1/raw", BEST_EFFORT)
        clock = graph.publisher(ClockMessage, "/clock", BEST_EFFORT)
        now_ns = NS

        def tick() -> None:
            nonlocal now_ns
            now_ns += NS // 50
            clock.publish(ClockMessage(clock=Time(nanoseconds=now_ns).to_msg()))
            sleep(0.02)

        graph.wait_until(lambda: len(scans) > 20, "scans", tick)
        status = graph.wait_for_status("/joint1/driver_node: input", "no input on source 'looped' for ")
        assert status.level == b"\x02"
        scans.clear()
        graph.wait_until(lambda: len(scans) > 5, "scans", tick)
        graph.diagnostics.clear()
        graph.wait_until(
            lambda: getattr(graph.latest("/joint1/driver_node: input"), "message", "") == "in time",
            "input in time",
            tick,
        )
