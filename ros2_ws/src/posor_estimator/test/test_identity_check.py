# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""EndpointState.identity of chain_node, and an arm that differs from its commissioning record."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from posor.chain.commissioning_record import CommissionedFiles, CommissioningContent
from posor.chain.identity import ArmIdentity, file_sha256
from posor_estimator.chain_node import ChainNode
from posor_lab.harness.graph import Graph
from posor_lab.harness.in_process_nodes import run_refused_node
from posor_msgs.msg import EndpointState, JointTransform

from .chain_program import URDF, chain_node, transform_of

pytestmark = pytest.mark.usefixtures("ros_domain")

COMMISSIONED, OTHER = 0x00AB, 0xFFF8000000000001
FILES = ArmIdentity({}, file_sha256(URDF), "")


def write_record(path: Path, **changes: Any) -> str:
    """Write a record of the rig and return its identity."""
    files = {"calibrations": {"joint1": f"{COMMISSIONED:016x}"}, "urdf": FILES.urdf, "beams": "", **changes}
    content = CommissioningContent(
        arm="rig", serial="", date="", software="", files=CommissionedFiles(**files), checks=(), limits={}
    )
    path.write_text(json.dumps(content.record().model_dump(mode="json")), encoding="utf-8")
    return content.record().identity


class Rig:
    """A chain_node and what it says about scans."""

    def __init__(self, graph: Graph) -> None:
        self.graph, self.second = graph, 0
        self.states: list[Any] = graph.collect(EndpointState, "endpoint/state")
        self.publisher = graph.publisher(JointTransform, "joint1/transform")
        graph.wait_until(lambda: bool(self.states), "a state")

    def state_of(self, calibration: int, state: int = JointTransform.STATE_OK, faults: int = 0) -> Any:
        """Return the state of a scan of one calibration."""
        self.second += 1
        message = transform_of(self.second)
        message.calibration, message.state, message.faults = calibration, state, faults
        self.publisher.publish(message)

        def found() -> list[Any]:
            return [
                s for s in self.states if s.header.stamp.sec == self.second and s.state != EndpointState.STATE_STALE
            ]

        self.graph.wait_until(lambda: bool(found()), "the state")
        return found()[0]


PARAMETERS = {"urdf": str(URDF), "lossless": True, "freshness.max_age": float("inf")}


def test_the_identity_follows_the_calibrations_in_force() -> None:
    with chain_node(**PARAMETERS) as node, Graph() as graph:
        rig = Rig(graph)
        assert rig.states[-1].identity == ""
        seen = [rig.state_of(number) for number in (COMMISSIONED, OTHER, COMMISSIONED)]
        assert [each.identity for each in seen] == [
            FILES.with_calibrations({"joint1": number}, "").sha256 for number in (COMMISSIONED, OTHER, COMMISSIONED)
        ]
        assert {each.state for each in seen} == {EndpointState.STATE_OK}
        assert node.end() == 0


def test_another_calibration_than_the_commissioned_one_degrades_the_endpoint_at_once(tmp_path: Path) -> None:
    identity = write_record(tmp_path / "record.json")
    with chain_node(**PARAMETERS, commissioning=str(tmp_path / "record.json")) as node, Graph() as graph:
        rig = Rig(graph)
        sound, other = rig.state_of(COMMISSIONED), rig.state_of(OTHER)
        assert (sound.state, sound.identity, sound.reason) == (EndpointState.STATE_OK, identity, "")
        assert (other.state, other.joint) == (EndpointState.STATE_DEGRADED, "joint1")
        assert other.reason == ("not as commissioned: calibration of joint1 is fff8000000000001, not 00000000000000ab")
        assert other.identity not in {identity, ""}
        assert other.pose.position.x == sound.pose.position.x
        both = rig.state_of(OTHER, JointTransform.STATE_DEGRADED, JointTransform.FAULT_TIME)
        assert both.reason == f"degraded: joint1 (TIME); {other.reason}"
        assert rig.state_of(COMMISSIONED).identity == identity
        assert node.end() == 0


def test_a_chain_that_requires_the_commissioned_arm_gives_no_pose_of_another(tmp_path: Path) -> None:
    write_record(tmp_path / "record.json", urdf="0" * 64)
    options = {"commissioning": str(tmp_path / "record.json"), "require_commissioned": True}
    with chain_node(**PARAMETERS, **options) as node, Graph() as graph:
        state = Rig(graph).state_of(COMMISSIONED)
        assert (state.state, state.reason) == (EndpointState.STATE_LOST, "not as commissioned: another URDF")
        assert math.isnan(state.pose.position.x)
        assert node.end() == 0


def test_records_of_other_joints_and_missing_records_are_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    write_record(tmp_path / "record.json", calibrations={"elbow": "0" * 16})
    record = str(tmp_path / "record.json")
    code, lines = run_refused_node(ChainNode, {**PARAMETERS, "commissioning": record}, capfd)
    assert (code, lines) == (1, [f"commissioning record {record}: joints elbow; expected joint1."])
    code, lines = run_refused_node(ChainNode, {**PARAMETERS, "require_commissioned": True}, capfd)
    assert code == 2
    assert "'require_commissioned' is true without 'commissioning'" in lines[0]
