# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Nodes of one process: results equal to separate processes, shutdown, statistics."""

from __future__ import annotations

import math
import signal
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from lifecycle_msgs.msg import Transition
from posor.bags.reprocess_command import main as reprocess
from posor.chain.arm_file import DriverFile
from posor.errors import ParameterError
from posor.node_parameters import NodeParameters
from posor.numerics.stamps import NS
from posor_bringup.arm_programs import Layout, arm_programs, group_programs
from posor_bringup.arms import load_checked_arm
from posor_bringup.supervisor import Parameter
from posor_estimator.composition_file import NodeEntry
from posor_lab.harness.graph import Graph, values_of, wait_for_value
from posor_lab.harness.message_conversion import is_usable, stamp_ns
from posor_lab.harness.program import Program
from posor_msgs.msg import EndpointState, JointTransform
from posor_ros.node_program import NodeGroup
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from tests.composed_rig import COMPOSE, NODES, RIG, write_composition
from tests.rig_messages import all_message_bits, read_bag_messages

pytestmark = pytest.mark.usefixtures("ros_domain")

BAG = Path(__file__).resolve().parents[1] / "bags" / "five_axis"
BAG_START_NS = 1_767_225_600 * NS
JOINTS = ("base_swivel", "shoulder", "elbow", "wrist_roll", "wrist_yaw")
LOSSLESS: dict[str, Parameter] = {"lossless": True}
TICKS, SPAN_S = 200, 0.999
TOPICS = {
    **{f"/five_axis/{joint}/transform": JointTransform for joint in JOINTS},
    "/five_axis/endpoint/pose": PoseStamped,
    "/five_axis/endpoint/pose_with_covariance": PoseWithCovarianceStamped,
    "/five_axis/joint_states": JointState,
}


def replay(folder: Path, layout: Layout) -> dict[str, list[object]]:
    """Replay a second of the five-axis arm's bag; return the bits of the published messages, by topic."""
    bag: dict[str, Parameter] = {
        "bag.path": str(BAG),
        "bag.topic": "/{arm}/{joint}/raw",
        "rate": 0.0,
        "stop_offset": SPAN_S,
        "wait_for_subscribers": 1,
        "on_end": "stay",
        "autostart": False,
    }
    arm = replace(load_checked_arm("five_axis"), driver=DriverFile(source="bag", parameters=bag))
    programs = arm_programs(arm, chain_parameters={"max_wait": 60.0}, parameters=LOSSLESS)
    folder.mkdir()
    with ExitStack() as stack, Graph() as graph:
        running = [stack.enter_context(Program(each.command())) for each in group_programs(programs, layout, folder)]
        assert len(running) == {"drivers_apart": 2, "composed": 1}[layout]
        graph.watch_diagnostics()
        received = {topic: graph.collect(kind, topic, raw=True) for topic, kind in TOPICS.items()}
        for program in programs[: -len(JOINTS)]:
            graph.wait_for_status(f"/five_axis/{program.name}: lifecycle", "active")
        for joint in JOINTS:
            wait_for_value(graph, f"/five_axis/{joint}/posor_node: listeners", "transform", "2")
        for topic in ("endpoint/pose", "endpoint/pose_with_covariance", "joint_states"):
            wait_for_value(graph, "/five_axis/chain_node: listeners", topic, "1")
        for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            for joint in JOINTS:
                assert graph.change_state(f"/five_axis/{joint}/driver_node", transition)
        stamps = []
        for joint in JOINTS:
            ended = graph.wait_for_status(f"/five_axis/{joint}/driver_node: source", "ended")
            count, transforms = int(values_of(ended)["scans_published"]), received[f"/five_axis/{joint}/transform"]
            graph.wait_until(partial(has_count, transforms, count), f"{count} transforms of {joint}")
            messages = [deserialize_message(data, JointTransform) for data in transforms]
            stamps.append({stamp_ns(message) for message in messages if is_usable(message)})
        complete = len(set.intersection(*stamps))
        assert 0.9 * TICKS < complete <= TICKS
        for topic in received.keys() - {f"/five_axis/{joint}/transform" for joint in JOINTS}:
            graph.wait_until(partial(has_count, received[topic], complete), f"{complete} messages of {topic}")
        assert [program.end() for program in running] == [0] * len(running)
        assert [program.stderr for program in running if "rror" in " ".join(program.stderr)] == []
    return {topic: all_message_bits(TOPICS[topic], messages) for topic, messages in received.items()}


def has_count(messages: list[bytes], count: int) -> bool:
    return len(messages) == count


def reprocess_second(folder: Path) -> dict[str, list[object]]:
    """Return the bits of the reprocessed messages of that second; test_bag_five_axis compares them with nodes."""
    assert reprocess([str(BAG), "--arm", str(load_checked_arm("five_axis").path), "--output", str(folder)]) == 0
    end_ns = BAG_START_NS + round(SPAN_S * 1e9)
    messages = read_bag_messages(folder)
    bits = {}
    for topic, kind in TOPICS.items():
        stamps = [stamp_ns(deserialize_message(data, kind)) for data in messages[topic]]
        bits[topic] = all_message_bits(
            kind, [data for data, stamp in zip(messages[topic], stamps, strict=True) if stamp <= end_ns]
        )
    return bits


@pytest.mark.parametrize("layout", ["composed", pytest.param("drivers_apart", marks=pytest.mark.long)])
def test_the_results_are_the_same_in_every_layout(tmp_path: Path, layout: Layout) -> None:
    assert replay(tmp_path / layout, layout) == reprocess_second(tmp_path / "offline")


def ends_cleanly(program: Program, graph: Graph, number: signal.Signals) -> bool:
    """End a composition and wait until its nodes have left the graph; return whether it ended without errors."""
    code = program.end(number)
    graph.wait_until(lambda: not set(NODES) & node_names(graph), "the end of all nodes")
    return code == 0 and program.errors == []


@pytest.mark.long
def test_all_nodes_end_at_a_signal(tmp_path: Path) -> None:
    with Program([*COMPOSE, str(write_composition(tmp_path, RIG))]) as program, Graph() as graph:
        graph.watch_diagnostics()
        poses = graph.collect(PoseStamped, "/rig/endpoint/pose")
        graph.wait_until(lambda: len(poses) > 3, "poses")
        for name in NODES:
            assert graph.state(name) == "active"
            graph.wait_for_status(f"{name}: lifecycle", "active")
        assert ends_cleanly(program, graph, signal.SIGINT)


def test_the_chain_receives_the_fault_effects_of_a_joint_of_its_process(tmp_path: Path) -> None:
    with Program([*COMPOSE, str(write_composition(tmp_path, RIG))]), Graph() as graph:
        states = graph.collect(EndpointState, "/rig/endpoint/state")
        graph.wait_until(
            lambda: bool(states) and not any(map(math.isnan, states[-1].protection_level)), "a protection level"
        )
        assert all(each.startswith("joint1: ") for each in states[-1].protection_causes)
        graph.wait_until(  # discovery tells of the end of a subscription later
            lambda: graph.node.count_subscribers("/rig/joint1/transform") == 0,
            "the end of the chain's subscription over DDS",
        )


class StoppedNode:
    parameters = NodeParameters()

    def __init__(self, name: str, log: list[str]) -> None:
        self.name, self.log = name, log

    def stop(self) -> None:
        self.log.append(self.name)


def test_nodes_stop_in_the_reverse_order_also_after_a_failure() -> None:
    log: list[str] = []

    def fail() -> None:
        with NodeGroup() as nodes:
            for name in ("chain", "posor", "driver"):
                node: Any = StoppedNode(name, log)
                nodes.add(node)
            raise ParameterError("is wrong")

    with pytest.raises(ParameterError):
        fail()
    assert log == ["driver", "posor", "chain"]


def node_names(graph: Graph) -> set[str]:
    return {f"{space}/{name}" for name, space in graph.node.get_node_names_and_namespaces()}


def test_the_end_of_one_node_leaves_the_others_running(tmp_path: Path) -> None:
    text = RIG.replace("loop: true", "rate: 50.0")
    with Program([*COMPOSE, str(write_composition(tmp_path, text))]) as program, Graph() as graph:
        graph.wait_until(lambda: set(NODES[:2]) <= node_names(graph), "the nodes")
        graph.wait_until(lambda: NODES[2] not in node_names(graph), "the end of the driver")
        assert graph.state(NODES[0]) == graph.state(NODES[1]) == "active"
        assert program.end() == 0


def test_a_node_that_is_shut_down_ends_the_process_with_its_name(tmp_path: Path) -> None:
    with Program([*COMPOSE, str(write_composition(tmp_path, RIG))]) as program, Graph() as graph:
        graph.wait_until(lambda: set(NODES) <= node_names(graph), "the nodes")
        graph.wait_until(lambda: graph.state(NODES[0]) == "active", "the start")
        assert graph.change_state(NODES[0], Transition.TRANSITION_ACTIVE_SHUTDOWN)
        assert program.wait() == 1
        assert program.errors[-1].startswith(f"node {NODES[0]}: was shut down by its lifecycle")


@pytest.mark.long
def test_the_diagnostics_have_statistics_and_sigterm_ends_all_nodes(tmp_path: Path) -> None:
    text = RIG.replace("session: ymo}", "session: ymo, limits: {latency: 1.0e-9, jitter: 1.0e-9}}")
    with Program([*COMPOSE, str(write_composition(tmp_path, text))]) as program, Graph() as graph:
        graph.watch_diagnostics()
        late = graph.wait_for_status(f"{NODES[1]}: timing", "latency above 1e-09 s; period off its mean by more than")
        assert late.level == b"\x01"
        for name in NODES:
            graph.wait_until(partial(has_figures, graph, name, "period"), f"period of {name}")
            figures = values_of(graph.latest(f"{name}: timing"))
            low, mean, high = (float(figures[f"period_{key}"]) for key in ("min", "mean", "max"))
            assert 0.0 < low <= mean <= high
            assert 0.0 <= float(figures["period_sd"]) < 1.0
        for name in NODES[:2]:
            graph.wait_until(partial(has_figures, graph, name, "latency"), f"latency of {name}")
        process = values_of(graph.wait_for_status(f"{NODES[0]}: process", "ok"))
        assert int(process["gc_collections"]) >= 1
        assert 0.0 <= float(process["gc_longest_pause"]) < 1.0
        assert ends_cleanly(program, graph, signal.SIGTERM)


def has_figures(graph: Graph, name: str, what: str) -> bool:
    status = graph.latest(f"{name}: timing")
    figures = {} if status is None else values_of(status)
    return f"{what}_max" in figures and float(figures[f"{what}_min"]) <= float(figures[f"{what}_max"])


def test_an_entry_becomes_the_command_line_of_its_node() -> None:
    entry = NodeEntry(
        node="driver_node",
        name="left",
        namespace="/a/b",
        parameters={"bag": {"path": "x y", "other_topics": ["/u", "/v"]}, "rate": 1e-7, "stop_offset": math.inf},
        remappings={"raw": "scans"},
    )
    assert entry.full_name == "/a/b/left"
    assert entry.arguments() == [
        *("--ros-args", "-r", "__ns:=/a/b", "-r", "__node:=left", "-r", "raw:=scans"),
        *("-p", 'bag.path:="x y"', "-p", 'bag.other_topics:=["/u", "/v"]'),
        *("-p", "rate:=1e-07", "-p", "stop_offset:=.inf"),
    ]
