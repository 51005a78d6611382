# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""posor_node and chain_node in one process: equal results, service calls meanwhile, invalid messages."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from contextlib import ExitStack
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor.messages.cdr_schema import STAMP
from posor.messages.message_definitions import MessageTypes
from posor.messages.message_stream import RawScanStream
from posor.messages.raw_scan import ScanTemplate
from posor.node_parameters import NodeParameters
from posor.ros_names import RAW_SCAN as RAW_SCAN_TYPE
from posor_estimator.chain_node import ChainNode
from posor_estimator.posor_node import PosorEstimatorNode
from posor_lab.harness.graph import Graph, values_of
from posor_lab.harness.in_process_nodes import NodeProcess
from posor_lab.harness.message_conversion import stamp_ns
from posor_lab.harness.program import HAND_FED, wait_until
from posor_msgs.msg import EndpointState, JointTransform, RawScan
from posor_ros import diagnostics
from posor_ros.diagnostics import Diagnostics
from posor_ros.intra_process import IntraProcessPublisher, IntraProcessSubscription
from posor_ros.lifecycle_node import PosorNode
from posor_ros.message_classes import schema_of_class
from posor_ros.qos import KEEP_ALL_QOS
from posor_ros.throttled_publisher import PERIOD_NS
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from .chain_program import URDF
from .live_topics import BRINGUP

RAW_SCAN = schema_of_class(RawScan)
JOINT_TRANSFORM = schema_of_class(JointTransform)
pytestmark = pytest.mark.usefixtures("ros_domain")

BAG = BRINGUP / "bags" / "ymo"
LOSSLESS = {"lossless": True, "alarm_count": 1, **HAND_FED}
POSOR = {"calibration": str(BRINGUP / "config" / "slocum1985_printed.yaml"), "session": "ymo", **LOSSLESS}
CHAIN = {"urdf": str(URDF), "max_wait": 60.0, **LOSSLESS}
RESULTS = {
    "/endpoint/pose": PoseStamped,
    "/endpoint/pose_with_covariance": PoseWithCovarianceStamped,
    "/joint_states": JointState,
}


class Source(PosorNode[NodeParameters]):
    """A node that publishes prepared bytes."""

    NAME = "source"
    Parameters = NodeParameters

    def configure(self) -> None:
        self.raw = IntraProcessPublisher(self, RawScan, "raw", KEEP_ALL_QOS)


class Sink(PosorNode[NodeParameters]):
    """A node that stores the bytes of all results by topic."""

    NAME = "sink"
    Parameters = NodeParameters

    def configure(self) -> None:
        self.received: dict[str, list[bytes]] = {topic: [] for topic in RESULTS}
        for topic, kind in RESULTS.items():
            IntraProcessSubscription(self, kind, topic, KEEP_ALL_QOS, self.received[topic].append)


@pytest.fixture(scope="module")
def scans() -> list[bytes]:
    """The raw scans of test YMO, forth and back, a millisecond apart."""
    with Reader(BAG) as reader:
        [connection] = [each for each in reader.connections if each.msgtype == "posor_msgs/msg/RawScan"]
        recorded = [ScanTemplate(bytes(data)) for _, _, data in reader.messages([connection])]
    played = [*recorded, *reversed(recorded)] * 4
    return [template.at(1_000_000 * number, number) for number, template in enumerate(played, start=1)]


class Arm:
    """The graph of the 1985 rig, its nodes distributed over processes."""

    def __init__(self, processes: Sequence[NodeProcess]) -> None:
        self.processes = processes
        cycle = itertools.cycle(processes)
        self.received = next(cycle).start(Sink).received
        self.chain = next(cycle).start(ChainNode, parameters=CHAIN)
        self.posor = next(cycle).start(PosorEstimatorNode, "/joint1", POSOR)
        self.raw = next(cycle).start(Source, "/joint1").raw
        publishers = (
            self.raw,
            self.posor._publisher,
            self.chain._pose,
            self.chain._pose_with_covariance,
            self.chain._joint_states,
        )
        wait_until(
            lambda: all(publisher.subscription_count == 1 for publisher in publishers),
            "a subscription to every topic",
            self.spin_once,
        )

    def spin_once(self) -> None:
        for process in self.processes:
            process.spin_once()

    def results(self, count: int) -> dict[str, list[bytes]]:
        """Return all results once there are ``count`` of each."""
        wait_until(
            lambda: all(len(messages) >= count for messages in self.received.values()), "all results", self.spin_once
        )
        return self.received


def test_the_results_are_the_same_bytes_in_one_process_and_in_four(scans: list[bytes]) -> None:
    results = []
    for count in (1, 4):
        with ExitStack() as stack:
            arm = Arm([stack.enter_context(NodeProcess()) for _ in range(count)])
            for data in scans:
                arm.raw.publish(data)
            results.append(arm.results(len(scans)))
    assert {len(messages) for messages in results[0].values()} == {len(scans)}
    assert results[0] == results[1]


@pytest.mark.parametrize(("kind", "topic"), [(EndpointState, "/endpoint/state"), (JointTransform, "/joint1/transform")])
def test_effects_of_faults_are_computed_while_they_are_read(scans: list[bytes], kind: type[Any], topic: str) -> None:
    field = "protection_level" if kind is EndpointState else "effects"

    def numbers_from(begin: int) -> list[list[float]]:
        """Return the numbers that follow from the effects, received from a scan on."""
        with NodeProcess() as process, Graph() as graph:
            arm = Arm([process])
            for data in scans[:begin]:
                arm.raw.publish(data)
            assert arm.posor._publisher.is_read_whole == (begin == 0)
            received = graph.collect(kind, topic)
            ends = arm.chain._endpoint_state, arm.posor._publisher
            graph.wait_until(lambda: any(end._handle.get_subscription_count() for end in ends), topic, arm.spin_once)
            for data in scans[begin:8]:
                arm.raw.publish(data)
            graph.wait_until(lambda: len(received) == 8 - begin, "messages", arm.spin_once)
            return [list(getattr(message, field)) for message in received]

    always, later = numbers_from(0), numbers_from(3)
    assert not np.isnan(always).any()
    first = 1 if kind is EndpointState else 0  # the transform of the first scan was made before the state was read
    assert np.isnan(later[:first]).all()
    assert later[first:] == always[3 + first :]


def test_throttled_states_have_levels_although_most_scans_have_no_effects(scans: list[bytes]) -> None:
    with NodeProcess() as process, Graph() as graph:
        arm = Arm([process])
        received = graph.collect(EndpointState, "/endpoint/state_throttle")
        graph.wait_until(lambda: arm.chain._throttle.has_subscriptions, "a subscription", arm.spin_once)
        read = []
        for n in range(1, 601):  # at 2 kHz
            read.append(arm.posor._publisher.is_read_whole)
            arm.raw.publish(ScanTemplate(scans[0]).at(n * PERIOD_NS // 100, n))
        graph.wait_until(lambda: len(received) == 7, "a state of each period", arm.spin_once)
    assert [stamp_ns(each) // PERIOD_NS for each in received] == list(range(7))
    assert not np.isnan([each.protection_level for each in received[1:]]).any()
    assert 0 < sum(read[100:]) < 0.3 * len(read[100:])


def test_only_transforms_that_are_due_become_messages_for_the_throttled_topic(
    scans: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = list[int]()
    complete_scan = PosorEstimatorNode.complete_scan

    def complete(node: PosorEstimatorNode, stream: RawScanStream, data: bytes, transform: bytes) -> None:
        made.extend([stream.stamp_change_and_missing()[0]] if transform else [])
        complete_scan(node, stream, data, transform)

    monkeypatch.setattr(PosorEstimatorNode, "complete_scan", complete)
    with NodeProcess() as process, Graph() as graph:
        arm = Arm([process])
        received = graph.collect(JointTransform, "/joint1/transform_throttle")
        graph.wait_until(lambda: arm.posor._throttle.has_subscriptions, "a subscription", arm.spin_once)
        broken = deserialize_message(scans[0], RawScan)
        broken.gap_voltages[0] = math.nan
        templates = {250: ScanTemplate(RAW_SCAN.serialize(broken))}
        for n in range(1, 601):  # at 2 kHz
            arm.raw.publish(templates.get(n, ScanTemplate(scans[0])).at(n * PERIOD_NS // 100, n))
        graph.wait_until(lambda: len(received) == 9, "a transform of each period and change", arm.spin_once)
    numbers = [stamp_ns(each) * 100 // PERIOD_NS for each in received]
    assert numbers == [1, 100, 200, 250, 251, 300, 400, 500, 600]
    assert made == [stamp_ns(each) for each in received]


def test_services_may_be_called_while_scans_come_in_another_thread(scans: list[bytes]) -> None:
    count = 5 * len(scans)
    played = [ScanTemplate(scans[n % len(scans)]).at(1_000_000 * (n + 1), n + 1) for n in range(count)]
    with NodeProcess() as process, Graph() as graph:
        arm = Arm([process])
        ended = Event()

        def publish() -> None:
            for data in played:
                arm.raw.publish(data)
            ended.set()

        thread = Thread(target=publish)
        thread.start()
        answers: list[bool] = []
        client = graph.node.create_client(Trigger, "/joint1/posor_node/reload")
        while not ended.is_set() or len(answers) < 3:
            graph.wait_until(client.service_is_ready, "the service", arm.spin_once)
            answer = client.call_async(Trigger.Request())
            graph.wait_until(answer.done, "an answer", arm.spin_once)
            answers.append(answer.result().success)
        thread.join()
        assert all(answers)
        stamps = [data[STAMP] for data in arm.results(count)["/endpoint/pose"]]
        assert stamps == [data[STAMP] for data in played]
        assert not any(node.exit_requested for node in process.nodes)


def test_invalid_messages_are_refused_and_the_next_scan_is_estimated(scans: list[bytes]) -> None:
    surplus = RAW_SCAN.serialize(RawScan())[:52] + b"\x09\x00\x00\x00" + bytes(300)
    with NodeProcess() as process, Graph() as graph:
        arm = Arm([process])
        graph.watch_diagnostics()

        def wait_for_message(status: str, words: str) -> None:
            graph.wait_until(lambda: words in getattr(graph.latest(status), "message", ""), words, arm.spin_once)

        def publish_and_wait(data: bytes, words: str) -> None:
            arm.raw.publish(data)
            wait_for_message("/joint1/posor_node: estimate", words)

        for data, words in (
            (scans[0][:66], "a message of 66 bytes ends within 'status'; expected at least 68 bytes"),
            (surplus, "a message says that it has 9 gap_voltages; expected at most 8"),
            (b"", "a message begins with bytes ''"),
        ):
            publish_and_wait(data, words)
        assert values_of(graph.latest("/joint1/posor_node: estimate"))["messages_refused"] == "3"
        arm.posor._publisher.publish(JOINT_TRANSFORM.serialize(JointTransform())[:100])
        said = "no pose: joint1: JointTransform: a message of 100 bytes ends within 'covariance_random'"
        graph.wait_until(
            lambda: said in getattr(graph.latest("/chain_node: endpoint"), "message", ""), said, arm.spin_once
        )
        assert not any(arm.received.values())
        publish_and_wait(scans[0], "ok: none")
        assert [len(messages) for messages in arm.received.values()] == [1, 1, 1]
        # The same holds after scans of the same layout; a state that returns is reported again.
        for data, words in ((b"", "a message begins with bytes ''"), (scans[1], "ok: none")):
            publish_and_wait(data, words)


def test_a_publisher_elsewhere_of_a_topic_of_this_process_is_an_error() -> None:
    with NodeProcess() as process, Graph() as graph:
        process.start(Source)
        process.start(PosorEstimatorNode, parameters=POSOR)
        graph.watch_diagnostics()

        def wait_for(text: str) -> None:
            def is_reported() -> bool:
                status = graph.latest("/posor_node: input")
                return status is not None and status.message == text

            graph.wait_until(is_reported, text, process.spin_once)

        wait_for("in time")
        second = graph.node.create_publisher(RawScan, "/raw", KEEP_ALL_QOS)
        wait_for("2 publishers on /raw; expected one")
        graph.node.destroy_publisher(second)
        wait_for("in time")


def test_errors_are_published_by_the_executors_thread_and_logged_if_they_last(
    scans: list[bytes], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    spoiled = deserialize_message(scans[1], RawScan)
    spoiled.gap_voltages[0] = math.nan
    publish, published = Diagnostics._publish, list[Diagnostics]()

    def record_and_publish(reporter: Diagnostics) -> None:
        published.append(reporter)
        publish(reporter)

    monkeypatch.setattr(diagnostics, "LASTING_ERROR_S", 0.0)
    with NodeProcess() as process:
        arm = Arm([process])
        monkeypatch.setattr(Diagnostics, "_publish", record_and_publish)
        thread = Thread(target=lambda: [arm.raw.publish(data) for data in (scans[0], RAW_SCAN.serialize(spoiled))])
        thread.start()
        thread.join()
        assert published == []
        log = [""]

        def logged() -> bool:
            log[0] += capfd.readouterr().err
            return "endpoint: no pose: joint1 is lost (BAD_READING)" in log[0] and "voltage nan" in log[0]

        wait_until(logged, "both errors in the log", arm.spin_once)
        assert "[joint1.posor_node]: estimate: lost: BAD_READING; scan 2, gap probe probe_1: voltage nan" in log[0]
        assert {arm.posor.diagnostics, arm.chain.diagnostics} <= set(published)


def test_a_scan_in_the_other_byte_order_has_the_same_result(scans: list[bytes]) -> None:
    types, template = MessageTypes(), ScanTemplate(scans[0])
    types.definition(RAW_SCAN_TYPE)
    store = types._store
    little = [template.at(stamp_ns, 7) for stamp_ns in (1, 2, 3)]
    message = store.deserialize_cdr(little[1], RAW_SCAN_TYPE)
    big = bytes(store.serialize_cdr(message, RAW_SCAN_TYPE, little_endian=False))
    assert big[:2] == b"\x00\x00"
    results = []
    for played in (little, [little[0], big, little[2]]):
        with NodeProcess() as process:
            arm = Arm([process])
            for data in played:
                arm.raw.publish(data)
            results.append(arm.results(len(played)))
    assert results[0] == results[1]
