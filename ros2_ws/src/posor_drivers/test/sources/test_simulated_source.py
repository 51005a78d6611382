# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Source ``simulated`` in ``driver_node``: wall time, simulated time, several drivers, a stage."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from lifecycle_msgs.msg import Transition
from posor.chain.arm_file import load_arm_file
from posor.errors import CalibrationError, ParameterError
from posor.messages.message_definitions import MessageTypes
from posor.numerics.array_types import IntArray
from posor.numerics.stamps import NS
from posor_bringup.arms import load_checked_arm
from posor_drivers.message_builder import SimulatedMessages
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.pose_array import ArmTruth
from posor_drivers.simulator.simulated_scans import SimulatedScans
from posor_drivers.sources.simulated_source import SimulatedParameters, SimulatedSource
from posor_lab.harness.graph import BEST_EFFORT, Graph, values_of, wait_for_value
from posor_lab.harness.message_conversion import pose_from_message, stamp_ns
from posor_lab.harness.program import Program
from posor_msgs.msg import RawScan
from posor_ros.delivery_round import DeliveryRound
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from ..driver_program import driver_program
from ..three_joint_arm import scenario, write_arm

pytestmark = pytest.mark.usefixtures("ros_domain")

RATE = 100
PERIOD = 10_000_000
LAST = "elbow"
NODE = "/arm/{}/driver_node"


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    return write_arm(tmp_path)


def driver(arm: Path, joint: str, **parameters: object) -> Program:
    own = {"source": "simulated", "simulated__arm": str(arm), "simulated__joint": joint}
    return driver_program(f"/arm/{joint}", **own, **parameters)


def opened(arm: Path, joint: str, **parameters: Any) -> SimulatedSource:
    source = SimulatedSource(SimulatedParameters(arm=str(arm), joint=joint, **parameters), MessageTypes())
    source.open()
    return source


def test_joint_is_published_at_the_ticks_of_the_clock(arm: Path) -> None:
    with Graph() as graph:
        raw = graph.collect(RawScan, "/arm/base/raw", BEST_EFFORT, raw=True)
        truth = graph.collect(PoseStamped, "/arm/truth/base", raw=True)
        before = graph.node.get_clock().now().nanoseconds
        with driver(arm, "base", wait_for_other_subscribers=1) as program:
            graph.wait_until(lambda: len(raw) > 50 and len(truth) > 50, "scans")
            assert program.end() == 0
            assert program.errors == []
        after = graph.node.get_clock().now().nanoseconds
    scans = [deserialize_message(data, RawScan) for data in raw]
    assert all(stamp_ns(scan) == scan.scan * PERIOD for scan in scans)
    assert all(before < stamp_ns(scan) < after for scan in scans)
    numbers = [scan.scan for scan in scans]
    assert numbers == sorted(set(numbers))
    again = opened(arm, "base")
    assert [next(iter(again.read_tick(number))).data for number in numbers] == raw
    ticks = [stamp_ns(deserialize_message(data, PoseStamped)) // PERIOD for data in truth]
    assert [list(again.read_tick(tick))[-1].data for tick in ticks] == truth
    assert scans[0].header.frame_id == "base_receiving"
    assert scans[0].status & RawScan.STATUS_SIMULATED


@pytest.mark.long
def test_drivers_of_one_arm_publish_one_truth(arm: Path) -> None:
    simulation = ArmSimulation(load_arm_file(arm))
    with Graph() as graph:
        topics = {joint: graph.collect(PoseStamped, f"/arm/truth/{joint}") for joint in ("base", "shoulder", LAST)}
        endpoints = graph.collect(PoseStamped, "/arm/truth/endpoint")
        targets = graph.collect(PoseStamped, "/arm/target/endpoint")
        encoders = graph.collect(JointState, "/arm/encoders")
        stages = graph.collect(Vector3Stamped, "/arm/stage/position")
        received = {**topics, "endpoint": endpoints, "target": targets, "encoders": encoders, "stage": stages}

        def common() -> set[int]:
            return set.intersection(*({stamp_ns(m) for m in messages} for messages in received.values()))

        with (
            driver(arm, "base", wait_for_subscribers=0) as one,
            driver(arm, "shoulder", wait_for_subscribers=0) as two,
            driver(arm, LAST, wait_for_subscribers=0) as three,
        ):
            graph.wait_until(lambda: len(common()) > 20, "ticks published by every driver")
            assert [program.end() for program in (one, two, three)] == [0, 0, 0]
        for stamp in sorted(common()):
            tick = stamp // PERIOD
            truth = simulation.truth(np.array([tick]))
            at = {name: next(m for m in messages if stamp_ns(m) == stamp) for name, messages in received.items()}
            for joint in topics:
                assert at[joint].header.frame_id == f"{joint}_receiving"
                pose = pose_from_message(at[joint].pose)
                assert np.allclose(pose.translation, truth.T_parent_child[joint].translations[0], rtol=0.0, atol=1e-15)
            for name, poses in (("endpoint", truth.endpoint), ("target", truth.target)):
                assert at[name].header.frame_id == "base"
                pose = pose_from_message(at[name].pose)
                assert np.allclose(pose.homogeneous, poses[0].homogeneous, rtol=0.0, atol=1e-14)
            assert at["encoders"].name == ["base", "shoulder", LAST]
            assert list(at["encoders"].position) == truth.encoder[0].tolist()
            assert at["stage"].header.frame_id == "endpoint"


class SimulatedRun:
    def __init__(self, arm: Path, **parameters: object) -> None:
        self.now_ns = 1000 * NS  # the simulated time; each call of ``advance`` adds a fifth of a tick
        self.graph = Graph()
        self.scans: list[RawScan] = []
        self.program = driver(arm, "base", use_sim_time=True, **parameters)

    def __enter__(self) -> Self:
        self.graph.__enter__()
        self.graph.watch_diagnostics()
        self.scans = self.graph.collect(RawScan, "/arm/base/raw", BEST_EFFORT)
        self.program.__enter__()
        self._clock = self.graph.publisher(Clock, "/clock", QoSProfile(depth=1), subscriptions=1)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            assert self.program.end() == 0
        self.program.__exit__(kind, error, trace)
        self.graph.__exit__(kind, error, trace)

    def advance(self) -> None:
        self.now_ns += PERIOD // 5
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(self.now_ns, NS)
        self._clock.publish(message)

    def wait_for_scans(self, count: int) -> None:
        self.graph.wait_until(lambda: len(self.scans) >= count, f"{count} scans", self.advance)


@pytest.mark.long
def test_simulated_time_sets_the_pace_and_may_stop(arm: Path) -> None:
    with SimulatedRun(arm, simulated__dropouts=False) as run:
        latest: dict[int, int] = {}

        def watch() -> None:
            latest.update({scan.scan: run.now_ns for scan in run.scans if scan.scan not in latest})
            run.advance()

        run.graph.wait_until(lambda: len(run.scans) >= 10, "scans", watch)
        assert all(1000 * NS < stamp_ns(scan) <= run.now_ns for scan in run.scans)
        # Published no sooner than its latency after its stamp.
        assert all(now >= number * PERIOD + 800_000 for number, now in latest.items())
        count, last = len(run.scans), run.scans[-1].scan  # the clock stops here
    assert len(run.scans) - count <= 1
    assert run.scans[-1].scan - last <= 1


@pytest.mark.long
def test_deactivation_works_on_a_stopped_clock_and_activation_continues_at_present(arm: Path) -> None:
    with SimulatedRun(arm) as run:
        run.wait_for_scans(5)
        assert run.graph.change_state(NODE.format("base"), Transition.TRANSITION_DEACTIVATE)
        count = len(run.scans)
        for _ in range(20):
            run.advance()
            run.graph.receive()
        assert len(run.scans) == count
        assert run.graph.change_state(NODE.format("base"), Transition.TRANSITION_ACTIVATE)
        run.wait_for_scans(count + 5)
        assert run.scans[count].scan > run.scans[count - 1].scan + 3


def test_ticks_go_back_with_the_time(arm: Path) -> None:
    with SimulatedRun(arm) as run:
        run.wait_for_scans(5)
        run.now_ns = 500 * NS

        def early() -> list[int]:
            return [scan.scan for scan in run.scans if scan.scan < 600 * RATE]

        run.graph.wait_until(lambda: len(early()) >= 5, "earlier scans", run.advance)
        assert early() == sorted(early())


@pytest.mark.long
def test_clock_that_leaps_skips_and_counts_ticks(arm: Path) -> None:
    with SimulatedRun(arm, simulated__dropouts=False) as run:
        run.wait_for_scans(5)
        run.now_ns += NS
        run.wait_for_scans(10)
        steps = np.diff([scan.scan for scan in run.scans])
        assert steps.max() > RATE // 2
        name = f"{NODE.format('base')}: pace"

        def is_counted() -> bool:
            latest = run.graph.latest(name)
            return latest is not None and int(values_of(latest)["ticks_missed"]) >= steps.max() - 1

        run.graph.wait_until(is_counted, "the count of missed ticks")
        found = [status for status in run.graph.diagnostics if status.name == name]
        late = [status for status in found if status.message.startswith("late: ")]
        assert late[0].level == b"\x01"


@pytest.mark.long
def test_run_of_whole_cycles_ends_with_a_cycle(tmp_path: Path) -> None:
    rest = [{"kind": "rest", "duration": {"value": 0.2, "unit": "s"}}]
    changes = {"motion": rest, "duration.value": 0.2, "electronics.contamination": []}
    arm = write_arm(tmp_path, scenario(changes))
    with Graph() as graph:
        truth = graph.collect(PoseStamped, "/arm/truth/base")
        with driver(arm, "base", wait_for_subscribers=0, wait_for_other_subscribers=1, simulated__cycles=2) as program:
            assert program.wait() == 0
            graph.wait_until(lambda: stamp_ns(truth[-1]) // PERIOD % 20 == 19 if truth else False, "the last tick")
    ticks = [stamp_ns(pose) // PERIOD for pose in truth]
    assert ticks[-1] % 20 == 19
    assert 40 <= ticks[-1] - ticks[0] + 1 < 60


def test_stage_follows_commands_and_moves_endpoint_and_last_posor(arm: Path) -> None:
    simulation = ArmSimulation(load_arm_file(arm))
    with Graph() as graph:
        endpoints = graph.collect(PoseStamped, "/arm/truth/endpoint")
        elbows = graph.collect(PoseStamped, "/arm/truth/elbow")
        positions = graph.collect(Vector3Stamped, "/arm/stage/position")
        with driver(arm, LAST, wait_for_subscribers=0) as program:
            commands = graph.publisher(Vector3Stamped, "/arm/stage/command")
            goal = (2e-4, -1e-4, 3e-4)

            def there() -> bool:
                return bool(positions) and np.allclose(vector(positions[-1]), goal, rtol=0.0, atol=1e-9)

            graph.wait_until(there, "the stage", lambda: commands.publish(command(graph, goal)))
            stamp = stamp_ns(positions[-1])
            topics = (endpoints, elbows)
            graph.wait_until(lambda: all(stamp in map(stamp_ns, topic) for topic in topics), "the truth of that time")
            assert program.end() == 0
        position = next(vector(each) for each in positions if stamp_ns(each) == stamp)
        tick = np.array([stamp // PERIOD])
        truth, still = simulation.truth(tick, np.array([position])), simulation.truth(tick)
        endpoint = pose_from_message(next(each for each in endpoints if stamp_ns(each) == stamp).pose)
        elbow = pose_from_message(next(each for each in elbows if stamp_ns(each) == stamp).pose)
        assert np.allclose(endpoint.translation, truth.endpoint.translations[0], rtol=0.0, atol=1e-14)
        assert np.allclose(elbow.translation, truth.T_parent_child[LAST].translations[0], rtol=0.0, atol=1e-14)
        moved = endpoint.translation - still.endpoint.translations[0]
        seen = elbow.translation - still.T_parent_child[LAST].translations[0]
        assert np.linalg.norm(moved) == pytest.approx(np.linalg.norm(goal), rel=1e-3)
        assert np.linalg.norm(seen) == pytest.approx(np.linalg.norm(moved), rel=1e-9)


def vector(message: Vector3Stamped) -> list[float]:
    return [message.vector.x, message.vector.y, message.vector.z]


def command(graph: Graph, goal: tuple[float, float, float], frame: str = "endpoint") -> Any:
    message = Vector3Stamped()
    message.header.stamp = graph.node.get_clock().now().to_msg()
    message.header.frame_id = frame
    message.vector.x, message.vector.y, message.vector.z = goal
    return message


@pytest.mark.long
def test_invalid_stage_command_is_refused_and_reported(arm: Path) -> None:
    with Graph() as graph:
        graph.watch_diagnostics()
        positions = graph.collect(Vector3Stamped, "/arm/stage/position")
        with driver(arm, LAST, wait_for_subscribers=0) as program:
            graph.publisher(Vector3Stamped, "/arm/stage/command").publish(command(graph, (1e-4, 0.0, 0.0), "base"))
            status = wait_for_value(graph, f"{NODE.format(LAST)}: input /arm/stage/command", "refused", "1")
            assert (status.message, status.level) == ("refused", b"\x01")
            assert values_of(status)["reason"].endswith("is in frame 'base'; expected 'endpoint'.")
            count = len(positions)
            graph.wait_until(lambda: len(positions) > count + 5, "the stage's position")
            assert {tuple(vector(position)) for position in positions} == {(0.0, 0.0, 0.0)}
            assert program.end() == 0


def test_only_the_last_joint_of_an_arm_with_stage_takes_commands(arm: Path, tmp_path: Path) -> None:
    def inputs(path: Path, joint: str) -> list[str]:
        return [each.topic.name for each in opened(path, joint).inputs()]

    assert (inputs(arm, "base"), inputs(arm, LAST)) == ([], ["/arm/stage/command"])
    assert inputs(write_arm(tmp_path, scenario({"stage": None})), LAST) == []


def test_scans_computed_together_are_those_of_each_tick(arm: Path) -> None:
    simulation = ArmSimulation(load_arm_file(arm))
    messages = SimulatedMessages(MessageTypes(), simulation)
    source = opened(arm, LAST)
    first, _ = source.start_run(100 * PERIOD)
    simulation.start_at(LAST, first)
    move, seen = Vector3Stamped(), []
    move.header.frame_id, move.vector.x = "endpoint", 2e-4
    for tick in (*range(first, first + 40), *range(first + 60, first + 100), *range(first, first + 20)):
        if tick == first + 70:
            move.header.stamp.sec, move.header.stamp.nanosec = divmod(tick * PERIOD, NS)
            source.inputs()[0].on_message(move, tick * PERIOD)
        if tick == first:  # a simulation that starts again
            source.start_run(100 * PERIOD)
        published = {message.topic: message.data for message in source.read_tick(tick)}
        seen.append(vector(deserialize_message(published["/arm/stage/position"], Vector3Stamped)))
        scans = simulation.scans(LAST, np.array([tick]), simulation.truth(np.array([tick]), np.array([seen[-1]])))
        assert published.get("raw") == (messages.raw_scan(LAST, scans, 0).data if scans.sent[0] else None)
    assert seen[40:50] == [[0.0, 0.0, 0.0]] * 10
    assert len({x for x, _, _ in seen}) > 3  # the stage moved for several ticks
    assert seen[-1] == pytest.approx([2e-4, 0.0, 0.0])


def test_scans_at_rest_are_computed_together_after_the_round_by_each_joint_at_its_own_tick(
    arm: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    computed: list[tuple[str, int, bool]] = []  # joint, first tick, whether it was during a round

    def scans(simulation: ArmSimulation, joint: str, ticks: IntArray, truth: ArmTruth) -> SimulatedScans:
        computed.append((joint, int(ticks[0]), is_in_round))
        return compute(simulation, joint, ticks, truth)

    compute, is_in_round = ArmSimulation.scans, False
    monkeypatch.setattr(ArmSimulation, "scans", scans)
    sources = [opened(arm, joint) for joint in ("base", LAST)]
    first, _ = sources[0].start_run(100 * PERIOD)
    assert sources[1].start_run(100 * PERIOD) == (first, None)
    for tick in range(first, first + 52):
        with DeliveryRound():
            is_in_round = True
            for source in sources:
                list(source.read_tick(tick))
            is_in_round = False
    batches = [{begin for name, begin, _ in computed if name == joint} for joint in ("base", LAST)]
    assert all(4 <= len(begins) <= 6 for begins in batches)
    assert not batches[0] & batches[1] - {first, first + 1}
    assert {begin for _, begin, during in computed if during} == {first, first + 1}


def test_the_first_scan_of_each_run_is_dark() -> None:
    source = opened(load_checked_arm("six_axis").path, "elbow", dropouts=False)
    for begin in (1000, 1003):  # the second one is among the ticks that were computed together before
        first, _ = source.start_run(begin * NS // 200)
        published = [deserialize_message(next(iter(source.read_tick(first + n))).data, RawScan) for n in range(6)]
        dark = [all(lit == RawScan.NO_SOURCE for lit in scan.lit_sources) for scan in published]
        assert dark == [True] + 5 * [False]


def test_rate_replaces_that_of_the_scenario(arm: Path) -> None:
    source = opened(arm, "base", rate=50, latency=False)
    assert (source.rate, source.publication_time_ns(1)) == (50, 20_000_000)
    truth = next(message for message in source.read_tick(100) if "truth" in message.topic)
    slow = deserialize_message(truth.data, PoseStamped)
    assert stamp_ns(slow) == 2 * NS
    as_written = ArmSimulation(load_arm_file(arm)).truth(np.array([2 * RATE])).T_parent_child["base"]
    assert np.allclose(pose_from_message(slow.pose).translation, as_written.translations[0], rtol=0.0, atol=1e-7)


def test_unknown_joint_and_an_arm_without_scenario_are_refused(arm: Path) -> None:
    with pytest.raises(ParameterError) as unknown:
        opened(arm, "wrist")
    sentence = f"parameter 'simulated.joint': 'wrist' is not a joint of {arm}; expected one of base, shoulder, elbow."
    assert str(unknown.value) == sentence
    arm.write_text(arm.read_text(encoding="utf-8").replace("scenario: scenario.yaml\n", ""), encoding="utf-8")
    with pytest.raises(CalibrationError) as missing:
        opened(arm, "base")
    assert str(missing.value) == f"{arm}, line 1: key 'scenario' is missing; expected the simulator's scenario file."
