"""chain_node as a program: what it publishes, what it refuses, and what it says then."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
import pytest
from posor_estimator.chain_node import ChainNode
from posor_estimator.testing.graph import Graph, values_of
from posor_estimator.testing.refusal import refusal
from posor_estimator.testing.stamped import seconds_of, stamp
from posor_msgs.msg import JointTransform
from std_srvs.srv import Trigger

from .chain_program import LOSSLESS, Arm, chain_node, lost_transform, transform_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

pytestmark = pytest.mark.usefixtures("ros_domain")

URDF = Path(__file__).resolve().parents[2] / "posor_bringup" / "urdf" / "slocum1985_rig.urdf"
BEAM_M = 0.84836


def test_a_program_that_cannot_start_ends_with_one_sentence() -> None:
    with chain_node() as node:
        sentence = (
            "node /chain_node, parameter 'urdf': is not set; expected a string: "
            "path of the arm's URDF; its floating joints are the POSORs."
        )
        assert (node.wait(), node.stderr, node.stdout) == (2, [sentence], [])


def test_chain_node_refuses_what_it_cannot_start_with(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    missing, blind, cut = (tmp_path / name for name in ("none.urdf", "blind.urdf", "cut.urdf"))
    text = URDF.read_text(encoding="utf-8")
    blind.write_text(text.replace('type="floating"', 'type="fixed"'), encoding="utf-8")
    cut.write_text(text.replace("</robot>", ""), encoding="utf-8")
    links = "machining_centre, posor_receiving, posor_target, endpoint"
    for parameters, code, sentence in (
        (
            {"urdf": str(missing)},
            1,
            f"URDF {missing}: cannot be read: No such file or directory; expected a robot description.",
        ),
        (
            {"urdf": str(tmp_path)},
            1,
            f"URDF {tmp_path}: cannot be read: Is a directory; expected a robot description.",
        ),
        (
            {"urdf": str(blind)},
            1,
            f"URDF {blind}: has no POSOR joint; expected at least one joint of type 'floating'.",
        ),
        (
            {"urdf": str(cut)},
            1,
            (
                f"URDF {cut}: is not XML: no element found: line {text.count(chr(10)) + 1}, column 0; "
                "expected a robot description (URDF)."
            ),
        ),
        (
            {"urdf": str(URDF), "endpoint_frame": "hand"},
            1,
            f"URDF {URDF}: has no link 'hand'; expected one of {links}.",
        ),
        (
            {"urdf": str(URDF), "reference": "relative"},
            2,
            "node /chain_node, parameter 'reference': 'relative' is wrong; expected one of 'absolute', 'home'.",
        ),
    ):
        assert refusal(ChainNode, parameters, capfd) == (code, [sentence])


class Rig(Arm):
    """The arm of one joint, whose node several tests share; stamps rise from one to the next."""

    def __init__(self, graph: Graph) -> None:
        super().__init__(graph)
        self.measured = self.joint("joint1")
        self.first = 0

    def send(self, message: Any, second: int) -> None:
        """Publish a transform of a second of this test."""
        self.measured.publish(stamp(message, self.first + second))

    def has_seconds(self, expected: list[int]) -> bool:
        """Tell whether all that came is of these seconds of this test."""
        topics = (self.poses, self.with_covariance, self.joint_states)
        return all(seconds_of(messages) == [self.first + second for second in expected] for messages in topics)


@pytest.fixture(scope="module")
def node_of_the_rig() -> Iterator[Rig]:
    """One node for all tests that need no parameters of their own."""
    with chain_node(urdf=str(URDF), **LOSSLESS) as node, Graph() as graph:
        yield Rig(graph)
        assert node.end() == 0


@pytest.fixture
def rig(node_of_the_rig: Rig) -> Rig:
    node_of_the_rig.forget()
    node_of_the_rig.first += 100
    return node_of_the_rig


def test_the_endpoint_has_the_scans_stamp_its_frames_and_its_covariance(rig: Rig) -> None:
    turn = pin.SE3(pin.utils.rotate("z", 0.01), np.array([1e-4, 2e-4, 3e-4]))
    rig.send(transform_of(7, turn), 7)
    rig.wait_for(1)
    [pose], [with_covariance], [joints] = rig.poses, rig.with_covariance, rig.joint_states
    for message in (pose, with_covariance, joints):
        assert (message.header.stamp.sec, message.header.stamp.nanosec) == (rig.first + 7, 250_000_000)
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
    assert (list(joints.name), list(joints.position)) == (["joint1"], [7.5])
    status = rig.graph.wait_for_status("/chain_node: endpoint", "ok")
    assert values_of(status)["joints"] == "joint1"


def test_a_lost_joint_gives_no_pose_and_is_named_with_its_fault(rig: Rig) -> None:
    rig.send(transform_of(1), 1)
    rig.wait_for(1)
    before = rig.counted("scans_refused")
    rig.send(lost_transform(2, JointTransform.FAULT_DARK_DIODE), 2)
    assert rig.wait_for_no("no pose: joint1 is lost (DARK_DIODE)").level == b"\x02"
    rig.send(transform_of(3), 3)
    rig.wait_for(2)
    assert rig.has_seconds([1, 3])
    assert rig.counted("scans_refused") == before + 1


def test_a_degraded_joint_gives_a_pose_and_a_warning(rig: Rig) -> None:
    degraded = transform_of(1)
    degraded.state = JointTransform.STATE_DEGRADED
    rig.send(degraded, 1)
    rig.wait_for(1)
    assert rig.graph.wait_for_status("/chain_node: endpoint", "degraded: joint1").level == b"\x01"


def test_an_uncounted_joint_gives_no_pose(rig: Rig) -> None:
    uncounted = transform_of(1)
    uncounted.state, uncounted.faults = JointTransform.STATE_UNCOUNTED, JointTransform.FAULT_COUNT
    rig.send(uncounted, 1)
    rig.wait_for_no("no pose: joint1 is uncounted (COUNT)")
    rig.send(transform_of(2), 2)
    rig.wait_for(1)
    assert rig.has_seconds([2])


def nan_position(message: Any) -> None:
    message.pose.position.y = math.nan


def no_quaternion(message: Any) -> None:
    message.pose.orientation.w = 0.0


def infinite_covariance(message: Any) -> None:
    message.covariance[7] = math.inf


@pytest.mark.parametrize("spoil", [nan_position, no_quaternion, infinite_covariance])
def test_numbers_that_are_no_pose_are_not_passed_on_whatever_their_state_says(
    rig: Rig, spoil: Callable[[Any], None]
) -> None:
    broken = transform_of(1)
    spoil(broken)
    rig.send(broken, 1)
    rig.send(transform_of(2), 2)
    rig.wait_for(1)
    assert rig.has_seconds([2])

    def is_told() -> bool:
        return any("joint1" in status.message and "no pose" in status.message for status in rig.graph.diagnostics)

    rig.graph.wait_until(is_told, "the reason")


def test_transforms_between_other_frames_are_refused(rig: Rig) -> None:
    rig.send(transform_of(1, plates=("posor_receiving", "another_plate")), 1)
    rig.wait_for_no(
        "no pose: joint1: transforms from 'posor_receiving' to 'another_plate' arrive; "
        "expected 'posor_receiving' to 'posor_target', as in the URDF"
    )
    rig.send(transform_of(2), 2)
    rig.wait_for(1)
    assert rig.has_seconds([2])


def call_set_home(graph: Graph) -> tuple[bool, str]:
    answer = graph.call(Trigger, "/chain_node/set_home", Trigger.Request())
    return answer.success, answer.message


def test_relative_to_home_the_first_pose_is_zero_until_home_is_set_anew() -> None:
    with chain_node(urdf=str(URDF), reference="home", **LOSSLESS), Graph() as graph:
        arm = Arm(graph)
        joint = arm.joint("joint1")
        assert call_set_home(graph) == (False, "there is no pose yet to take as home")
        up = pin.SE3(np.eye(3), np.array([0.0, 1e-3, 0.0]))
        joint.publish(transform_of(1))
        joint.publish(transform_of(2, up))
        arm.wait_for(2)
        assert {pose.header.frame_id for pose in arm.poses} == {"endpoint_home"}
        heights = [[p.pose.position.x, p.pose.position.y, p.pose.position.z] for p in arm.poses]
        # The endpoint's axes at home are those of the target plate: Y of the plate is up.
        np.testing.assert_allclose(heights, [[0.0, 0.0, 0.0], [0.0, 1e-3, 0.0]], rtol=0.0, atol=1e-15)
        assert call_set_home(graph) == (True, "home is the endpoint's last pose")
        joint.publish(transform_of(3, up))
        joint.publish(transform_of(4))
        arm.wait_for(4)
        heights = [[p.pose.position.x, p.pose.position.y, p.pose.position.z] for p in arm.poses[2:]]
        np.testing.assert_allclose(heights, [[0.0, 0.0, 0.0], [0.0, -1e-3, 0.0]], rtol=0.0, atol=1e-15)


def test_set_home_is_refused_where_poses_are_absolute(rig: Rig) -> None:
    success, message = call_set_home(rig.graph)
    assert not success
    assert message == "reference is 'absolute'; start the node with reference:=home to publish relative poses"
