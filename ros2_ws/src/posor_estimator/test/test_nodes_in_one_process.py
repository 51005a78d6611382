"""posor_node and chain_node in one process: the same numbers as apart, while services are called, and bad bytes."""

from __future__ import annotations

import itertools
import math
from contextlib import ExitStack
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING

import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor_estimator.chain_node import ChainNode
from posor_estimator.posor_node import PosorEstimatorNode
from posor_estimator.ros import diagnostics
from posor_estimator.ros.cdr import STAMP
from posor_estimator.ros.cdr_scan import RAW_SCAN, ScanTemplate
from posor_estimator.ros.cdr_transform import JOINT_TRANSFORM
from posor_estimator.ros.diagnostics import Diagnostics
from posor_estimator.ros.message_types import RAW_SCAN as RAW_SCAN_TYPE
from posor_estimator.ros.message_types import MessageTypes
from posor_estimator.ros.node import PosorNode
from posor_estimator.ros.parameters import NodeParameters
from posor_estimator.ros.qos import KEEP_ALL_QOS
from posor_estimator.ros.wire import Inlet, Outlet
from posor_estimator.testing.graph import Graph, values_of
from posor_estimator.testing.process import Process
from posor_estimator.testing.program import wait_until
from posor_msgs.msg import JointTransform, RawScan
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

if TYPE_CHECKING:
    from collections.abc import Sequence

pytestmark = pytest.mark.usefixtures("ros_domain")

BRINGUP = Path(__file__).resolve().parents[2] / "posor_bringup"
BAG = BRINGUP / "bags" / "ymo"
LOSSLESS = {"qos_reliability": "reliable", "qos_depth": 0}
POSOR = {"calibration": str(BRINGUP / "config" / "slocum1985_printed.yaml"), "session": "ymo", **LOSSLESS}
CHAIN = {"urdf": str(BRINGUP / "urdf" / "slocum1985_rig.urdf"), "max_wait": 60.0, **LOSSLESS}
RESULTS = {
    "/endpoint/pose": PoseStamped,
    "/endpoint/pose_with_covariance": PoseWithCovarianceStamped,
    "/joint_states": JointState,
}


class Source(PosorNode[NodeParameters]):
    """Publishes bytes as they are."""

    NAME = "source"
    Parameters = NodeParameters

    def configure(self) -> None:
        self.raw = Outlet(self, RawScan, "raw", KEEP_ALL_QOS)


class Sink(PosorNode[NodeParameters]):
    """Keeps the bytes of all results, by topic."""

    NAME = "sink"
    Parameters = NodeParameters

    def configure(self) -> None:
        self.taken: dict[str, list[bytes]] = {topic: [] for topic in RESULTS}
        for topic, kind in RESULTS.items():
            Inlet(self, kind, topic, KEEP_ALL_QOS, self.taken[topic].append)


@pytest.fixture(scope="module")
def scans() -> list[bytes]:
    """The raw scans of test YMO, forth and back, a millisecond apart."""
    with Reader(BAG) as reader:
        [connection] = [each for each in reader.connections if each.msgtype == "posor_msgs/msg/RawScan"]
        recorded = [ScanTemplate(bytes(data)) for _, _, data in reader.messages([connection])]
    played = [*recorded, *reversed(recorded)] * 4
    return [template.at(1_000_000 * number, number) for number, template in enumerate(played, start=1)]


class Arm:
    """The rig's graph, its nodes spread over processes in turn."""

    def __init__(self, processes: Sequence[Process]) -> None:
        self.processes = processes
        turns = itertools.cycle(processes)
        self.taken = next(turns).start(Sink).taken
        self.chain = next(turns).start(ChainNode, parameters=CHAIN)
        self.posor = next(turns).start(PosorEstimatorNode, "/joint1", POSOR)
        self.raw = next(turns).start(Source, "/joint1").raw
        outlets = (self.raw, self.posor._outlet, self.chain._pose, self.chain._full_pose, self.chain._joint_states)
        wait_until(lambda: all(outlet.count == 1 for outlet in outlets), "a listener of every topic", self.turn)

    def turn(self) -> None:
        for process in self.processes:
            process.turn()

    def results(self, count: int) -> dict[str, list[bytes]]:
        """Return what has come once it is all there."""
        wait_until(lambda: all(len(messages) >= count for messages in self.taken.values()), "all results", self.turn)
        return self.taken


def test_the_results_are_the_same_bytes_in_one_process_as_in_four(scans: list[bytes]) -> None:
    results = []
    for count in (1, 4):
        with ExitStack() as stack:
            arm = Arm([stack.enter_context(Process()) for _ in range(count)])
            for data in scans:
                arm.raw.publish(data)
            results.append(arm.results(len(scans)))
    assert {len(messages) for messages in results[0].values()} == {len(scans)}
    assert results[0] == results[1]


def test_services_may_be_called_while_scans_come_in_another_thread(scans: list[bytes]) -> None:
    with Process() as process, Graph() as graph:
        arm = Arm([process])
        ended = Event()

        def publish() -> None:
            for data in scans * 5:
                arm.raw.publish(data)
            ended.set()

        thread = Thread(target=publish)
        thread.start()
        answers: list[bool] = []
        client = graph.node.create_client(Trigger, "/joint1/posor_node/reload")
        while not ended.is_set() or len(answers) < 3:
            graph.wait_until(client.service_is_ready, "the service", arm.turn)
            answer = client.call_async(Trigger.Request())
            graph.wait_until(answer.done, "an answer", arm.turn)
            answers.append(answer.result().success)
        thread.join()
        assert all(answers)
        stamps = [data[STAMP] for data in arm.results(5 * len(scans))["/endpoint/pose"]]
        assert stamps == [data[STAMP] for data in scans] * 5
        assert not any(node.exit_requested for node in process.nodes)


def test_bytes_that_are_no_message_are_refused_and_told_and_the_next_scan_is_found(scans: list[bytes]) -> None:
    surplus = RAW_SCAN.serialize(RawScan())[:36] + b"\x09\x00\x00\x00" + bytes(300)
    with Process() as process, Graph() as graph:
        arm = Arm([process])
        graph.watch_diagnostics()

        def says(data: bytes, words: str) -> None:
            arm.raw.publish(data)
            line = "/joint1/posor_node: estimate"
            graph.wait_until(lambda: words in getattr(graph.latest(line), "message", ""), words, arm.turn)

        for data, words in (
            (scans[0][:50], "a message of 50 bytes ends within 'status'; expected at least 52 bytes"),
            (surplus, "a message says that it has 9 gap_voltages; expected at most 8"),
            (b"", "cannot be read"),
        ):
            says(data, words)
        assert values_of(graph.latest("/joint1/posor_node: estimate"))["messages_refused"] == "3"
        arm.posor._outlet.publish(JOINT_TRANSFORM.serialize(JointTransform())[:100])
        said = "no pose: joint1: JointTransform: a message of 100 bytes ends within 'covariance'"
        graph.wait_until(lambda: said in getattr(graph.latest("/chain_node: endpoint"), "message", ""), said, arm.turn)
        assert not any(arm.taken.values())
        says(scans[0], "ok: none")
        assert [len(messages) for messages in arm.taken.values()] == [1, 1, 1]
        # So it is where scans of the same kind came before; what holds again is said again.
        for data, words in ((b"", "cannot be read"), (scans[1], "ok: none")):
            says(data, words)


def test_what_is_wrong_is_said_in_the_executors_thread_and_logged_where_it_lasts(
    scans: list[bytes], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    spoiled = deserialize_message(scans[1], RawScan)
    spoiled.gap_voltages[0] = math.nan
    publish, published = Diagnostics._publish, list[Diagnostics]()

    def noted(told: Diagnostics) -> None:
        published.append(told)
        publish(told)

    monkeypatch.setattr(diagnostics, "LASTING_S", 0.0)
    with Process() as process:
        arm = Arm([process])
        monkeypatch.setattr(Diagnostics, "_publish", noted)
        thread = Thread(target=lambda: [arm.raw.publish(data) for data in (scans[0], RAW_SCAN.serialize(spoiled))])
        thread.start()
        thread.join()
        assert published == []
        said = [""]

        def logged() -> bool:
            said[0] += capfd.readouterr().err
            return "endpoint: no pose: joint1 is lost (BAD_READING)" in said[0] and "voltage nan" in said[0]

        wait_until(logged, "both errors in the log", arm.turn)
        assert "[joint1.posor_node]: estimate: lost: BAD_READING; scan 2, gap probe probe_1: voltage nan" in said[0]
        assert {arm.posor.diagnostics, arm.chain.diagnostics} <= set(published)


def test_a_scan_in_the_other_byte_order_is_located_alike(scans: list[bytes]) -> None:
    types, template = MessageTypes(), ScanTemplate(scans[0])
    types.definition(RAW_SCAN_TYPE)
    store = types._store
    little = [template.at(stamp_ns, 7) for stamp_ns in (1, 2, 3)]
    message = store.deserialize_cdr(little[1], RAW_SCAN_TYPE)
    big = bytes(store.serialize_cdr(message, RAW_SCAN_TYPE, little_endian=False))
    assert big[:2] == b"\x00\x00"
    results = []
    for played in (little, [little[0], big, little[2]]):
        with Process() as process:
            arm = Arm([process])
            for data in played:
                arm.raw.publish(data)
            results.append(arm.results(len(played)))
    assert results[0] == results[1]
