# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The frames of an arm: their product is the endpoint of the same stamp; late viewers get what is fixed."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from ament_index_python.packages import get_package_share_path
from posor.chain.joint_measurements import MeasuredJoint
from posor.chain.kinematic_chain import load_chain
from posor.chain.robot_model import FreeJoint
from posor_estimator.chain_node import ChainNode
from posor_lab.harness.graph import Graph
from posor_lab.harness.in_process_nodes import run_refused_node
from posor_lab.harness.message_conversion import stamp_ns
from posor_ros.qos import LATCHED_QOS, TF_QOS
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from .chain_program import LOSSLESS, ChainRig, chain_node, lost_transform, transform_of

pytestmark = pytest.mark.usefixtures("ros_domain")

ARM = Path(__file__).resolve().parents[2] / "posor_bringup" / "arms" / "five_axis"
TYPE_HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
"""Of tf2_msgs/msg/TFMessage: endpoints with another hash do not understand each other."""
URDF, BEAMS = ARM / "five_axis.urdf", ARM / "beams.yaml"
MOVING: dict[str, object] = {"urdf": str(URDF), "beams": str(BEAMS), **LOSSLESS}


def small_pose(rng: np.random.Generator) -> pin.SE3:
    standard_deviations = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1.0])
    return pin.exp6(pin.Motion(standard_deviations * rng.normal(size=6)))


def second_of(frames: Any) -> int:
    return int(frames.transforms[0].header.stamp.sec)


def product(messages: Iterable[Any], endpoint: str) -> tuple[pin.SE3, str]:
    """Return the endpoint in the root of the tree that transforms make, and the name of the root."""
    parents = {each.child_frame_id: each for message in messages for each in message.transforms}
    T, frame = pin.SE3.Identity(), endpoint
    while frame in parents:
        shift, turn = parents[frame].transform.translation, parents[frame].transform.rotation
        T = pin.XYZQUATToSE3(np.array([shift.x, shift.y, shift.z, turn.x, turn.y, turn.z, turn.w])) * T
        frame = parents[frame].header.frame_id
    return T, frame


def send(publishers: dict[str, Any], joints: Iterable[FreeJoint], second: int, rng: np.random.Generator) -> None:
    for joint in joints:
        pose = joint.T_parent_joint * small_pose(rng)
        publishers[joint.name].publish(transform_of(second, pose, plates=(joint.parent, joint.child)))


def test_the_product_of_the_frames_is_the_pose_of_the_same_stamp() -> None:
    rng, chain = np.random.default_rng(9), load_chain(URDF, "endpoint", BEAMS)
    with chain_node(**MOVING) as node, Graph() as graph:
        frames = graph.collect(TFMessage, "/tf", TF_QOS)
        rig = ChainRig(graph)  # subscribes and waits after
        publishers = {joint.name: rig.joint_publisher(joint.name) for joint in chain.joints}
        send(publishers, chain.joints, 1, rng)
        graph.wait_until(lambda: bool(frames), "frames")
        for second in range(2, 8):
            send(publishers, chain.joints, second, rng)
            graph.wait_until(lambda: second_of(frames[-1]) == second, "new frames")  # noqa: B023
        lost, *others = chain.joints
        for joint in others:
            publishers[joint.name].publish(transform_of(8, joint.T_parent_joint, plates=(joint.parent, joint.child)))
        publishers[lost.name].publish(lost_transform(8, 1, plates=(lost.parent, lost.child)))
        rig.wait_for_message(f"no pose: {lost.name} is lost")
        send(publishers, chain.joints, 9, rng)
        graph.wait_until(lambda: second_of(frames[-1]) == 9, "frames after a lost scan")
        late_static = graph.collect(TFMessage, "/tf_static", LATCHED_QOS)
        late_description = graph.collect(String, "robot_description", LATCHED_QOS)
        graph.wait_until(lambda: bool(late_static and late_description), "what is fixed")
        assert node.end() == 0
    poses = {stamp_ns(pose): pose.pose for pose in rig.poses}
    assert [second_of(message) for message in frames] == [1, 2, 3, 4, 5, 6, 7, 9]
    for message in frames:
        assert {stamp_ns(each) for each in message.transforms} == {stamp_ns(message.transforms[0])}
        T_base_endpoint, root = product([message, *late_static], "endpoint")
        assert root == "base"
        at, turn = poses[stamp_ns(message.transforms[0])].position, poses[stamp_ns(message.transforms[0])].orientation
        expected = pin.XYZQUATToSE3(np.array([at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w]))
        np.testing.assert_allclose(T_base_endpoint.homogeneous, expected.homogeneous, rtol=0.0, atol=1e-12)
    assert late_description[-1].data == URDF.read_text(encoding="utf-8")


def test_a_beam_off_the_way_to_the_endpoint_has_its_frame_without_sag() -> None:
    chain = load_chain(URDF, "shoulder_receiving", BEAMS)
    estimator = chain.estimator()
    estimator.set_measurements({joint.name: MeasuredJoint(joint.T_parent_joint) for joint in chain.joints})
    assert estimator.estimate()
    _, *others = zip(chain.beams, estimator.beam_transforms, strict=True)
    assert others
    for beam, transform in others:
        np.testing.assert_allclose(transform, pin.SE3ToXYZQUAT(beam.T_start_end), rtol=0.0, atol=1e-15)


def test_a_rate_whose_period_has_no_end_is_refused(capfd: pytest.CaptureFixture[str]) -> None:
    sentence = "node /chain_node, parameter 'tf_rate': 1e-12 is wrong; expected 0, or at least 0.01."
    assert run_refused_node(ChainNode, {"urdf": str(URDF), "tf_rate": 1e-12}, capfd) == (2, [sentence])


def test_the_message_has_the_type_hash_of_an_official_jazzy() -> None:
    path = get_package_share_path("tf2_msgs") / "msg" / "TFMessage.json"
    hashes = {each["type_name"]: each["hash_string"] for each in json.loads(path.read_text())["type_hashes"]}
    assert hashes["tf2_msgs/msg/TFMessage"] == TYPE_HASH


def test_without_a_rate_nothing_is_published() -> None:
    with chain_node(**{**MOVING, "tf_rate": 0.0}), Graph() as graph:
        ChainRig(graph)
        topics = {name for name, _ in graph.node.get_topic_names_and_types()}
    assert not topics & {"/tf", "/tf_static", "/robot_description"}


def test_a_rate_limits_the_frames() -> None:
    rng, chain = np.random.default_rng(9), load_chain(URDF, "endpoint", BEAMS)
    with chain_node(**MOVING, tf_rate=0.01) as node, Graph() as graph:
        frames = graph.collect(TFMessage, "/tf", TF_QOS)
        rig = ChainRig(graph)  # subscribes and waits after
        publishers = {joint.name: rig.joint_publisher(joint.name) for joint in chain.joints}
        for second in range(1, 4):
            send(publishers, chain.joints, second, rng)
        graph.wait_until(lambda: bool(frames) and len(rig.poses) == 3, "frames and poses")
        assert node.end() == 0
    assert [second_of(message) for message in frames] == [1]


def test_a_prefix_stands_before_all_frames() -> None:
    rng, chain = np.random.default_rng(9), load_chain(URDF, "endpoint", BEAMS)
    with chain_node(**MOVING, frame_prefix="cell1/") as node, Graph() as graph:
        frames = graph.collect(TFMessage, "/tf", TF_QOS)
        rig = ChainRig(graph)  # subscribes and waits after
        publishers = {joint.name: rig.joint_publisher(joint.name) for joint in chain.joints}
        static = graph.collect(TFMessage, "/tf_static", LATCHED_QOS)
        send(publishers, chain.joints, 1, rng)
        graph.wait_until(lambda: bool(frames and static and rig.states and rig.poses), "frames and the endpoint")
        assert node.end() == 0
    assert product([frames[0], *static], "cell1/endpoint")[1] == "cell1/base"
    names = {
        name
        for each in (*frames[0].transforms, *static[0].transforms)
        for name in (each.header.frame_id, each.child_frame_id)
    }
    assert all(name.startswith("cell1/") for name in names)
    assert rig.poses[0].header.frame_id == "cell1/base"
    state = rig.states[-1]
    assert (state.header.frame_id, state.child_frame_id) == ("cell1/base", "cell1/endpoint")


@pytest.mark.parametrize("prefix", ["/cell1/", "cell 1/"])
def test_a_prefix_that_tf2_refuses_is_refused(prefix: str, capfd: pytest.CaptureFixture[str]) -> None:
    code, (sentence,) = run_refused_node(ChainNode, {"urdf": str(URDF), "frame_prefix": prefix}, capfd)
    assert (code, "frame_prefix" in sentence) == (2, True)


def test_fixed_frames_are_those_of_the_urdf() -> None:
    """Every link but the root is the child of one frame: a fixed joint, a POSOR, or a beam."""
    chain = load_chain(URDF, "endpoint", BEAMS)
    children = [each.child for each in chain.fixed_transforms]
    children += [each.child for each in (*chain.joints, *chain.beam_joints)]
    model = pin.buildModelFromUrdf(str(URDF))
    links = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
    assert len(children) == len(set(children))
    assert set(children) == links - {chain.base_frame}
