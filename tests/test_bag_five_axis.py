# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The bag of the simulated five-axis arm: what its script makes, and what the nodes make of it, bit for bit."""

from __future__ import annotations

import subprocess
import sys
from contextlib import ExitStack
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor.bags.reprocess_command import main as reprocess
from posor.chain.arm_file import DriverFile
from posor.numerics.array_types import FloatArray
from posor_bringup.arm_programs import arm_programs
from posor_bringup.arms import load_checked_arm
from posor_bringup.supervisor import Parameter
from posor_lab.harness.graph import Graph, wait_for_value
from posor_lab.harness.message_conversion import stamp_ns
from posor_lab.harness.program import Program
from posor_msgs.msg import JointTransform, RawScan
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from bags.make_arm_bag import arm_endpoints
from tests.rig_messages import all_message_bits, message_bits, read_bag_messages

BAGS = Path(__file__).resolve().parents[1] / "bags"
BAG = BAGS / "five_axis"
JOINTS = ("base_swivel", "shoulder", "elbow", "wrist_roll", "wrist_yaw")
RAW = {joint: f"/five_axis/{joint}/raw" for joint in JOINTS}
POSE = "/five_axis/endpoint/pose"
TYPES = {
    **dict.fromkeys(RAW.values(), RawScan),
    POSE: PoseStamped,
    "/five_axis/truth/endpoint": PoseStamped,
    "/five_axis/target/endpoint": PoseStamped,
    "/five_axis/encoders": JointState,
}
OTHERS = {  # what the nodes publish beside the endpoint
    **{f"/five_axis/{joint}/transform": JointTransform for joint in JOINTS},
    "/five_axis/joint_states": JointState,
}
TICKS, RATE, START_NS = 2000, 200, 1_767_225_600_000_000_000
LOSSLESS: dict[str, Parameter] = {"lossless": True}
WITHIN = 1e-12  # what another machine's arithmetic may differ by, in metres, radians and quaternions


@cache
def messages(bag: Path) -> dict[str, list[Any]]:
    return {
        topic: [deserialize_message(data, TYPES[topic]) for data in all_]
        for topic, all_ in read_bag_messages(bag).items()
    }


def leaves(message: Any) -> list[Any]:
    if hasattr(message, "get_fields_and_field_types"):
        return [leaf for name in message.get_fields_and_field_types() for leaf in leaves(getattr(message, name))]
    return [message] if isinstance(message, int | float | str) else list(message)


def parts(messages_: list[Any]) -> tuple[list[str], FloatArray]:
    every = [leaf for message in messages_ for leaf in leaves(message)]
    return [leaf for leaf in every if isinstance(leaf, str)], np.array([x for x in every if not isinstance(x, str)])


@pytest.mark.long
def test_the_script_makes_the_committed_bag_and_the_same_bytes_each_time(tmp_path: Path) -> None:
    for run in ("one", "other"):
        subprocess.run([sys.executable, str(BAGS / "make_arm_bag.py"), str(tmp_path / run)], check=True)
    for name in ("five_axis_0.mcap", "metadata.yaml"):
        one, other = (tmp_path / run / "five_axis" / name for run in ("one", "other"))
        assert one.read_bytes() == other.read_bytes()
    made, committed = messages(tmp_path / "one" / "five_axis"), messages(BAG)
    assert {topic: len(all_) for topic, all_ in made.items()} == {topic: len(all_) for topic, all_ in committed.items()}
    for topic, all_ in made.items():
        (texts, numbers), (known_texts, known_numbers) = parts(all_), parts(committed[topic])
        assert texts == known_texts
        np.testing.assert_allclose(numbers, known_numbers, rtol=WITHIN, atol=WITHIN, err_msg=topic)


@pytest.mark.long
def test_the_bag_holds_one_cycle_of_the_scenario() -> None:
    assert sum(path.stat().st_size for path in BAG.iterdir()) < 4_000_000
    held = messages(BAG)
    assert set(held) == set(TYPES)
    stamps = [START_NS + n * 1_000_000_000 // RATE for n in range(TICKS)]
    for topic in ("/five_axis/truth/endpoint", "/five_axis/target/endpoint", "/five_axis/encoders"):
        assert [stamp_ns(message) for message in held[topic]] == stamps
    for topic in RAW.values():
        sent = [stamp_ns(scan) for scan in held[topic]]
        assert set(sent) <= set(stamps)
        assert len(sent) > 0.99 * TICKS
        assert all(scan.scan == stamp_ns(scan) * RATE // 1_000_000_000 for scan in held[topic])
        assert all(scan.status & RawScan.STATUS_SIMULATED for scan in held[topic])
    assert sum(len(held[topic]) for topic in RAW.values()) < TICKS * len(JOINTS)  # the scenario drops some
    assert 0.98 * TICKS < len(held[POSE]) < TICKS
    truths = {stamp_ns(message): message.pose.position for message in held["/five_axis/truth/endpoint"]}
    errors = [
        [getattr(pose.pose.position, axis) - getattr(truths[stamp_ns(pose)], axis) for axis in "xyz"]
        for pose in held[POSE]
    ]
    assert 1e-6 < np.sqrt(np.mean(np.sum(np.square(errors), axis=1))) < 2e-5


def test_the_scans_of_the_bag_give_its_poses() -> None:
    known = messages(BAG)[POSE]
    estimated = arm_endpoints(load_checked_arm("five_axis"), {joint: messages(BAG)[RAW[joint]] for joint in JOINTS})
    assert [stamp_ns(pose) for pose in known] == estimated.stamps_ns.tolist()
    np.testing.assert_allclose([leaves(pose.pose) for pose in known], estimated.poses, rtol=0.0, atol=WITHIN)


@pytest.mark.long
@pytest.mark.usefixtures("ros_domain")
def test_the_bag_replays_bit_for_bit(tmp_path: Path) -> None:
    assert reprocess([str(BAG), "--arm", "five_axis", "--output", str(tmp_path / "out")]) == 0
    offline = read_bag_messages(tmp_path / "out")
    assert set(offline) == {*OTHERS, POSE, f"{POSE}_with_covariance"}
    arm = load_checked_arm("five_axis")
    parameters: dict[str, Parameter] = {
        "bag.path": str(BAG),
        "bag.topic": "/{arm}/{joint}/raw",
        "rate": 0.0,
        "wait_for_subscribers": 2,
    }
    arm = replace(arm, driver=DriverFile(source="bag", parameters=parameters))
    programs = arm_programs(arm, chain_parameters={"max_wait": 60.0}, parameters=LOSSLESS)
    listeners, drivers = programs[: -len(JOINTS)], programs[-len(JOINTS) :]
    raw = read_bag_messages(BAG)
    with ExitStack() as stack, Graph() as graph:
        running = [stack.enter_context(Program(program.command())) for program in listeners]
        graph.watch_diagnostics()
        poses = graph.collect(PoseStamped, POSE)
        with_covariance = graph.collect(PoseWithCovarianceStamped, f"{POSE}_with_covariance")
        others = {topic: graph.collect(kind, topic, raw=True) for topic, kind in OTHERS.items()}
        for topic in ("endpoint/pose", "endpoint/pose_with_covariance", "joint_states"):
            wait_for_value(graph, "/five_axis/chain_node: listeners", topic, "1")
        for joint in JOINTS:
            wait_for_value(graph, f"/five_axis/{joint}/posor_node: listeners", "transform", "2")
        # The drivers wait for this test too, which listens once all else does.
        replaying = [stack.enter_context(Program(program.command())) for program in drivers]
        scans = {topic: graph.collect(RawScan, topic, raw=True) for topic in RAW.values()}
        raw_messages = {joint: messages(BAG)[topic] for joint, topic in RAW.items()}
        expected = arm_endpoints(load_checked_arm("five_axis"), raw_messages)
        graph.wait_until(lambda: all(len(scans[topic]) == len(raw[topic]) for topic in scans), "all scans")
        graph.wait_until(lambda: len(poses) == len(with_covariance) == len(expected), "all poses")
        graph.wait_until(lambda: all(len(others[topic]) == len(offline[topic]) for topic in OTHERS), "all else")
        assert [program.wait() for program in replaying] == [0] * len(JOINTS)
        assert [program.end() for program in running] == [0] * len(running)
    for topic, received in scans.items():
        assert received == raw[topic]
    times = expected.stamps_ns.tolist()
    assert [stamp_ns(pose) for pose in poses] == times
    expected_poses = zip(expected.poses, expected.covariances(), strict=True)
    for pose, full, (endpoint, covariance) in zip(poses, with_covariance, expected_poses, strict=True):
        assert message_bits(pose.pose) == message_bits(full.pose.pose)
        assert message_bits(leaves(pose.pose)) == endpoint.tobytes()
        assert message_bits(full.pose.covariance) == covariance.tobytes()
        assert message_bits(pose.header) == message_bits(full.header)
    for topic, kind in OTHERS.items():
        assert all_message_bits(kind, others[topic]) == all_message_bits(kind, offline[topic]), topic
    assert all_message_bits(PoseStamped, offline[POSE]) == [message_bits(pose) for pose in poses]
    full_poses = all_message_bits(PoseWithCovarianceStamped, offline[f"{POSE}_with_covariance"])
    assert full_poses == [message_bits(pose) for pose in with_covariance]
