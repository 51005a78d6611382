"""driver_node with a simulated joint, as a program: on the wall's clock, on /clock, with others, with a stage."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from lifecycle_msgs.msg import Transition
from posor_drivers.driver_node import DriverNode
from posor_drivers.driver_parameters import parameters_for
from posor_drivers.simulator.arm import ArmSimulation
from posor_drivers.sources.simulated import SimulatedParameters, SimulatedSource
from posor_estimator.core.arm import load_arm
from posor_estimator.errors import ParameterError
from posor_estimator.ros.message_types import MessageTypes
from posor_estimator.ros.messages import pose_from_message, stamp_ns
from posor_estimator.testing.graph import BEST_EFFORT, Graph, values_of
from posor_estimator.testing.program import Program, installed, ros_arguments
from posor_estimator.testing.refusal import refusal
from posor_estimator.testing.stamped import status_with
from posor_msgs.msg import RawScan
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from .arms import scenario, write_arm

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.usefixtures("ros_domain")

RATE = 100
PERIOD = 10_000_000
NS = 1_000_000_000
LAST = "elbow"
NODE = "/arm/{}/driver_node"


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    return write_arm(tmp_path)


def parameters_of(arm: Path, joint: str, **parameters: object) -> dict[str, object]:
    named = {name.replace("__", "."): value for name, value in parameters.items()}
    return {"source": "simulated", "simulated.arm": str(arm), "simulated.joint": joint, **named}


def driver(arm: Path, joint: str, **parameters: object) -> Program:
    arguments = ros_arguments(parameters_of(arm, joint, **parameters), f"/arm/{joint}")
    return Program([*installed("posor_drivers", "driver_node"), *arguments])


def test_joint_is_published_at_the_ticks_of_the_clock(arm: Path) -> None:
    with Graph() as graph:
        raw = graph.collect(RawScan, "/arm/base/raw", BEST_EFFORT, raw=True)
        truth = graph.collect(PoseStamped, "/arm/truth/base", raw=True)
        before = graph.node.get_clock().now().nanoseconds
        with driver(arm, "base", wait_for_other_subscribers=1) as program:
            graph.wait_until(lambda: len(raw) > 50 and len(truth) > 50, "scans")
            assert program.end() == 0
            assert program.stderr == []
        after = graph.node.get_clock().now().nanoseconds
    scans = [deserialize_message(data, RawScan) for data in raw]
    assert all(stamp_ns(scan) == scan.scan * PERIOD for scan in scans)
    assert all(before < stamp_ns(scan) < after for scan in scans)
    numbers = [scan.scan for scan in scans]
    assert numbers == sorted(set(numbers))
    again = SimulatedSource(SimulatedParameters(arm=str(arm), joint="base"), MessageTypes())
    again.open()
    assert [next(iter(again.messages(number))).data for number in numbers] == raw
    ticks = [stamp_ns(deserialize_message(data, PoseStamped)) // PERIOD for data in truth]
    assert [list(again.messages(tick))[-1].data for tick in ticks] == truth
    assert scans[0].header.frame_id == "base_receiving"
    assert scans[0].status & RawScan.STATUS_SIMULATED


def test_drivers_of_one_arm_agree_without_talking(arm: Path) -> None:
    simulation = ArmSimulation(load_arm(arm))
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
            graph.wait_until(lambda: len(common()) > 20, "ticks of which every driver has told")
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


class SimulatedTime:
    """The clock of a simulation: goes on when it is told to."""

    def __init__(self, graph: Graph, start_ns: int, subscriptions: int) -> None:
        self.now_ns = start_ns
        self._publisher = graph.publisher(Clock, "/clock", QoSProfile(depth=1), subscriptions=subscriptions)

    def tell(self) -> None:
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(self.now_ns, NS)
        self._publisher.publish(message)

    def go_on(self) -> None:
        self.now_ns += PERIOD // 5
        self.tell()


def test_simulated_time_sets_the_pace_and_may_stand_still(arm: Path) -> None:
    with Graph() as graph:
        scans = graph.collect(RawScan, "/arm/base/raw", BEST_EFFORT)
        with driver(arm, "base", use_sim_time=True, simulated__dropouts=False) as program:
            time = SimulatedTime(graph, 1000 * NS, 1)
            latest: dict[int, int] = {}

            def watch() -> None:
                latest.update({scan.scan: time.now_ns for scan in scans if scan.scan not in latest})
                time.go_on()

            graph.wait_until(lambda: len(scans) >= 10, "scans", watch)
            assert all(time.now_ns >= stamp_ns(scan) for scan in scans)
            assert all(stamp_ns(scan) > 1000 * NS for scan in scans)
            # Published no sooner than its latency after its stamp.
            assert all(now >= number * PERIOD + 800_000 for number, now in latest.items())
            count, last = len(scans), scans[-1].scan  # the clock stands still from here
            assert program.end() == 0
        assert len(scans) - count <= 1
        assert scans[-1].scan - last <= 1


def test_deactivation_on_a_standing_clock_ends_and_activation_goes_on_with_the_present(arm: Path) -> None:
    with Graph() as graph:
        scans = graph.collect(RawScan, "/arm/base/raw", BEST_EFFORT)
        with driver(arm, "base", use_sim_time=True) as program:
            time = SimulatedTime(graph, 1000 * NS, 1)
            graph.wait_until(lambda: len(scans) >= 5, "scans", time.go_on)
            assert graph.change_state(NODE.format("base"), Transition.TRANSITION_DEACTIVATE)
            count = len(scans)
            for _ in range(20):
                time.go_on()
                graph.receive()
            assert len(scans) == count
            assert graph.change_state(NODE.format("base"), Transition.TRANSITION_ACTIVATE)
            graph.wait_until(lambda: len(scans) >= count + 5, "further scans", time.go_on)
            assert scans[count].scan > scans[count - 1].scan + 3
            assert program.end() == 0


def test_time_that_goes_back_takes_the_ticks_with_it(arm: Path) -> None:
    with Graph() as graph:
        scans = graph.collect(RawScan, "/arm/base/raw", BEST_EFFORT)
        with driver(arm, "base", use_sim_time=True) as program:
            time = SimulatedTime(graph, 1000 * NS, 1)
            graph.wait_until(lambda: len(scans) >= 5, "scans", time.go_on)
            time.now_ns = 500 * NS
            graph.wait_until(lambda: sum(scan.scan < 600 * RATE for scan in scans) >= 5, "earlier scans", time.go_on)
            early = [scan.scan for scan in scans if scan.scan < 600 * RATE]
            assert early == sorted(early)
            assert program.end() == 0


def test_clock_that_leaps_leaves_ticks_out_and_counts_them(arm: Path) -> None:
    with Graph() as graph:
        graph.watch_diagnostics()
        scans = graph.collect(RawScan, "/arm/base/raw", BEST_EFFORT)
        with driver(arm, "base", use_sim_time=True, simulated__dropouts=False) as program:
            time = SimulatedTime(graph, 1000 * NS, 1)
            graph.wait_until(lambda: len(scans) >= 5, "scans", time.go_on)
            time.now_ns += NS
            graph.wait_until(lambda: len(scans) >= 10, "further scans", time.go_on)
            steps = np.diff([scan.scan for scan in scans])
            assert steps.max() > RATE // 2
            name = f"{NODE.format('base')}: pace"

            def counted() -> bool:
                latest = graph.latest(name)
                return latest is not None and int(values_of(latest)["ticks_missed"]) >= steps.max() - 1

            graph.wait_until(counted, "the count of missed ticks")
            late = [status for status in graph.diagnostics if status.name == name and status.message == "late"]
            assert late[0].level == b"\x01"
            assert program.end() == 0


def test_run_of_whole_cycles_ends_with_a_cycle(tmp_path: Path) -> None:
    content = scenario()
    content["motion"] = [{"kind": "rest", "duration": {"value": 0.2, "unit": "s"}}]
    content["duration"]["value"] = 0.2
    content["electronics"]["contamination"] = []
    arm = write_arm(tmp_path, content)
    with Graph() as graph:
        truth = graph.collect(PoseStamped, "/arm/truth/base")
        with driver(arm, "base", wait_for_subscribers=0, wait_for_other_subscribers=1, simulated__cycles=2) as program:
            assert program.wait() == 0
            graph.wait_until(lambda: stamp_ns(truth[-1]) // PERIOD % 20 == 19 if truth else False, "the last tick")
    ticks = [stamp_ns(pose) // PERIOD for pose in truth]
    assert ticks[-1] % 20 == 19
    assert 40 <= ticks[-1] - ticks[0] + 1 < 60


def test_stage_goes_where_it_is_told_and_moves_endpoint_and_last_posor(arm: Path) -> None:
    simulation = ArmSimulation(load_arm(arm))
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


def command(graph: Graph, goal: tuple[float, float, float], frame: str = "endpoint", late_s: float = 0.0) -> Any:
    message = Vector3Stamped()
    now_ns = graph.node.get_clock().now().nanoseconds - round(late_s * NS)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns, NS)
    message.header.frame_id = frame
    message.vector.x, message.vector.y, message.vector.z = goal
    return message


def test_commands_that_the_stage_cannot_follow_are_refused_and_reported(arm: Path) -> None:
    cases = (
        (
            (6e-4, 0.0, 0.0),
            "endpoint",
            0.0,
            "is (0.0006, 0, 0) m; expected at most 0.0005 m to either side, the stroke.",
        ),
        ((1e-4, 0.0, 0.0), "base", 0.0, "is in frame 'base'; expected 'endpoint'."),
        ((1e-4, 0.0, 0.0), "endpoint", 5.0, "after its stamp; expected a stamp within 0.5 s."),
    )
    with Graph() as graph:
        graph.watch_diagnostics()
        positions = graph.collect(Vector3Stamped, "/arm/stage/position")
        name = f"{NODE.format(LAST)}: input /arm/stage/command"
        with driver(arm, LAST, wait_for_subscribers=0) as program:
            commands = graph.publisher(Vector3Stamped, "/arm/stage/command")
            for number, (goal, frame, late_s, reason) in enumerate(cases, start=1):
                commands.publish(command(graph, goal, frame, late_s))
                status = status_with(graph, name, "refused", str(number))
                assert (status.message, status.level) == ("refused", b"\x01")
                assert values_of(status)["reason"].endswith(reason)
            count = len(positions)
            graph.wait_until(lambda: len(positions) > count + 5, "the stage's position")
            assert {tuple(vector(position)) for position in positions} == {(0.0, 0.0, 0.0)}
            assert program.end() == 0


def test_only_the_last_joint_listens_to_the_stage_and_only_if_there_is_one(tmp_path: Path) -> None:
    content = scenario()
    del content["stage"]
    (tmp_path / "without").mkdir()
    (tmp_path / "with").mkdir()
    arms = {
        folder: write_arm(tmp_path / folder, content if folder == "without" else None) for folder in ("with", "without")
    }
    with Graph() as graph:
        bases = graph.collect(RawScan, "/arm/base/raw", BEST_EFFORT)
        lasts = graph.collect(RawScan, f"/arm/{LAST}/raw", BEST_EFFORT)
        with driver(arms["with"], "base") as base, driver(arms["without"], LAST) as last:
            graph.wait_until(lambda: bool(bases and lasts), "scans of both")
            assert graph.node.count_subscribers("/arm/stage/command") == 0
            assert [program.end() for program in (base, last)] == [0, 0]
        with driver(arms["with"], LAST) as last:
            graph.wait_until(lambda: graph.node.count_subscribers("/arm/stage/command") == 1, "the stage's listener")
            assert last.end() == 0


@pytest.mark.parametrize("name", ["rate", "loop", "restamp", "start_offset", "stop_offset"])
def test_parameters_of_a_replay_are_refused_with_a_sentence(name: str) -> None:
    with pytest.raises(ParameterError) as refused:
        parameters_for({"source": "simulated", "simulated.arm": "arm.yaml", name: 1})
    assert str(refused.value) == (
        f"parameter '{name}': source 'simulated' is live, its scans happen when they happen; "
        "expected a recorded source, or none of the parameters of a replay."
    )


def test_parameter_of_a_replay_ends_the_program(arm: Path) -> None:
    with driver(arm, "base", loop=True) as program:
        assert program.wait() == 2
        (line,) = program.stderr
        assert line.startswith("parameter 'loop': source 'simulated' is live")


def test_joint_that_the_arm_does_not_have_is_refused(arm: Path, capfd: pytest.CaptureFixture[str]) -> None:
    sentence = f"parameter 'simulated.joint': 'wrist' is no joint of {arm}; expected one of base, shoulder, elbow."
    assert refusal(DriverNode, parameters_of(arm, "wrist"), capfd) == (2, [sentence])


def test_arm_without_scenario_is_refused(arm: Path, capfd: pytest.CaptureFixture[str]) -> None:
    text = arm.read_text(encoding="utf-8")
    arm.write_text(text.replace("scenario: scenario.yaml\n", ""), encoding="utf-8")
    sentence = f"{arm}, line 1: key 'scenario' is missing; expected the simulator's scenario file."
    assert refusal(DriverNode, parameters_of(arm, "base"), capfd) == (1, [sentence])
