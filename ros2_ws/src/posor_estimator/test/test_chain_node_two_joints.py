# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""chain_node with an arm of two joints: synchronisation of the joints, and the beam between them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.joint_measurements import MeasuredJoint
from posor.chain.kinematic_chain import load_chain
from posor_estimator.chain_node import ChainNode
from posor_lab.harness.case_tables import edited
from posor_lab.harness.graph import Graph, stamp_seconds, values_of, wait_for_value
from posor_lab.harness.in_process_nodes import NodeProcess, run_refused_node
from posor_lab.harness.program import HAND_FED
from posor_msgs.msg import EndpointState, JointTransform
from posor_ros.message_classes import schema_of_class

from .chain_program import LOSSLESS, ChainRig, call_set_home, chain_node, lost_transform, transform_of

pytestmark = pytest.mark.usefixtures("ros_domain")

HERE = Path(__file__).parent
URDF, BEAMS = HERE / "two_joints.urdf", HERE / "sagging_beam.yaml"
PLATES = {"shoulder": ("base", "t1"), "elbow": ("r2", "t2")}


class TwoJoints(ChainRig):
    """A chain_node of two joints, its states, and the publishers of the transforms."""

    def __init__(self, graph: Graph) -> None:
        super().__init__(graph)
        self.publishers = {name: self.joint_publisher(name) for name in PLATES}

    def send(self, joint: str, *seconds: int, pose: pin.SE3 | None = None) -> None:
        """Publish sound transforms of a joint with these stamps."""
        for second in seconds:
            self.publishers[joint].publish(transform_of(second, pose, PLATES[joint]))


@contextmanager
def running(**parameters: object) -> Iterator[TwoJoints]:
    with chain_node(urdf=str(URDF), endpoint_frame="t2", **{**LOSSLESS, **parameters}), Graph() as graph:
        yield TwoJoints(graph)


def shifted(x: float, y: float, z: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, y, z]))


def test_only_complete_scans_of_usable_transforms_give_a_pose() -> None:
    with running() as rig:
        graph = rig.graph
        # Transforms of two scans.
        rig.send("shoulder", 1)
        rig.send("elbow", 2)
        rig.send("shoulder", 3, pose=shifted(0.0, 1e-3, 0.0))
        rig.send("elbow", 3, pose=shifted(0.0, 0.0, 1e-3))
        rig.wait_for_poses(1)
        assert stamp_seconds(rig.poses) == [3]
        position = rig.poses[0].pose.position
        np.testing.assert_allclose([position.x, position.y, position.z], [0.5, 1e-3, 1e-3], rtol=0.0, atol=1e-12)
        assert list(rig.joint_states[0].name) == ["shoulder", "elbow"]
        status = graph.wait_for_status("/chain_node: endpoint", "ok")
        assert values_of(status)["scans_incomplete"] == "2"
        named = [status.message for status in graph.diagnostics if status.name == "/chain_node: endpoint"]
        for joint in PLATES:
            assert f"no pose: {joint}: transform missing from a scan that the other joints sent" in named
        # One joint lost.
        rig.send("shoulder", 4)
        rig.publishers["elbow"].publish(lost_transform(4, JointTransform.FAULT_OUT_OF_RANGE, PLATES["elbow"]))
        rig.wait_for_message("no pose: elbow is lost (OUT_OF_RANGE)")
        assert stamp_seconds(rig.poses) == [3]
        # An invalid stamp does not affect the following scans.
        rig.send("shoulder", 5)
        unstamped = transform_of(6, plates=PLATES["shoulder"])
        unstamped.header.stamp.nanosec = 1_000_000_000
        rig.publishers["shoulder"].publish(unstamped)
        rig.wait_for_message("no pose: shoulder: the stamp of a transform is zero")
        rig.send("shoulder", 6, 7)
        rig.send("elbow", 5, 6, 7)
        rig.wait_for_poses(4)
        assert stamp_seconds(rig.poses) == [3, 5, 6, 7]
        values = values_of(graph.wait_for_status("/chain_node: endpoint", "ok"))
        counts = {"scans_refused": "1", "scans_incomplete": "2", "transforms_refused": "1"}
        assert {name: values[name] for name in counts} == counts


def test_shared_terms_of_both_joints_are_added_before_they_are_squared() -> None:
    """The names may change from scan to scan, as after a new calibration; both effects are along Z."""
    size, same = 0.5e-6, (["bench"], ["bench"])
    terms = [same, (["bench"], ["other"]), (["other", "bench"], ["bench"]), ([], []), same]

    def send(second: int, names: tuple[list[str], list[str]], missing: int = 0) -> None:
        for joint, own in zip(PLATES, names, strict=True):
            message = transform_of(second, plates=PLATES[joint])
            effects = [0.0] * (6 * len(own))
            if own:
                effects[-4] = size  # along Z, of the last term
            message.shared_terms, message.shared_effects = own, effects[missing:]
            rig.publishers[joint].publish(message)

    with running() as rig:
        for second, names in enumerate(terms, start=1):
            send(second, names)
        rig.wait_for_poses(len(terms))
        variances = [np.reshape(each.pose.covariance, (6, 6))[2, 2] for each in rig.with_covariance]
        independent = variances[1]
        expected = [independent + added * 2.0 * size**2 for added in (1, 0, 1, 0, 1)]
        np.testing.assert_allclose(variances, expected, rtol=1e-9)
        send(9, same, missing=1)
        rig.wait_for_message("no pose: elbow: JointTransform: a message has 5 shared_effects; expected 6")


@pytest.mark.parametrize("wrong", [2, 900])
def test_a_wrong_stamp_of_one_joint_costs_one_pose(wrong: int) -> None:
    with running() as rig:
        rig.send("shoulder", *(wrong if second == 15 else second for second in range(10, 20)))
        rig.send("elbow", *range(10, 20))
        rig.wait_for_poses(9)
        assert stamp_seconds(rig.poses) == [*range(10, 15), *range(16, 20)]

        def incomplete() -> set[str]:
            statuses = [status for status in rig.graph.diagnostics if status.name == "/chain_node: endpoint"]
            return {values_of(status).get("scans_incomplete", "") for status in statuses}

        rig.graph.wait_until(lambda: "2" in incomplete(), "a report of the wrong stamp and of the scan that lacks it")


def test_a_joint_without_publisher_is_named_and_a_late_joint_is_awaited() -> None:
    parameters = {**LOSSLESS, "max_wait": 0.2, "freshness.max_silence": 0.2}
    with chain_node(urdf=str(URDF), endpoint_frame="t2", **parameters), Graph() as graph:
        rig = ChainRig(graph)
        shoulder = rig.joint_publisher("shoulder")
        status = rig.wait_for_message("no input on /elbow/transform since activation")
        assert status.level == b"\x02"
        assert float(values_of(status)["since"]) > 0.0
        elbow = rig.joint_publisher("elbow")
        shoulder.publish(transform_of(1, plates=PLATES["shoulder"]))
        wait_for_value(graph, "/chain_node: endpoint", "scans_incomplete", "1")
        elbow.publish(transform_of(1, plates=PLATES["elbow"]))
        later = iter(range(2, 1000))

        def both() -> None:
            second = next(later)
            shoulder.publish(transform_of(second, plates=PLATES["shoulder"]))
            elbow.publish(transform_of(second, plates=PLATES["elbow"]))

        graph.wait_until(lambda: bool(rig.poses), "a pose of a scan that is whole", both)
        assert 1 not in stamp_seconds(rig.poses)


def test_a_refused_transform_is_the_reason_of_its_incomplete_scan() -> None:
    """The state says so at once, and again when the scan of the other joint is closed."""
    with running(max_wait=0.2) as rig:
        rig.send("elbow", 1)
        rig.publishers["shoulder"].publish(transform_of(1, plates=("base", "t2")))
        rig.graph.wait_until(lambda: len(rig.states) == 2, "both states")
    for state in rig.states:
        assert (state.header.stamp.sec, state.state, state.joint) == (1, EndpointState.STATE_LOST, "shoulder")
        assert state.reason.startswith("shoulder: transforms from 'base' to 't2' arrive")


@pytest.mark.parametrize("plates", [PLATES["shoulder"], ("base", "t2")])
def test_a_scan_that_lacks_a_joint_or_is_refused_leaves_no_pose_to_take_as_home(plates: tuple[str, str]) -> None:
    """A joint whose stamps differ, as by another clock, while the arm moves on: no topic is silent."""
    with running(reference="home", max_wait=0.05) as rig:
        rig.send("shoulder", 1)
        rig.send("elbow", 1)
        rig.wait_for_poses(1)
        assert call_set_home(rig.graph) == (True, "home is the endpoint's last pose")
        rig.publishers["shoulder"].publish(transform_of(2, plates=plates))
        rig.graph.wait_until(lambda: rig.states[-1].state == EndpointState.STATE_LOST, "the loss")
        assert call_set_home(rig.graph) == (False, "there is no pose now to take as home")


def test_a_beams_file_adds_sag_and_uncertainty_to_the_pose() -> None:
    still = MeasuredJoint(pin.SE3.Identity())
    sag = load_chain(URDF, "t2", BEAMS).estimate(dict.fromkeys(PLATES, still)).T_base_endpoint.translation[2]
    assert sag < -1e-6
    with running(beams=str(BEAMS)) as rig:
        rig.send("shoulder", 1)
        rig.send("elbow", 1)
        rig.wait_for_poses(1)
        assert rig.poses[0].pose.position.z == sag
        covariance = np.reshape(rig.with_covariance[0].pose.covariance, (6, 6))
        assert covariance[0, 0] == pytest.approx(2e-12 + 9e-12, rel=1e-6)
        assert values_of(rig.graph.wait_for_status("/chain_node: endpoint", "ok"))["beams"] == str(BEAMS)


def test_beams_in_motion_sag_differently_from_beams_at_rest() -> None:
    """The shoulder rises ever faster, so the beam weighs a little more than at rest."""
    acceleration = 8e-4  # the last scan is 19.6 mm from the nominal joint; the limit is 20 mm
    scans = 8
    with running(beams=str(BEAMS), acceleration_window=10.0) as rig:
        for second in range(scans):
            up = shifted(0.0, 0.0, 0.5 * acceleration * second**2)
            rig.send("shoulder", second + 1, pose=up)
            rig.send("elbow", second + 1)
        rig.wait_for_poses(scans)
        found = rig.poses[-1].pose.position.z
    chain = load_chain(URDF, "t2", BEAMS)
    joints = {"shoulder": MeasuredJoint(up), "elbow": MeasuredJoint(pin.SE3.Identity())}
    heavier = chain.estimate(joints, {"beam": np.array([0.0, 0.0, acceleration])}).T_base_endpoint
    at_rest = chain.estimate(joints).T_base_endpoint
    assert at_rest.translation[2] - heavier.translation[2] > 2e-11
    assert found == pytest.approx(heavier.translation[2], abs=1e-14)


def test_a_beams_file_of_another_arm_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    beams = tmp_path / "beams.yaml"
    beams.write_text(edited(BEAMS.read_text(encoding="utf-8"), "joint: beam", "joint: boom"), encoding="utf-8")
    parameters = {"urdf": str(URDF), "endpoint_frame": "t2", "beams": str(beams)}
    code, (sentence,) = run_refused_node(ChainNode, parameters, capfd)
    assert code == 1
    assert sentence.startswith(f"URDF {URDF}: has no fixed joint 'boom'")


def test_a_check_for_late_joints_that_is_still_queued_after_the_clean_up_publishes_nothing() -> None:
    with NodeProcess() as process:
        chain = process.start(ChainNode, parameters={"urdf": str(URDF), "endpoint_frame": "t2", **HAND_FED})
        schema = schema_of_class(JointTransform)
        data = schema.serialize(transform_of(1, plates=PLATES["shoulder"]))
        shoulder = next(each for each in chain._transforms if "shoulder" in each.topic_name)
        shoulder.receive(data)
        chain.trigger_deactivate()
        chain.trigger_cleanup()
        time.sleep(2.0 * chain.parameters.max_wait)
        chain._close_late_scans()
        assert chain._scans_incomplete == 1
        assert not chain.exit_requested
