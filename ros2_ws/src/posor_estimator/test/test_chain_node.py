"""chain_node as a program: what it publishes, what it refuses, and what it says then."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor_estimator.chain_node import ChainNode
from posor_estimator.core.chain import MeasuredJoint, load_chain
from posor_estimator.testing.graph import Graph, values_of
from posor_estimator.testing.program import Program, installed, ros_arguments
from posor_estimator.testing.refusal import refusal
from posor_estimator.testing.stamped import seconds_of, stamp, status_with
from posor_msgs.msg import JointTransform
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from diagnostic_msgs.msg import DiagnosticStatus

pytestmark = pytest.mark.usefixtures("ros_domain")

URDF = Path(__file__).resolve().parents[2] / "posor_bringup" / "urdf" / "slocum1985_rig.urdf"
PLATES = ("posor_receiving", "posor_target")
BEAM_M = 0.84836
LOSSLESS = {"qos_reliability": "reliable", "qos_depth": 0, "max_wait": 60.0}

TWO_JOINTS = """<robot name="two">
  <link name="base"/><link name="t1"/><link name="r2"/><link name="t2"/>
  <joint name="shoulder" type="floating"><parent link="base"/><child link="t1"/></joint>
  <joint name="beam" type="fixed"><parent link="t1"/><child link="r2"/><origin xyz="0.5 0 0" rpy="0 0 0"/></joint>
  <joint name="elbow" type="floating"><parent link="r2"/><child link="t2"/></joint>
</robot>
"""


def chain_node(**parameters: object) -> Program:
    return Program([*installed("posor_estimator", "chain_node"), *ros_arguments(parameters)])


def transform_of(seconds: int, pose: pin.SE3 | None = None, plates: tuple[str, str] = PLATES) -> Any:
    """Return a sound transform between two plates."""
    message = stamp(JointTransform(scan=seconds, child_frame_id=plates[1]), seconds)
    message.header.frame_id = plates[0]
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(pose or pin.SE3.Identity()).tolist()
    message.pose.position.x, message.pose.position.y, message.pose.position.z = x, y, z
    message.pose.orientation.x, message.pose.orientation.y = qx, qy
    message.pose.orientation.z, message.pose.orientation.w = qz, qw
    message.covariance = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 4.0]).ravel() * 1e-12
    message.native = [x, y, z, 0.0, 0.0, 7.5]
    return message


def lost_transform(seconds: int, fault: int, plates: tuple[str, str] = PLATES) -> Any:
    message = transform_of(seconds, plates=plates)
    message.state, message.faults = JointTransform.STATE_LOST, fault
    nan = math.nan
    message.pose.position.x = message.pose.position.y = message.pose.position.z = nan
    message.native = [nan] * 6
    return message


class Arm:
    """A chain_node's topics, seen from the test."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.poses: list[Any] = graph.collect(PoseStamped, "endpoint/pose")
        self.with_covariance: list[Any] = graph.collect(PoseWithCovarianceStamped, "endpoint/pose_with_covariance")
        self.joint_states: list[Any] = graph.collect(JointState, "joint_states")
        graph.watch_diagnostics()
        for topic in ("endpoint/pose", "endpoint/pose_with_covariance", "joint_states"):
            status_with(graph, "/chain_node: listeners", topic, "1")

    def forget(self) -> None:
        """Begin anew for another test."""
        for messages in (self.poses, self.with_covariance, self.joint_states, self.graph.diagnostics):
            messages.clear()

    def joint(self, name: str) -> Any:
        """Return a publisher of a joint's transforms."""
        return self.graph.publisher(JointTransform, f"{name}/transform")

    def counted(self, key: str) -> int:
        """Return a count of the diagnostic of a sound pose."""
        return int(values_of(self.graph.wait_for_status("/chain_node: endpoint", "ok"))[key])

    def wait_for(self, count: int) -> None:
        """Wait for so many complete publications."""
        self.graph.wait_until(
            lambda: len(self.poses) == len(self.with_covariance) == len(self.joint_states) == count, f"{count} poses"
        )

    def wait_for_no(self, text: str) -> DiagnosticStatus:
        """Return the diagnostic that says why there is no pose."""
        return self.graph.wait_for_status("/chain_node: endpoint", text)


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


@pytest.fixture(scope="module")
def two_joints(tmp_path_factory: pytest.TempPathFactory) -> str:
    urdf = tmp_path_factory.mktemp("two_joints") / "two.urdf"
    urdf.write_text(TWO_JOINTS, encoding="utf-8")
    return str(urdf)


def test_only_whole_scans_of_sound_transforms_are_joined_and_what_is_amiss_is_named(two_joints: str) -> None:
    with chain_node(urdf=two_joints, endpoint_frame="t2", **LOSSLESS), Graph() as graph:
        arm = Arm(graph)
        shoulder, elbow = arm.joint("shoulder"), arm.joint("elbow")
        first, second = ("base", "t1"), ("r2", "t2")
        # Transforms of two scans.
        shoulder.publish(transform_of(1, plates=first))
        elbow.publish(transform_of(2, plates=second))
        shoulder.publish(transform_of(3, pin.SE3(np.eye(3), np.array([0.0, 1e-3, 0.0])), plates=first))
        elbow.publish(transform_of(3, pin.SE3(np.eye(3), np.array([0.0, 0.0, 1e-3])), plates=second))
        arm.wait_for(1)
        assert seconds_of(arm.poses) == [3]
        position = arm.poses[0].pose.position
        np.testing.assert_allclose([position.x, position.y, position.z], [0.5, 1e-3, 1e-3], rtol=0.0, atol=1e-12)
        assert list(arm.joint_states[0].name) == ["shoulder", "elbow"]
        status = graph.wait_for_status("/chain_node: endpoint", "ok")
        assert values_of(status)["scans_incomplete"] == "2"
        named = [status.message for status in graph.diagnostics if status.name == "/chain_node: endpoint"]
        for joint in ("shoulder", "elbow"):
            assert f"no pose: {joint}: transform missing from a scan that the other joints sent" in named
        # One joint lost.
        shoulder.publish(transform_of(4, plates=first))
        elbow.publish(lost_transform(4, JointTransform.FAULT_OUT_OF_RANGE, plates=second))
        arm.wait_for_no("no pose: elbow is lost (OUT_OF_RANGE)")
        assert seconds_of(arm.poses) == [3]
        # A transform without a stamp stops nothing.
        unstamped = transform_of(6, plates=first)
        unstamped.header.stamp.sec = unstamped.header.stamp.nanosec = 0
        for message in (transform_of(5, plates=first), unstamped):
            shoulder.publish(message)
        arm.wait_for_no("no pose: shoulder: the stamp of a transform is zero; expected the time of exposure")
        for seconds in (6, 7):
            shoulder.publish(transform_of(seconds, plates=first))
        for seconds in (5, 6, 7):
            elbow.publish(transform_of(seconds, plates=second))
        arm.wait_for(4)
        assert seconds_of(arm.poses) == [3, 5, 6, 7]
        values = values_of(graph.wait_for_status("/chain_node: endpoint", "ok"))
        assert (values["scans_refused"], values["scans_incomplete"]) == ("2", "2")


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


def test_a_joint_that_nobody_measures_is_named_and_a_late_one_is_waited_for(two_joints: str) -> None:
    waiting = {**LOSSLESS, "max_wait": 0.2}
    with chain_node(urdf=two_joints, endpoint_frame="t2", **waiting), Graph() as graph:
        arm = Arm(graph)
        shoulder = arm.joint("shoulder")
        arm.wait_for_no("no pose: nobody publishes /elbow/transform")
        status = next(s for s in graph.diagnostics if s.message == "no pose: nobody publishes /elbow/transform")
        assert float(values_of(status)["since"]) > 0.0
        elbow = arm.joint("elbow")
        shoulder.publish(transform_of(1, plates=("base", "t1")))
        arm.wait_for_no("no pose: elbow: transform missing from a scan that the other joints sent")
        elbow.publish(transform_of(1, plates=("r2", "t2")))
        later = iter(range(2, 1000))

        def both() -> None:
            second = next(later)
            shoulder.publish(transform_of(second, plates=("base", "t1")))
            elbow.publish(transform_of(second, plates=("r2", "t2")))

        graph.wait_until(lambda: bool(arm.poses), "a pose of a scan that is whole", both)
        assert 1 not in seconds_of(arm.poses)


BEAMS = """format: posor_beams
version: 1
name: two
provenance: {source: test, method: none, date: none}
gravity: {value: [0.0, 0.0, -10.0], unit: m/s^2}
beams:
  - joint: beam
    uncertainty:
      position: {value: [3.0e-6, 0.0, 0.0], unit: m}
      orientation: {value: [0.0, 0.0, 0.0], unit: rad}
    sag:
      tube:
        outer_diameter: {value: 0.05, unit: m}
        inner_diameter: {value: 0.04, unit: m}
        modulus: {value: 69.0e9, unit: Pa}
        density: {value: 2700, unit: kg/m^3}
      gimbals: {value: [0.0, 0.2], unit: m}
      uncertainty: {value: 0.0, unit: "1"}
"""


def test_a_beams_file_brings_sag_and_uncertainty_into_the_pose(two_joints: str, tmp_path: Path) -> None:
    beams = tmp_path / "beams.yaml"
    beams.write_text(BEAMS, encoding="utf-8")
    chain = load_chain(Path(two_joints), "t2", beams)
    still = MeasuredJoint(pin.SE3.Identity(), np.zeros((6, 6)))
    sag = chain.endpoint({"shoulder": still, "elbow": still}).T_base_endpoint.translation[2]
    assert sag < -1e-6
    with chain_node(urdf=two_joints, endpoint_frame="t2", beams=str(beams), **LOSSLESS), Graph() as graph:
        arm = Arm(graph)
        arm.joint("shoulder").publish(transform_of(1, plates=("base", "t1")))
        arm.joint("elbow").publish(transform_of(1, plates=("r2", "t2")))
        arm.wait_for(1)
        assert arm.poses[0].pose.position.z == sag
        covariance = np.reshape(arm.with_covariance[0].pose.covariance, (6, 6))
        assert covariance[0, 0] == pytest.approx(2e-12 + 9e-12, rel=1e-6)
        assert values_of(graph.wait_for_status("/chain_node: endpoint", "ok"))["beams"] == str(beams)


def test_beams_in_motion_sag_otherwise_than_at_rest(two_joints: str, tmp_path: Path) -> None:
    """The shoulder rises ever faster, so the beam weighs a little more than at rest."""
    beams = tmp_path / "beams.yaml"
    beams.write_text(BEAMS, encoding="utf-8")
    moving = {**LOSSLESS, "beams": str(beams), "acceleration_window": 10.0}
    chain = load_chain(Path(two_joints), "t2", beams)
    elbow_at = MeasuredJoint(pin.SE3.Identity(), np.zeros((6, 6)))
    acceleration = 2e-3
    with chain_node(urdf=two_joints, endpoint_frame="t2", **moving), Graph() as graph:
        arm = Arm(graph)
        shoulder, elbow = arm.joint("shoulder"), arm.joint("elbow")
        scans = 8
        for second in range(scans):
            up = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5 * acceleration * second**2]))
            shoulder.publish(transform_of(second + 1, up, plates=("base", "t1")))
            elbow.publish(transform_of(second + 1, plates=("r2", "t2")))
        arm.wait_for(scans)
        joints = {"shoulder": MeasuredJoint(up, np.zeros((6, 6))), "elbow": elbow_at}
        heavier = chain.endpoint(joints, {"beam": np.array([0.0, 0.0, acceleration])}).T_base_endpoint
        at_rest = chain.endpoint(joints).T_base_endpoint
        found = arm.poses[-1].pose.position.z
        assert at_rest.translation[2] - heavier.translation[2] > 1e-10
        assert found == pytest.approx(heavier.translation[2], abs=1e-14)


def test_a_beams_file_that_does_not_fit_is_refused(
    two_joints: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    beams = tmp_path / "beams.yaml"
    beams.write_text(BEAMS.replace("joint: beam", "joint: boom"), encoding="utf-8")
    sentence = f"URDF {two_joints}: has no fixed joint 'boom', which the beams file names; expected one of beam."
    parameters = {"urdf": two_joints, "endpoint_frame": "t2", "beams": str(beams)}
    assert refusal(ChainNode, parameters, capfd) == (1, [sentence])
