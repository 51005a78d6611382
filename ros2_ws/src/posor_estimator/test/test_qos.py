# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest
from posor.node_parameters import NodeParameters
from posor_estimator.posor_node import PosorEstimatorNode
from posor_lab.harness.graph import Graph
from posor_lab.harness.in_process_nodes import NodeProcess, run_refused_node
from posor_lab.harness.rig_files import calibration_path
from posor_ros.qos import RELIABLE_QOS, input_qos, result_qos
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

POSOR = {"calibration": str(calibration_path("printed"))}
RAW = "qos_overrides./joint1/raw.subscription."
UNKNOWN = ": this node has no such topic, direction or policy; expected perhaps"


def policies(qos: QoSProfile) -> tuple[ReliabilityPolicy, HistoryPolicy, int]:
    return qos.reliability, qos.history, qos.depth


def test_sensor_topics_are_published_reliably_and_received_best_effort() -> None:
    publisher, subscription = result_qos(NodeParameters()), input_qos(NodeParameters())
    assert policies(publisher) == (ReliabilityPolicy.RELIABLE, HistoryPolicy.KEEP_LAST, 10)
    assert policies(subscription) == (ReliabilityPolicy.BEST_EFFORT, HistoryPolicy.KEEP_LAST, 10)
    assert publisher.durability == subscription.durability == DurabilityPolicy.VOLATILE


def test_lossless_nodes_keep_all_messages_at_both_ends() -> None:
    lossless = NodeParameters(lossless=True)
    for qos in (result_qos(lossless), input_qos(lossless)):
        assert (qos.reliability, qos.history) == (ReliabilityPolicy.RELIABLE, HistoryPolicy.KEEP_ALL)
    assert result_qos(NodeParameters()) == RELIABLE_QOS


@pytest.mark.usefixtures("ros_domain")
def test_overrides_change_one_topic_of_one_node_also_after_a_clean_up() -> None:
    transform = "qos_overrides./joint1/transform.publisher."
    values = {f"{RAW}reliability": "reliable", f"{RAW}depth": 3, f"{transform}reliability": "best_effort"}
    with NodeProcess() as process, Graph() as graph:
        node = process.start(PosorEstimatorNode, "/joint1", {**POSOR, **values})

        def received() -> list[TopicEndpointInfo]:
            return list(graph.node.get_subscriptions_info_by_topic("/joint1/raw"))

        def published() -> list[TopicEndpointInfo]:
            return list(graph.node.get_publishers_info_by_topic("/joint1/transform"))

        for _ in range(2):
            graph.wait_until(lambda: len(received()) == len(published()) == 1, "both topics", process.spin_once)
            assert received()[0].qos_profile.reliability == ReliabilityPolicy.RELIABLE
            assert published()[0].qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
            assert node.get_parameter(f"{RAW}depth").value == 3
            (changed,) = node.set_parameters([Parameter(f"{RAW}depth", value=7)])
            assert not changed.successful
            for change in (
                node.trigger_deactivate,
                node.trigger_cleanup,
                node.trigger_configure,
                node.trigger_activate,
            ):
                change()
    assert QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE) == RELIABLE_QOS


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize(
    ("name", "value", "fault"),
    [
        (f"{RAW}reliability", "relaible", " is 'relaible'; expected reliable or best_effort."),
        (f"{RAW}history", "all", " is 'all'; expected keep_last or keep_all."),
        (f"{RAW}depth", 0, " is 0; expected an integer at least 1 and at most 100000."),
        (f"{RAW}depth", "10 scans", " is '10 scans'; expected an integer at least 1 and at most 100000."),
        ("qos_overrides./joint1/rwa.subscription.depth", 5, f"{UNKNOWN} '{RAW}depth'."),
        (
            "qos_overrides./joint1/raw.publisher.depth",
            5,
            f"{UNKNOWN} 'qos_overrides./joint1/transform.publisher.depth'.",
        ),
    ],
)
def test_a_wrong_override_is_refused(name: str, value: object, fault: str, capfd: pytest.CaptureFixture[str]) -> None:
    exit_code, errors = run_refused_node(PosorEstimatorNode, {**POSOR, name: value}, capfd, "/joint1")
    assert exit_code == 2
    assert errors[-1] == f"node /joint1/posor_node: '{name}'{fault}"
