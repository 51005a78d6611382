"""The driver node as a program, its scans received over DDS."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped
from lifecycle_msgs.msg import Transition
from posor_drivers.conditioning import stamp_ns
from posor_drivers.driver_node import DriverNode
from posor_lab.harness.graph import Graph, values_of
from posor_lab.harness.in_process_nodes import run_refused_node as refused
from posor_msgs.msg import RawScan
from rclpy.qos import QoSProfile

from .driver_program import LOSSLESS, driver_program, ros_names
from .sample_bags import SECOND, Record, point, scan, write_bag
from .sample_tables import write_table

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from posor_lab.harness.program import Program

    Refusal = Callable[..., tuple[int, list[str]]]

pytestmark = pytest.mark.usefixtures("ros_domain")

START = 1000 * SECOND
RECORDS = [
    Record(*record)
    for number in range(20)
    for record in (scan(number, START + number * SECOND // 100), point(START + number * SECOND // 100))
]
RAW = [record.data for record in RECORDS if record.topic == "/joint1/raw"]
TRUTH = [record.data for record in RECORDS if record.topic != "/joint1/raw"]
STATUS = "/joint1/driver_node: source"


def replay(bag: Path, **parameters: Any) -> Program:
    return driver_program(source="bag", bag__path=str(bag), **LOSSLESS, **parameters)


@pytest.fixture
def refusal(capfd: pytest.CaptureFixture[str]) -> Refusal:
    """Return what runs a driver in this process until it ends by itself."""
    return lambda **parameters: refused(DriverNode, ros_names(parameters), capfd, "/joint1")


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
            source="table", table__path=str(table), wait_for_other_subscribers=1, rate=0.0, **LOSSLESS
        ) as node:
            graph.wait_until(lambda: len(scans) == len(truths) == 4, "all steps")
            assert node.wait() == 0
        assert [content.scan for content in scans] == [1, 2, 3, 5]
        assert [content.status for content in scans] == [0, 1, 2, 0]
        assert [truth.header.stamp for truth in truths] == [content.header.stamp for content in scans]
        assert math.isnan(truths[1].point.x)


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
        assert [stamp - stamps[0] for stamp in stamps] == [number * SECOND // 100 for number in range(len(RAW))]


def test_endless_loop_is_one_long_record_for_late_subscribers_too(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", RECORDS)
    with Graph() as graph, replay(bag, loop=True) as program:
        scans = graph.collect(RawScan, "/joint1/raw")
        graph.wait_until(lambda: len(scans) > len(RAW), "one round")
        late = graph.collect(RawScan, "/joint1/raw", QoSProfile(depth=100))
        graph.wait_until(lambda: len(scans) >= 3 * len(RAW) and len(late) > 3, "three rounds, late scans")
        assert [content.scan for content in scans] == list(range(len(scans)))
        stamps = [stamp_ns(content) for content in scans]
        assert stamps == [START + number * SECOND // 100 for number in range(len(scans))]
        numbers = [content.scan for content in late]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        assert program.end() == 0


def test_invalid_parameters_end_the_program_with_one_sentence(tmp_path: Path, refusal: Refusal) -> None:
    node = "node /joint1/driver_node, parameter"
    with driver_program() as program:
        assert program.wait() == 2
        (sentence,) = program.errors
        assert sentence.startswith(f"{node} 'source': is not set; expected a string: where the scans come from")
    code, (sentence,) = refusal(source="table", table__path=str(tmp_path), bag__topic="/x")
    assert code == 2
    assert sentence.startswith(f"{node} 'bag.topic': there is no such parameter; expected perhaps 'table.")


def test_unreadable_inputs_end_the_program_with_one_sentence(tmp_path: Path, refusal: Refusal) -> None:
    bag = write_bag(tmp_path / "bag", RECORDS)
    storage = bag / "bag.mcap"
    storage.write_bytes(storage.read_bytes()[:-100])
    code, (sentence,) = refusal(source="bag", bag__path=str(bag))
    assert code == 1
    assert sentence.startswith(f"{storage}, byte {storage.stat().st_size}: the file was not closed or is cut short")
    table = write_table(tmp_path / "table.csv", "1,0,0,0,x,0,0,0,0,0,0,")
    assert refusal(source="table", table__path=str(table)) == (
        1,
        [f"{table}, line 4, column 'l1_v': 'x' is invalid; expected a finite number."],
    )


def test_offsets_beyond_the_record_end_the_program_with_one_sentence(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", RECORDS)
    with replay(bag, start_offset=50.0, wait_for_subscribers=0) as program:
        assert program.wait() == 2
        assert program.errors == [
            "no scan lies between 'start_offset' 50.0 and 'stop_offset' inf; expected offsets within the record."
        ]


def test_incomplete_record_is_published_before_the_program_ends(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", RECORDS)
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 20", "message_count: 21"))
    with Graph() as graph:
        graph.watch_diagnostics()
        raw = graph.collect(RawScan, "/joint1/raw", raw=True)
        with replay(bag, on_end="stay") as program:
            assert program.wait() == 1
            sentence = f"{bag}: holds 20 messages of /joint1/raw; expected 21, as its index says."
            assert program.errors == [sentence]
        graph.wait_until(lambda: len(raw) == len(RAW), "the scans before")
        assert graph.wait_for_status(STATUS, sentence).level == b"\x02"


TICK = SECOND // 1000
GROUPS = 40
SAMPLES = 5
NOISE_V, NOISE_A = 1e-3, 1e-8
OUTLIER_GROUP, OUTLIER_SAMPLE = 7, 3


def conditioned_scans(bag: Path, count: int, **conditioning: Any) -> list[RawScan]:
    parameters = {f"conditioning__{name}": value for name, value in conditioning.items()}
    with Graph() as graph:
        scans = graph.collect(RawScan, "/joint1/raw")
        with replay(bag, rate=0.0, **parameters) as program:
            graph.wait_until(lambda: len(scans) == count, f"{count} scans")
            assert program.wait() == 0
            assert program.errors == []
        return scans


def noisy_readings(count: int) -> tuple[Any, Any]:
    """Return voltages (count, 3) and currents (count, 8) with one outlier among the voltages."""
    random = np.random.default_rng(1985)
    volts = random.normal([0.25, 0.5, 0.75], NOISE_V, (count, 3))
    volts[OUTLIER_GROUP * SAMPLES + OUTLIER_SAMPLE, 1] += 0.4
    return volts, random.normal(5e-5, NOISE_A, (count, 8))


@pytest.mark.parametrize("method", ["mean", "trimmed"])
def test_noisy_samples_of_a_bag_are_averaged(tmp_path: Path, method: str) -> None:
    count = GROUPS * SAMPLES + 2
    volts, currents = noisy_readings(count)
    records = [
        scan(n, START + n * TICK, gap_voltages=volts[n], diode_currents=currents[n], status=RawScan.STATUS_SIMULATED)
        for n in range(count)
    ]
    bag = write_bag(tmp_path / "bag", records)
    results = conditioned_scans(bag, GROUPS + 1, method=method, samples=SAMPLES)
    assert [result.scan for result in results] == [*range(2, 5 * GROUPS, 5), 5 * GROUPS]
    assert [stamp_ns(result) - START for result in results] == [
        *(n * TICK for n in range(2, 5 * GROUPS, 5)),
        5 * GROUPS * TICK + TICK // 2,
    ]
    flagged = []
    for group, result in enumerate(results):
        part = slice(group * SAMPLES, group * SAMPLES + SAMPLES)
        dropped = bool(result.status & RawScan.STATUS_OUTLIERS_DROPPED)
        flagged += [group] if dropped else []
        assert result.status & ~RawScan.STATUS_OUTLIERS_DROPPED == RawScan.STATUS_SIMULATED
        assert result.samples == len(volts[part]) - dropped
        if not dropped:
            np.testing.assert_allclose(result.gap_voltages, volts[part].mean(axis=0), rtol=1e-13)
            np.testing.assert_allclose(result.gap_voltage_spreads, volts[part].std(axis=0, ddof=1), rtol=1e-9)
            np.testing.assert_allclose(result.diode_currents, currents[part].mean(axis=0), rtol=1e-13)
            np.testing.assert_allclose(result.diode_current_spreads, currents[part].std(axis=0, ddof=1), rtol=1e-9)
    assert (OUTLIER_GROUP in flagged) == (method == "trimmed")
    if method == "mean":
        assert flagged == []
        return
    kept = [OUTLIER_GROUP * SAMPLES + n for n in range(SAMPLES) if n != OUTLIER_SAMPLE]
    assert results[OUTLIER_GROUP].gap_voltages[1] == pytest.approx(volts[kept, 1].mean(), rel=1e-13)
    assert results[OUTLIER_GROUP].gap_voltage_spreads[1] == pytest.approx(volts[kept, 1].std(ddof=1), rel=1e-9)


def test_dark_samples_of_a_bag_are_subtracted(tmp_path: Path) -> None:
    net, background = np.linspace(1e-5, 8e-5, 8), np.linspace(3e-6, 1e-6, 8)
    records: list[Record] = []
    for n in range(21):
        lit = n % 2 == 1
        sources = np.array([0, 1] if lit else [255, 255], dtype=np.uint8)
        currents = background * (1.0 + 0.05 * n) + (net if lit else 0.0)
        records.append(scan(n, START + n * TICK, gap_voltages=np.ones(3), diode_currents=currents, lit_sources=sources))
    bag = write_bag(tmp_path / "bag", records)
    results = conditioned_scans(bag, 2, method="mean", samples=SAMPLES, subtract_dark=True)
    assert [(result.scan, result.samples) for result in results] == [(5, 5), (15, 5)]
    for result in results:
        assert result.status == RawScan.STATUS_DARK_SUBTRACTED
        np.testing.assert_allclose(result.diode_currents, net, rtol=1e-12)
