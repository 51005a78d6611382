# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""chain_node as a program: its endpoint, refusals and diagnostics."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from lifecycle_msgs.msg import Transition
from posor_estimator.chain_node import ChainNode
from posor_lab.harness.graph import Graph, set_stamp, stamp_seconds, values_of
from posor_lab.harness.in_process_nodes import run_refused_node
from posor_msgs.msg import EndpointState, JointTransform

from .chain_program import LOSSLESS, TURN, URDF, ChainRig, call_set_home, chain_node, lost_transform, transform_of

pytestmark = pytest.mark.usefixtures("ros_domain")

BEAM_M = 0.84836


def test_a_missing_parameter_ends_the_program_with_one_sentence() -> None:
    with chain_node() as node:
        assert (node.wait(), node.stdout) == (2, [])
        (sentence,) = node.stderr
        assert sentence.startswith("node /chain_node, parameter 'urdf': is not set; expected a string: path of ")


def test_an_invalid_urdf_or_parameter_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    missing, blind = tmp_path / "none.urdf", tmp_path / "blind.urdf"
    blind.write_text(URDF.read_text(encoding="utf-8").replace('type="floating"', 'type="fixed"'), encoding="utf-8")
    for parameters, code, said in (
        (
            {"urdf": str(missing)},
            1,
            f"URDF {missing}: cannot be read: No such file or directory; expected a robot desc",
        ),
        ({"urdf": str(tmp_path)}, 1, f"URDF {tmp_path}: cannot be read: Is a directory"),
        ({"urdf": str(blind)}, 1, f"URDF {blind}: has no POSOR joint"),
        ({"urdf": str(URDF), "endpoint_frame": "hand"}, 1, f"URDF {URDF}: has no link 'hand'"),
        ({"urdf": str(URDF), "reference": "relative"}, 2, "node /chain_node, parameter 'reference': "),
    ):
        found, (sentence,) = run_refused_node(ChainNode, parameters, capfd)
        assert found == code
        assert sentence.startswith(said)


class SingleJointRig(ChainRig):
    """A chain_node with one joint, shared by several tests; stamps rise from test to test."""

    def __init__(self, graph: Graph) -> None:
        super().__init__(graph)
        self.publisher = self.joint_publisher("joint1")
        self.start_s = 0

    def send(self, message: Any, second: int) -> None:
        """Publish a transform with a stamp in seconds after the start of this test."""
        self.publisher.publish(set_stamp(message, self.start_s + second))

    def has_seconds(self, expected: list[int]) -> bool:
        """Return whether the stamps of all received messages are these seconds of this test."""
        topics = (self.poses, self.with_covariance, self.joint_states)
        return all(stamp_seconds(messages) == [self.start_s + second for second in expected] for messages in topics)


@pytest.fixture(scope="module")
def shared_rig() -> Iterator[SingleJointRig]:
    """One node for all tests without parameters of their own."""
    with chain_node(urdf=str(URDF), **LOSSLESS) as node, Graph() as graph:
        yield SingleJointRig(graph)
        assert node.end() == 0


@pytest.fixture
def rig(shared_rig: SingleJointRig) -> SingleJointRig:
    shared_rig.clear()
    shared_rig.start_s += 100
    return shared_rig


def test_the_endpoint_has_the_scans_stamp_its_frames_and_its_covariance(rig: SingleJointRig) -> None:
    turn = pin.SE3(pin.utils.rotate("z", 0.01), np.array([1e-4, 2e-4, 3e-4]))
    rig.send(transform_of(7, turn), 7)
    rig.wait_for_poses(1)
    [pose], [with_covariance], [joints] = rig.poses, rig.with_covariance, rig.joint_states
    for message in (pose, with_covariance, joints):
        assert (message.header.stamp.sec, message.header.stamp.nanosec) == (rig.start_s + 7, 250_000_000)
    assert pose.header.frame_id == with_covariance.header.frame_id == "machining_centre"
    # The rig's Z is -Y of the machining centre; the beam is along -X of the target.
    x, y, z = 1e-4 - BEAM_M * math.cos(0.01), 2e-4 - BEAM_M * math.sin(0.01), 3e-4
    position = pose.pose.position
    np.testing.assert_allclose([position.x, position.y, position.z], [x, -z, y], rtol=0.0, atol=1e-12)
    orientation = pose.pose.orientation
    expected = pin.Quaternion(pin.utils.rotate("x", math.pi / 2.0) @ pin.utils.rotate("z", 0.01)).coeffs()
    got = np.array([orientation.x, orientation.y, orientation.z, orientation.w])
    np.testing.assert_allclose(got * np.sign(got[3]), expected * np.sign(expected[3]), rtol=0.0, atol=1e-12)
    assert with_covariance.pose.pose == pose.pose
    covariance = np.reshape(with_covariance.pose.covariance, (6, 6))
    # Theta's 2 urad at the joint are a turn about -Y of the machining centre, and move the beam's end along its Z.
    assert covariance[4, 4] == pytest.approx(4e-12, rel=1e-9)
    assert covariance[2, 2] == pytest.approx((1.0 + 4.0 * (BEAM_M * math.cos(0.01)) ** 2) * 1e-12, rel=1e-9)
    assert (list(joints.name), list(joints.position)) == (["joint1"], [pytest.approx(TURN + 0.01)])
    status = rig.graph.wait_for_status("/chain_node: endpoint", "ok")
    assert values_of(status)["joints"] == "joint1"


REFUSED = "scans_refused", "transforms_refused"
UNUSABLE: list[tuple[dict[str, Any], str]] = [
    ({"state": JointTransform.STATE_LOST, "faults": JointTransform.FAULT_DARK_DIODE}, "joint1 is lost (DARK_DIODE)"),
    ({"state": JointTransform.STATE_UNCOUNTED, "faults": JointTransform.FAULT_COUNT}, "joint1 is uncounted (COUNT)"),
    ({"pose.position.y": math.nan}, "joint1 has a pose"),
    ({"pose.orientation.w": 0.0}, "joint1 has an orientation"),
    ({"covariance_systematic": [math.inf] * 36}, "joint1 has a covariance"),
    ({"child_frame_id": "another_plate"}, "joint1: transforms from 'posor_receiving' to 'another_plate'"),
]


@pytest.mark.parametrize(("fields", "reason"), UNUSABLE)
def test_an_unusable_transform_gives_no_pose_and_is_reported(
    rig: SingleJointRig, fields: dict[str, Any], reason: str
) -> None:
    rig.send(transform_of(1), 1)
    rig.wait_for_poses(1)
    before = sum(map(rig.count_of, REFUSED))
    unusable = transform_of(2)
    for path, value in fields.items():
        *way, name = path.split(".")
        setattr(reduce(getattr, way, unusable), name, value)
    rig.send(unusable, 2)
    assert rig.wait_for_message(f"no pose: {reason}").level == b"\x02"
    rig.send(transform_of(3), 3)
    rig.wait_for_poses(2)
    assert rig.has_seconds([1, 3])
    assert sum(map(rig.count_of, REFUSED)) == before + 1


def test_a_degraded_joint_gives_a_pose_and_a_warning(rig: SingleJointRig) -> None:
    degraded = transform_of(1)
    degraded.state = JointTransform.STATE_DEGRADED
    rig.send(degraded, 1)
    rig.wait_for_poses(1)
    assert rig.graph.wait_for_status("/chain_node: endpoint", "degraded: joint1").level == b"\x01"


def test_a_joint_that_waits_for_its_home_mark_is_a_warning_however_long(rig: SingleJointRig) -> None:
    waiting = transform_of(1)
    waiting.state = JointTransform.STATE_UNCOUNTED
    sentence = "no pose: joint1 is waiting for the home mark"
    for second in (1, 2, 3):
        rig.send(waiting, second)
        assert rig.wait_for_message(sentence).level == b"\x01"
    rig.send(transform_of(4), 4)
    rig.wait_for_poses(1)
    rig.graph.wait_for_status("/chain_node: endpoint", "ok")
    levels = {status.level for status in rig.graph.diagnostics if status.message.startswith(sentence)}
    assert levels == {b"\x01"}


def test_losses_before_a_joint_is_counted_are_no_fault_afterwards() -> None:
    """At a wrong bump of a ring readings contradict each other now and then."""
    waiting = transform_of(1)
    waiting.state = JointTransform.STATE_UNCOUNTED
    with chain_node(urdf=str(URDF), **{**LOSSLESS, "alarm_count": 3}), Graph() as graph:
        rig = SingleJointRig(graph)
        for second in range(1, 30, 2):
            rig.send(lost_transform(second, JointTransform.FAULT_RESIDUAL), second)
            rig.send(waiting, second + 1)
        rig.send(lost_transform(40, JointTransform.FAULT_RESIDUAL), 40)  # a false alarm
        assert rig.wait_for_message("no pose: joint1 is lost").level == b"\x01"
        rig.send(transform_of(41), 41)
        rig.wait_for_poses(1)
        assert graph.wait_for_status("/chain_node: endpoint", "ok").level == b"\x00"


def test_poses_are_relative_to_the_first_pose_or_to_the_last_set_home() -> None:
    with chain_node(urdf=str(URDF), reference="home", **LOSSLESS), Graph() as graph:
        chain = ChainRig(graph)
        joint = chain.joint_publisher("joint1")
        assert call_set_home(graph) == (False, "there is no pose now to take as home")
        up = pin.SE3(np.eye(3), np.array([0.0, 1e-3, 0.0]))
        joint.publish(transform_of(1))
        joint.publish(transform_of(2, up))
        chain.wait_for_poses(2)
        assert {pose.header.frame_id for pose in chain.poses} == {"endpoint_home"}
        heights = [[p.pose.position.x, p.pose.position.y, p.pose.position.z] for p in chain.poses]
        # The endpoint's axes at home are those of the target plate: Y of the plate is up.
        np.testing.assert_allclose(heights, [[0.0, 0.0, 0.0], [0.0, 1e-3, 0.0]], rtol=0.0, atol=1e-15)
        assert call_set_home(graph) == (True, "home is the endpoint's last pose")
        joint.publish(transform_of(3, up))
        joint.publish(transform_of(4))
        chain.wait_for_poses(4)
        heights = [[p.pose.position.x, p.pose.position.y, p.pose.position.z] for p in chain.poses[2:]]
        np.testing.assert_allclose(heights, [[0.0, 0.0, 0.0], [0.0, -1e-3, 0.0]], rtol=0.0, atol=1e-15)
        for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE):
            assert graph.change_state("/chain_node", transition)
            assert call_set_home(graph) == (False, "there is no pose now to take as home")  # the arm may have moved
        joint.publish(lost_transform(5, JointTransform.FAULT_RESIDUAL))
        graph.wait_until(lambda: any(s.state == EndpointState.STATE_LOST for s in chain.states), "the loss")
        assert call_set_home(graph) == (False, "there is no pose now to take as home")


def test_poses_relative_to_a_degraded_home_or_one_of_other_calibrations_are_degraded() -> None:
    with chain_node(urdf=str(URDF), reference="home", **LOSSLESS), Graph() as graph:
        chain = ChainRig(graph)
        joint = chain.joint_publisher("joint1")

        def state_after(second: int, state: int = JointTransform.STATE_OK, calibration: int = 0) -> tuple[int, str]:
            transform = transform_of(second)
            transform.state, transform.calibration = state, calibration
            joint.publish(transform)
            graph.wait_until(lambda: bool(chain.states) and chain.states[-1].header.stamp.sec == second, "the state")
            return chain.states[-1].state, chain.states[-1].reason

        ok, degraded = EndpointState.STATE_OK, EndpointState.STATE_DEGRADED
        assert state_after(1, JointTransform.STATE_DEGRADED)[0] == degraded
        state, reason = state_after(2)
        assert state == degraded
        assert reason.startswith("degraded: home was taken from a pose that was not OK (degraded: joint1")
        assert call_set_home(graph) == (True, "home is the endpoint's last pose")
        assert state_after(3) == (ok, "")
        sentence = "degraded: home was taken with other calibrations; expected ~/set_home"
        assert state_after(4, calibration=7) == (degraded, sentence)
        assert call_set_home(graph) == (True, "home is the endpoint's last pose")
        assert state_after(5, calibration=7) == (ok, "")
        state_after(6, JointTransform.STATE_DEGRADED, calibration=7)
        success, message = call_set_home(graph)
        assert success
        assert message.endswith("): poses relative to it are DEGRADED")


def test_set_home_is_refused_for_absolute_poses(rig: SingleJointRig) -> None:
    sentence = "reference is 'absolute'; start the node with reference:=home for relative poses"
    assert call_set_home(rig.graph) == (False, sentence)
