# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The driver node as a program, its scans received over DDS."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped
from lifecycle_msgs.msg import Transition
from posor.numerics.stamps import NS
from posor_drivers.conditioning import condition_scans, stamp_ns
from posor_drivers.driver_node import DriverNode
from posor_drivers.driver_parameters import ConditioningParameters
from posor_drivers.sources.source import SourceMessage
from posor_lab.harness.graph import Graph, values_of
from posor_lab.harness.in_process_nodes import run_refused_node
from posor_lab.harness.message_conversion import message_content
from posor_lab.harness.program import Program
from posor_msgs.msg import RawScan
from rclpy.qos import QoSProfile

from .driver_program import LOSSLESS, driver_program
from .sample_bags import Record, point, scan, write_bag
from .sample_tables import MAP, write_table

pytestmark = pytest.mark.usefixtures("ros_domain")

START = 1000 * NS
RECORDS = [
    Record(*record)
    for number in range(20)
    for record in (scan(number, START + number * NS // 100), point(START + number * NS // 100))
]
RAW = [record.data for record in RECORDS if record.topic == "/joint1/raw"]
TRUTH = [record.data for record in RECORDS if record.topic != "/joint1/raw"]
STATUS = "/joint1/driver_node: source"


def replay(bag: Path, **parameters: Any) -> Program:
    return driver_program(source="bag", bag__path=str(bag), **LOSSLESS, **parameters)


@pytest.mark.parametrize("sqlite", [False, True])
def test_bag_is_replayed_with_the_recorded_bytes_and_the_program_ends(tmp_path: Path, *, sqlite: bool) -> None:
    bag = write_bag(tmp_path / "bag", RECORDS, sqlite=sqlite)
    with Graph() as graph:
        raw = graph.collect(RawScan, "/joint1/raw", raw=True)
        truth = graph.collect(PointStamped, "/truth/machining_centre", raw=True)
        others = {"bag__other_topics": ["/truth/machining_centre"], "wait_for_other_subscribers": 1}
        with replay(bag, **others) as program:
            graph.wait_until(lambda: len(raw) == len(RAW) and len(truth) == len(TRUTH), "all messages")
            assert program.wait() == 0
            assert program.errors == []
        assert raw == RAW
        assert truth == TRUTH


def test_table_is_published_as_scans_and_truth(tmp_path: Path) -> None:
    table = write_table(tmp_path / "table.csv")
    with Graph() as graph:
        scans = graph.collect(RawScan, "/joint1/raw")
        truths = graph.collect(PointStamped, "/truth/machining_centre")
        with driver_program(
            source="table",
            table__path=str(table),
            table__map=str(MAP),
            wait_for_other_subscribers=1,
            rate=0.0,
            **LOSSLESS,
        ) as node:
            graph.wait_until(lambda: len(scans) == len(truths) == 4, "all steps")
            assert node.wait() == 0
        assert [content.scan for content in scans] == [1, 2, 3, 5]
        assert [content.status for content in scans] == [0, 1, 2, 0]
        assert [truth.header.stamp for truth in truths] == [content.header.stamp for content in scans]
        assert math.isnan(truths[1].point.x)


def test_parameters_state_the_times_of_scans(tmp_path: Path) -> None:
    table = write_table(tmp_path / "table.csv")
    offsets = [-1e-4, 0.0, 1e-4, *([math.nan] * 8)]
    stated = {"stamp_uncertainty": 1e-5, "stamp_limit": 1e-4, "exposure_offsets": offsets, "exposure_span": 1e-3}
    parameters: dict[str, Any] = {f"time__{name}": value for name, value in stated.items()}
    program = partial(driver_program, source="table", table__path=str(table), table__map=str(MAP), rate=0.0, **LOSSLESS)
    with Graph() as graph:
        scans = graph.collect(RawScan, "/joint1/raw")
        with program(**parameters) as node:
            graph.wait_until(lambda: len(scans) == 4, "all steps")
            assert node.wait() == 0
        for name, value in stated.items():
            np.testing.assert_array_equal(getattr(scans[-1], name), value)
        with program(time__exposure_offsets=offsets[1:]) as node:
            sentence = "parameter 'time.exposure_offsets': 10 offsets; expected 11, one for each channel of scan 1."
            node.wait_for_line(sentence)
            assert node.wait() != 0


def test_fast_replay_to_a_slow_subscriber_loses_nothing(tmp_path: Path) -> None:
    records = [scan(number, START + number) for number in range(12_000)]
    bag = write_bag(tmp_path / "bag", records)
    with Graph() as graph:
        raw = graph.collect(RawScan, "/joint1/raw", raw=True)
        with replay(bag, rate=0.0) as program:
            graph.wait_until(lambda: len(raw) == len(records), "all scans")
            assert program.wait() == 0
        assert raw == [record.data for record in records]


def test_replay_waits_for_the_given_number_of_subscriptions(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", RECORDS)
    with Graph() as graph, replay(bag, wait_for_subscribers=2) as program:
        graph.watch_diagnostics()
        first = graph.collect(RawScan, "/joint1/raw", raw=True)
        graph.wait_for_status(STATUS, "waiting for subscriptions to /joint1/raw (1 of 2)")
        assert first == []
        second = graph.collect(RawScan, "/joint1/raw", raw=True)
        graph.wait_until(lambda: len(first) == len(second) == len(RAW), "all scans")
        assert first == second == RAW
        assert program.wait() == 0


def test_driver_can_stay_after_the_end(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", RECORDS)
    with Graph() as graph, replay(bag, on_end="stay", hardware_id="rig", rate=0.0) as program:
        graph.watch_diagnostics()
        raw = graph.collect(RawScan, "/joint1/raw", raw=True)
        status = graph.wait_for_status(STATUS, "ended")
        graph.wait_until(lambda: len(raw) == len(RAW), "all scans")
        values = values_of(status)
        assert (values["source"], values["record"], values["scans_published"]) == ("bag", str(bag), str(len(RAW)))
        assert (status.level, status.hardware_id) == (b"\x00", "rig")
        messages = [entry.message for entry in graph.diagnostics if entry.name == STATUS]
        assert "running" in messages
        assert graph.state("/joint1/driver_node") == "active"
        assert program.end() == 0


def test_each_activation_replays_from_the_beginning(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", RECORDS)
    with Graph() as graph, replay(bag, autostart=False, on_end="stay") as program:
        raw = graph.collect(RawScan, "/joint1/raw", raw=True)
        assert graph.change_state("/joint1/driver_node", Transition.TRANSITION_CONFIGURE)
        assert graph.change_state("/joint1/driver_node", Transition.TRANSITION_ACTIVATE)
        graph.wait_until(lambda: len(raw) == len(RAW), "all scans")
        assert graph.change_state("/joint1/driver_node", Transition.TRANSITION_DEACTIVATE)
        assert graph.change_state("/joint1/driver_node", Transition.TRANSITION_ACTIVATE)
        graph.wait_until(lambda: len(raw) == 2 * len(RAW), "all scans once more")
        assert raw == RAW + RAW
        assert program.end() == 0


def test_restamped_scans_have_present_stamps(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", RECORDS)
    with Graph() as graph:
        scans = graph.collect(RawScan, "/joint1/raw")
        before = graph.node.get_clock().now().nanoseconds
        with replay(bag, restamp=True) as program:
            graph.wait_until(lambda: len(scans) == len(RAW), "all scans")
            after = graph.node.get_clock().now().nanoseconds
            assert program.wait() == 0
        stamps = [stamp_ns(content) for content in scans]
        assert before < stamps[0] < after
        assert [stamp - stamps[0] for stamp in stamps] == [number * NS // 100 for number in range(len(RAW))]


def test_endless_loop_is_one_long_record_for_late_subscribers_too(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", RECORDS)
    with Graph() as graph, replay(bag, loop=True) as program:
        scans = graph.collect(RawScan, "/joint1/raw")
        graph.wait_until(lambda: len(scans) > len(RAW), "one round")
        late = graph.collect(RawScan, "/joint1/raw", QoSProfile(depth=100))
        graph.wait_until(lambda: len(scans) >= 3 * len(RAW) and len(late) > 3, "three rounds, late scans")
        assert [content.scan for content in scans] == list(range(len(scans)))
        stamps = [stamp_ns(content) for content in scans]
        assert stamps == [START + number * NS // 100 for number in range(len(scans))]
        numbers = [content.scan for content in late]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        assert program.end() == 0


def test_missing_parameter_ends_the_program_with_one_sentence() -> None:
    with driver_program() as program:
        assert program.wait() == 2
        (sentence,) = program.errors
        expected = "parameter 'source': is not set; expected a string: where the scans come from"
        assert sentence.startswith(f"node /joint1/driver_node, {expected}")


def test_unreadable_input_ends_the_program_with_one_sentence(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    table = write_table(tmp_path / "table.csv", "1,0,0,0,x,0,0,0,0,0,0,")
    sentence = (
        f"{table}, line 4, column 'l1_v': 'x' is invalid; expected a number, or leave_out: [invalid_cells] in the map."
    )
    parameters = {"source": "table", "table.path": str(table), "table.map": str(MAP)}
    assert run_refused_node(DriverNode, parameters, capfd) == (1, [sentence])


def test_offsets_beyond_the_record_end_the_program_with_one_sentence(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", RECORDS)
    with replay(bag, start_offset=50.0, wait_for_subscribers=0) as program:
        assert program.wait() == 2
        assert program.errors == [
            "no scan lies between 'start_offset' 50.0 and 'stop_offset' inf; expected offsets within the record."
        ]


def test_a_count_that_is_stated_too_high_is_a_warning(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", RECORDS)
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 20", "message_count: 21"))
    with Graph() as graph:
        raw = graph.collect(RawScan, "/joint1/raw", raw=True)
        with replay(bag) as program:
            assert program.wait() == 0
            assert [line for line in program.stderr if "metadata.yaml" in line and "21" in line]
        graph.wait_until(lambda: len(raw) == len(RAW), "all scans")


def noisy_records() -> list[Record]:
    """Return scans of which every fourth is dark, with an outlier among the voltages."""
    random, count = np.random.default_rng(1985), 42
    volts, currents = random.normal(0.5, 1e-3, (count, 3)), random.normal(5e-5, 1e-8, (count, 8))
    volts[22, 1] += 0.4
    sources = [np.array([255, 255] if n % 4 == 0 else [0, 1], dtype=np.uint8) for n in range(count)]
    readings = zip(volts, currents, sources, strict=True)
    return [
        scan(n, START + n * NS // 1000, gap_voltages=gaps, diode_currents=amperes, lit_sources=lit)
        for n, (gaps, amperes, lit) in enumerate(readings)
    ]


@pytest.mark.parametrize(
    "options", [{"method": "mean"}, {"method": "trimmed"}, {"method": "mean", "subtract_dark": True}]
)
def test_scans_of_a_bag_are_conditioned(tmp_path: Path, options: dict[str, Any]) -> None:
    records = noisy_records()
    raw = (SourceMessage("raw", 0, record.data) for record in records)
    expected = [each.data for each in condition_scans(raw, ConditioningParameters(samples=3, **options))]
    assert any(each.status for each in expected) == (options != {"method": "mean"})
    parameters = {f"conditioning__{name}": value for name, value in {"samples": 3, **options}.items()}
    with Graph() as graph:
        scans = graph.collect(RawScan, "/joint1/raw")
        with replay(write_bag(tmp_path / "bag", records), rate=0.0, **parameters) as program:
            graph.wait_until(lambda: len(scans) == len(expected), f"{len(expected)} scans")
            assert program.wait() == 0
            assert program.errors == []
    assert [message_content(each) for each in scans] == [message_content(each) for each in expected]
