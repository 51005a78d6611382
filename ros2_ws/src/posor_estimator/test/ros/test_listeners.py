from __future__ import annotations

from pathlib import Path

import pytest
from geometry_msgs.msg import PoseStamped
from posor_estimator.ros.listeners import STATUS
from posor_estimator.testing.graph import Graph, values_of
from posor_estimator.testing.program import Program, installed, ros_arguments

pytestmark = pytest.mark.usefixtures("ros_domain")

URDF = Path(__file__).resolve().parents[3] / "posor_bringup" / "urdf" / "slocum1985_rig.urdf"


def test_a_node_tells_who_listens_as_they_come_and_go() -> None:
    chain = [*installed("posor_estimator", "chain_node"), *ros_arguments({"urdf": str(URDF)})]
    name = f"/chain_node: {STATUS}"
    with Graph() as graph, Program(chain) as node:
        graph.watch_diagnostics()
        nobody = graph.wait_for_status(name, "joint_states 0")  # the last topic that the node opens
        counts = {name: value for name, value in values_of(nobody).items() if name != "since"}
        assert counts == {"endpoint/pose": "0", "endpoint/pose_with_covariance": "0", "joint_states": "0"}
        subscriptions = [graph.node.create_subscription(PoseStamped, "endpoint/pose", print, 10) for _ in range(2)]
        assert values_of(graph.wait_for_status(name, "endpoint/pose 2"))["joint_states"] == "0"
        graph.node.destroy_subscription(subscriptions[0])
        graph.wait_for_status(name, "endpoint/pose 1")
        assert node.end() == 0
