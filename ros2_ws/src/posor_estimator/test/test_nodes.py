"""posor_node and chain_node as programs: what they publish, what they refuse, and what they say then."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor_estimator.core.calibration.load import load_calibration
from posor_estimator.testing.graph import Graph, values_of
from posor_estimator.testing.program import Program, installed, ros_arguments
from posor_msgs.msg import JointTransform, RawScan
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

if TYPE_CHECKING:
    from collections.abc import Callable

    from diagnostic_msgs.msg import DiagnosticStatus

pytestmark = pytest.mark.usefixtures("ros_domain")

ROOT = Path(__file__).resolve().parents[4]
BRINGUP = ROOT / "ros2_ws" / "src" / "posor_bringup"
CALIBRATION = BRINGUP / "config" / "slocum1985_printed.yaml"
URDF = BRINGUP / "urdf" / "slocum1985_rig.urdf"
YMO = ROOT / "data" / "slocum1985" / "ymo_input.csv"

PLATES = ("posor_receiving", "posor_target")
BEAM_M = 0.84836
TOTAL_A = 1e-4
LOSSLESS = {"qos_reliability": "reliable", "qos_depth": 0}

TWO_JOINTS = """<robot name="two">
  <link name="base"/><link name="t1"/><link name="r2"/><link name="t2"/>
  <joint name="shoulder" type="floating"><parent link="base"/><child link="t1"/></joint>
  <joint name="beam" type="fixed"><parent link="t1"/><child link="r2"/><origin xyz="0.5 0 0" rpy="0 0 0"/></joint>
  <joint name="elbow" type="floating"><parent link="r2"/><child link="t2"/></joint>
</robot>
"""


def posor_node(**parameters: object) -> Program:
    return Program([*installed("posor_estimator", "posor_node"), *ros_arguments(parameters)])


def chain_node(**parameters: object) -> Program:
    return Program([*installed("posor_estimator", "chain_node"), *ros_arguments(parameters)])


def stamp(message: Any, seconds: int) -> Any:
    message.header.stamp.sec, message.header.stamp.nanosec = seconds, 250_000_000
    return message


def seconds_of(messages: list[Any]) -> list[int]:
    return [message.header.stamp.sec for message in messages]


def status_with(graph: Graph, name: str, key: str, text: str) -> DiagnosticStatus:
    """Return the newest status of that name once its value ``key`` contains ``text``."""

    def there() -> bool:
        latest = graph.latest(name)
        return latest is not None and text in values_of(latest).get(key, "")

    graph.wait_until(there, f"'{text}' in {key} of {name}")
    return graph.latest(name)


# posor_node.


@pytest.fixture(scope="module")
def recorded() -> dict[str, float]:
    """The first step of test YMO."""
    lines = YMO.read_text(encoding="utf-8").splitlines()
    row = next(csv.DictReader(line for line in lines if not line.startswith("#")))
    return {name: float(cell) for name, cell in row.items() if name not in ("step", "repaired")}


@pytest.fixture
def sound(recorded: dict[str, float]) -> Callable[[int], Any]:
    """Return a maker of sound scans: the first step of test YMO with a number, which is its second too."""

    def make(number: int) -> Any:
        scan = stamp(RawScan(scan=number, samples=1, supply_voltage=math.nan, temperature=math.nan), number)
        scan.header.frame_id = PLATES[0]
        scan.gap_voltages = [recorded[f"l{k}_v"] for k in (1, 2, 3)]
        half = TOTAL_A / 2.0
        for k in (1, 2):
            x, y = recorded[f"dx{k}"], recorded[f"dy{k}"]
            scan.diode_currents += type(scan.diode_currents)("d", [half * (1.0 + r) for r in (x, y, -x, -y)])
        scan.lit_sources = [0, 1]
        return scan

    return make


def nan_voltage(scan: Any) -> None:
    scan.gap_voltages[1] = math.nan


def infinite_current(scan: Any) -> None:
    scan.diode_currents[6] = math.inf


def missing_voltage(scan: Any) -> None:
    scan.gap_voltages = scan.gap_voltages[:2]


def surplus_currents(scan: Any) -> None:
    scan.diode_currents = [*scan.diode_currents, 1e-5, 1e-5]


def dark_diode(scan: Any) -> None:
    scan.diode_currents[4], scan.diode_currents[6] = 1e-6, 1e-6


def voltage_out_of_range(scan: Any) -> None:
    scan.gap_voltages[2] = 2.5


def spot_off_the_map(scan: Any) -> None:
    scan.diode_currents[0], scan.diode_currents[2] = 0.2 * TOTAL_A, 0.8 * TOTAL_A


def no_light(scan: Any) -> None:
    scan.lit_sources[0] = RawScan.NO_SOURCE


def unknown_light(scan: Any) -> None:
    scan.lit_sources[1] = 7


def foreign_frame(scan: Any) -> None:
    scan.header.frame_id = "elbow_receiving"


def zero_stamp(scan: Any) -> None:
    scan.header.stamp.sec = scan.header.stamp.nanosec = 0


UNFIT: list[tuple[Callable[[Any], None], int, tuple[str, ...]]] = [
    (nan_voltage, JointTransform.FAULT_BAD_READING, ("probe_2", "nan", "finite voltage")),
    (infinite_current, JointTransform.FAULT_BAD_READING, ("diode_2", "inf", "finite currents")),
    (missing_voltage, JointTransform.FAULT_BAD_READING, ("2 gap", "voltages", "expected 3")),
    (surplus_currents, JointTransform.FAULT_BAD_READING, ("10 contact currents", "expected 8")),
    (dark_diode, JointTransform.FAULT_DARK_DIODE, ("diode_2", "too dark", "A + C = 2e-06 A", "at least 2e-05 A")),
    (voltage_out_of_range, JointTransform.FAULT_OUT_OF_RANGE, ("probe_3", "2.8 V", "-0.6 to 1.2 V")),
    (spot_off_the_map, JointTransform.FAULT_OUT_OF_RANGE, ("diode_1", "-0.6", "0.502 to 0.526")),
    (no_light, JointTransform.FAULT_SOURCE, ("diode_1", "no light source was lit")),
    (unknown_light, JointTransform.FAULT_SOURCE, ("diode_2", "light source 7", "0 to 1")),
    (foreign_frame, JointTransform.FAULT_BAD_READING, ("'elbow_receiving'", "expected 'posor_receiving'")),
    (zero_stamp, JointTransform.FAULT_BAD_READING, ("the stamp is zero", "expected the time of exposure")),
]


def test_posor_node_refuses_what_it_cannot_start_with(tmp_path: Path) -> None:
    missing = tmp_path / "none.yaml"
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(CALIBRATION.read_text(encoding="utf-8").replace("unit: V}", "unit: mV}", 1), encoding="utf-8")
    line = next(n for n, text in enumerate(wrong.read_text(encoding="utf-8").splitlines(), 1) if "mV}" in text)
    for parameters, code, sentence in (
        (
            {"calibration": str(missing)},
            1,
            f"calibration file {missing}: cannot be read: No such file or directory; expected a YAML calibration file.",
        ),
        (
            {},
            2,
            (
                "node /posor_node, parameter 'calibration': is not set; expected a string: "
                "path of the calibration file (YAML) of this joint's POSOR."
            ),
        ),
        (
            {"calibration": str(CALIBRATION), "session": "ymx"},
            1,
            "calibration 'slocum1985_printed': session 'ymx' is unknown; expected ymo, yzmo, zmo.",
        ),
        (
            {"calibration": str(CALIBRATION), "covariance": "all"},
            2,
            (
                "node /posor_node, parameter 'covariance': 'all' is wrong; "
                "expected one of 'random', 'systematic', 'total'."
            ),
        ),
    ):
        with posor_node(**parameters) as node:
            assert (node.wait(), node.stderr, node.stdout) == (code, [sentence], [])
    with posor_node(calibration=str(wrong)) as node:
        assert node.wait() == 1
        [sentence] = node.stderr
        assert sentence.startswith(f"{wrong}, line {line}, key sensors[0].probes[0].zero_shift")
        assert sentence.endswith(": unit 'mV'; expected 'V'.")


def test_a_sound_scan_becomes_a_transform_of_its_own_time_and_frames(sound: Callable[[int], Any]) -> None:
    with posor_node(calibration=str(CALIBRATION), session="ymo", **LOSSLESS), Graph() as graph:
        transforms = graph.collect(JointTransform, "transform")
        graph.watch_diagnostics()
        raw = graph.publisher(RawScan, "raw")
        status_with(graph, "/posor_node: listeners", "transform", "1")
        scan = sound(5)
        scan.status = RawScan.STATUS_OUTLIERS_DROPPED
        raw.publish(scan)
        graph.wait_until(lambda: len(transforms) == 1, "a transform")
        [transform] = transforms
        assert transform.header.stamp == scan.header.stamp
        assert (transform.header.frame_id, transform.child_frame_id) == PLATES
        assert (transform.scan, transform.scan_status) == (5, RawScan.STATUS_OUTLIERS_DROPPED)
        assert (transform.state, transform.faults) == (JointTransform.STATE_OK, JointTransform.FAULT_NONE)
        assert transform.covariance_kind == JointTransform.COVARIANCE_TOTAL
        assert transform.redundancy == 1
        covariance = np.reshape(transform.covariance, (6, 6))
        np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9)
        assert (np.linalg.eigvalsh(covariance) > 0.0).all()
        position = transform.pose.position
        assert list(transform.native[:3]) == [position.x, position.y, position.z]
        # The calibration's home is this step: level, about zero theta as far as the diodes' maps know.
        assert abs(transform.native[5]) < 1e-4
        status = graph.wait_for_status("/posor_node: estimate", "ok: none")
        assert values_of(status)["last_scan"] == "5"


def test_the_diagnostics_and_the_log_name_the_calibration() -> None:
    digest = load_calibration(CALIBRATION).content_hash
    with posor_node(calibration=str(CALIBRATION), session="zmo") as node, Graph() as graph:
        graph.watch_diagnostics()
        values = values_of(graph.wait_for_status("/posor_node: estimate", "no scan yet"))
        assert values["calibration"] == "slocum1985_printed"
        assert values["calibration_file"] == str(CALIBRATION)
        assert values["calibration_hash"] == digest
        assert values["session"] == "zmo"
        assert digest in node.wait_for_line("calibration 'slocum1985_printed'")
        assert node.end() == 0


def test_an_unfit_scan_is_lost_without_a_number_and_the_next_sound_one_is_found(sound: Callable[[int], Any]) -> None:
    with posor_node(calibration=str(CALIBRATION), session="ymo", **LOSSLESS) as node, Graph() as graph:
        transforms = graph.collect(JointTransform, "transform")
        graph.watch_diagnostics()
        raw = graph.publisher(RawScan, "raw")
        status_with(graph, "/posor_node: listeners", "transform", "1")
        for case, (spoil, fault, words) in enumerate(UNFIT, start=1):
            scan = sound(10 * case)
            spoil(scan)
            raw.publish(scan)
            graph.wait_until(lambda: len(transforms) == 2 * case - 1, spoil.__name__)  # noqa: B023  used at once
            lost = transforms[-1]
            assert (lost.scan, lost.state, lost.faults) == (10 * case, JointTransform.STATE_LOST, fault), spoil.__name__
            assert lost.header.stamp == scan.header.stamp
            position, orientation = lost.pose.position, lost.pose.orientation
            pose = [position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w]
            assert np.isnan([*pose, *lost.native, *lost.covariance]).all(), spoil.__name__
            status = status_with(graph, "/posor_node: estimate", "reason", f"scan {10 * case}")
            assert status.level == b"\x02"
            assert status.message.startswith("lost: ")
            reason = values_of(status)["reason"]
            assert all(word in reason for word in words), reason
            raw.publish(sound(10 * case + 1))
            graph.wait_until(lambda: len(transforms) == 2 * case, "a sound scan")  # noqa: B023  used at once
            assert transforms[-1].state == JointTransform.STATE_OK, spoil.__name__
        status = status_with(graph, "/posor_node: estimate", "last_scan", str(10 * len(UNFIT) + 1))
        assert values_of(status)["scans_lost"] == str(len(UNFIT))
        # Where a scan starts from does not matter: all sound scans were the same, and so are their poses.
        poses = [tuple(transform.native) for transform in transforms[1::2]]
        np.testing.assert_allclose(poses, [poses[0]] * len(UNFIT), rtol=0.0, atol=1e-12)
        assert node.end() == 0


def test_every_scan_number_that_a_message_can_hold_is_answered(sound: Callable[[int], Any]) -> None:
    with posor_node(calibration=str(CALIBRATION), session="ymo", **LOSSLESS) as node, Graph() as graph:
        transforms = graph.collect(JointTransform, "transform")
        graph.watch_diagnostics()
        raw = graph.publisher(RawScan, "raw")
        status_with(graph, "/posor_node: listeners", "transform", "1")
        scan = sound(1)
        scan.scan = 2**64 - 1
        raw.publish(scan)
        graph.wait_until(lambda: bool(transforms) or node.ended, "a transform, or the node's end")
        assert [transform.scan for transform in transforms] == [2**64 - 1]


def test_a_contradicting_reading_is_lost_by_its_chi_square(sound: Callable[[int], Any]) -> None:
    """A spot moved by dirt: every reading is in range, but no pose explains all seven."""
    with posor_node(calibration=str(CALIBRATION), session="ymo", **LOSSLESS), Graph() as graph:
        transforms = graph.collect(JointTransform, "transform")
        graph.watch_diagnostics()
        raw = graph.publisher(RawScan, "raw")
        status_with(graph, "/posor_node: listeners", "transform", "1")
        scan = sound(1)
        shift = 0.03 * TOTAL_A  # of the ratio along y, within the map
        scan.diode_currents[5] -= shift
        scan.diode_currents[7] += shift
        raw.publish(scan)
        graph.wait_until(lambda: len(transforms) == 1, "a transform")
        [transform] = transforms
        assert (transform.state, transform.faults) == (JointTransform.STATE_LOST, JointTransform.FAULT_RESIDUAL)
        assert math.isnan(transform.pose.position.x)
        status = graph.wait_for_status("/posor_node: estimate", "lost: RESIDUAL")
        assert "contradict one another" in values_of(status)["reason"]


# chain_node.


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

    def joint(self, name: str) -> Any:
        """Return a publisher of a joint's transforms."""
        return self.graph.publisher(JointTransform, f"{name}/transform")

    def wait_for(self, count: int) -> None:
        """Wait for so many complete publications."""
        self.graph.wait_until(
            lambda: len(self.poses) == len(self.with_covariance) == len(self.joint_states) == count, f"{count} poses"
        )

    def wait_for_no(self, text: str) -> DiagnosticStatus:
        """Return the diagnostic that says why there is no pose."""
        return self.graph.wait_for_status("/chain_node: endpoint", text)


def test_chain_node_refuses_what_it_cannot_start_with(tmp_path: Path) -> None:
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
            {},
            2,
            (
                "node /chain_node, parameter 'urdf': is not set; expected a string: "
                "path of the arm's URDF; its floating joints are the POSORs."
            ),
        ),
        (
            {"urdf": str(URDF), "reference": "relative"},
            2,
            "node /chain_node, parameter 'reference': 'relative' is wrong; expected one of 'absolute', 'home'.",
        ),
    ):
        with chain_node(**parameters) as node:
            assert (node.wait(), node.stderr, node.stdout) == (code, [sentence], [])


def test_the_endpoint_has_the_scans_stamp_its_frames_and_its_covariance() -> None:
    with chain_node(urdf=str(URDF), **LOSSLESS) as node, Graph() as graph:
        arm = Arm(graph)
        turn = pin.SE3(pin.utils.rotate("z", 0.01), np.array([1e-4, 2e-4, 3e-4]))
        arm.joint("joint1").publish(transform_of(7, turn))
        arm.wait_for(1)
        [pose], [with_covariance], [joints] = arm.poses, arm.with_covariance, arm.joint_states
        for message in (pose, with_covariance, joints):
            assert (message.header.stamp.sec, message.header.stamp.nanosec) == (7, 250_000_000)
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
        status = graph.wait_for_status("/chain_node: endpoint", "ok")
        assert values_of(status)["joints"] == "joint1"
        assert node.end() == 0


def test_a_lost_joint_gives_no_pose_and_is_named_with_its_fault() -> None:
    with chain_node(urdf=str(URDF), **LOSSLESS), Graph() as graph:
        arm = Arm(graph)
        joint = arm.joint("joint1")
        joint.publish(transform_of(1))
        arm.wait_for(1)
        joint.publish(lost_transform(2, JointTransform.FAULT_DARK_DIODE))
        status = arm.wait_for_no("no pose: joint1 is lost (DARK_DIODE)")
        assert status.level == b"\x02"
        joint.publish(transform_of(3))
        arm.wait_for(2)
        for messages in (arm.poses, arm.with_covariance, arm.joint_states):
            assert seconds_of(messages) == [1, 3]
        status = graph.wait_for_status("/chain_node: endpoint", "ok")
        assert values_of(status)["scans_refused"] == "1"


def test_a_degraded_joint_gives_a_pose_and_a_warning() -> None:
    with chain_node(urdf=str(URDF), **LOSSLESS), Graph() as graph:
        arm = Arm(graph)
        degraded = transform_of(1)
        degraded.state = JointTransform.STATE_DEGRADED
        arm.joint("joint1").publish(degraded)
        arm.wait_for(1)
        assert graph.wait_for_status("/chain_node: endpoint", "degraded: joint1").level == b"\x01"


def test_an_uncounted_joint_gives_no_pose() -> None:
    with chain_node(urdf=str(URDF), **LOSSLESS), Graph() as graph:
        arm = Arm(graph)
        joint = arm.joint("joint1")
        uncounted = transform_of(1)
        uncounted.state, uncounted.faults = JointTransform.STATE_UNCOUNTED, JointTransform.FAULT_COUNT
        joint.publish(uncounted)
        arm.wait_for_no("no pose: joint1 is uncounted (COUNT)")
        joint.publish(transform_of(2))
        arm.wait_for(1)
        assert seconds_of(arm.poses) == [2]


def nan_position(message: Any) -> None:
    message.pose.position.y = math.nan


def no_quaternion(message: Any) -> None:
    message.pose.orientation.w = 0.0


def infinite_covariance(message: Any) -> None:
    message.covariance[7] = math.inf


@pytest.mark.parametrize("spoil", [nan_position, no_quaternion, infinite_covariance])
def test_numbers_that_are_no_pose_are_not_passed_on_whatever_their_state_says(spoil: Callable[[Any], None]) -> None:
    with chain_node(urdf=str(URDF), **LOSSLESS), Graph() as graph:
        arm = Arm(graph)
        joint = arm.joint("joint1")
        broken = transform_of(1)
        spoil(broken)
        joint.publish(broken)
        joint.publish(transform_of(2))
        graph.wait_until(lambda: 2 in seconds_of(arm.poses), "the sound pose")
        assert seconds_of(arm.poses) == [2]
        assert any("joint1" in status.message and "no pose" in status.message for status in graph.diagnostics)


def test_transforms_between_other_frames_are_refused() -> None:
    with chain_node(urdf=str(URDF), **LOSSLESS), Graph() as graph:
        arm = Arm(graph)
        joint = arm.joint("joint1")
        joint.publish(transform_of(1, plates=("posor_receiving", "another_plate")))
        arm.wait_for_no(
            "no pose: joint1: transforms from 'posor_receiving' to 'another_plate' arrive; "
            "expected 'posor_receiving' to 'posor_target', as in the URDF"
        )
        joint.publish(transform_of(2))
        arm.wait_for(1)
        assert seconds_of(arm.poses) == [2]


@pytest.fixture
def two_joints(tmp_path: Path) -> str:
    urdf = tmp_path / "two.urdf"
    urdf.write_text(TWO_JOINTS, encoding="utf-8")
    return str(urdf)


def test_only_transforms_of_one_scan_are_joined_and_a_missing_joint_is_named(two_joints: str) -> None:
    with chain_node(urdf=two_joints, endpoint_frame="t2", **LOSSLESS), Graph() as graph:
        arm = Arm(graph)
        shoulder, elbow = arm.joint("shoulder"), arm.joint("elbow")
        first, second = ("base", "t1"), ("r2", "t2")
        shoulder.publish(transform_of(1, plates=first))
        elbow.publish(transform_of(2, plates=second))
        shoulder.publish(transform_of(3, pin.SE3(np.eye(3), np.array([0.0, 1e-3, 0.0])), plates=first))
        elbow.publish(transform_of(3, pin.SE3(np.eye(3), np.array([0.0, 0.0, 1e-3])), plates=second))
        arm.wait_for(1)
        assert seconds_of(arm.poses) == [3]
        position = arm.poses[0].pose.position
        np.testing.assert_allclose([position.x, position.y, position.z], [0.5, 1e-3, 1e-3], rtol=0.0, atol=1e-12)
        assert list(arm.joint_states[0].name) == ["shoulder", "elbow"]
        named = [status.message for status in graph.diagnostics if status.name == "/chain_node: endpoint"]
        for joint in ("shoulder", "elbow"):
            assert f"no pose: {joint}: transform missing from a scan that the other joints sent" in named
        status = graph.wait_for_status("/chain_node: endpoint", "ok")
        assert values_of(status)["scans_incomplete"] == "2"


def test_one_lost_joint_of_two_gives_no_pose(two_joints: str) -> None:
    with chain_node(urdf=two_joints, endpoint_frame="t2", **LOSSLESS), Graph() as graph:
        arm = Arm(graph)
        shoulder, elbow = arm.joint("shoulder"), arm.joint("elbow")
        shoulder.publish(transform_of(1, plates=("base", "t1")))
        elbow.publish(lost_transform(1, JointTransform.FAULT_OUT_OF_RANGE, plates=("r2", "t2")))
        arm.wait_for_no("no pose: elbow is lost (OUT_OF_RANGE)")
        assert arm.poses == []


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


def test_set_home_is_refused_where_poses_are_absolute() -> None:
    with chain_node(urdf=str(URDF), **LOSSLESS), Graph() as graph:
        success, message = call_set_home(graph)
        assert not success
        assert message == "reference is 'absolute'; start the node with reference:=home to publish relative poses"


def test_a_joint_that_nobody_measures_is_named_with_the_time_since(two_joints: str) -> None:
    with chain_node(urdf=two_joints, endpoint_frame="t2", **LOSSLESS), Graph() as graph:
        arm = Arm(graph)
        arm.joint("shoulder")
        arm.wait_for_no("no pose: nobody publishes /elbow/transform")
        status = next(s for s in graph.diagnostics if s.message == "no pose: nobody publishes /elbow/transform")
        assert float(values_of(status)["since"]) > 0.0
