from __future__ import annotations

from posor_estimator.node_parameters import NodeParameters
from posor_estimator.ros.qos import RELIABLE_QOS, result_qos, sensor_qos
from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy


def test_sensor_topics_are_best_effort_with_small_depth_by_default() -> None:
    qos = sensor_qos(NodeParameters())
    assert (qos.reliability, qos.history, qos.depth) == (ReliabilityPolicy.BEST_EFFORT, HistoryPolicy.KEEP_LAST, 10)
    assert qos.durability == DurabilityPolicy.VOLATILE


def test_parameters_override_the_sensor_profile() -> None:
    qos = sensor_qos(NodeParameters(qos_reliability="reliable", qos_depth=3))
    assert (qos.reliability, qos.history, qos.depth) == (ReliabilityPolicy.RELIABLE, HistoryPolicy.KEEP_LAST, 3)
    assert sensor_qos(NodeParameters(qos_depth=0)).history == HistoryPolicy.KEEP_ALL


def test_everything_else_is_reliable() -> None:
    assert RELIABLE_QOS.reliability == ReliabilityPolicy.RELIABLE


def test_results_are_reliable_and_keep_all_where_the_sensor_topics_do() -> None:
    assert result_qos(NodeParameters()) == RELIABLE_QOS
    lossless = result_qos(NodeParameters(qos_depth=0))
    assert (lossless.history, lossless.reliability) == (HistoryPolicy.KEEP_ALL, ReliabilityPolicy.RELIABLE)
