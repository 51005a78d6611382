# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The scans of a tick of an arm in one process: one compiled call, the endpoint first, the bytes of single scans."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from functools import partial
from itertools import pairwise, product
from pathlib import Path
from threading import Event, RLock, Thread
from types import MappingProxyType
from typing import Any
from unittest.mock import Mock

import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from posor.bags.bag_reader import opened_bag
from posor.bags.block_reader import read_messages
from posor.chain.arm_file import ArmFile, load_arm_file
from posor.messages.arm_pass import ArmPass
from posor.messages.cdr_schema import STAMP
from posor.messages.joint_transform import stamp_ns_of
from posor.messages.message_stream import RawScanStream
from posor.messages.raw_scan import ScanTemplate
from posor.node_parameters import NodeParameters
from posor.ros_names import (
    ENDPOINT_COVARIANCE_TOPIC,
    ENDPOINT_STATE_TOPIC,
    ENDPOINT_TOPIC,
    PREDICTED_TOPIC,
    RAW_TOPIC,
    TRANSFORM_TOPIC,
)
from posor_bringup.arm_programs import arm_programs
from posor_estimator.composition_file import load_node_class
from posor_lab.harness.in_process_nodes import NodeProcess
from posor_lab.harness.program import HAND_FED, wait_until
from posor_msgs.msg import EndpointState, JointTransform, RawScan
from posor_ros.delivery_round import DeliveryRound
from posor_ros.intra_process import IntraProcessPublisher, IntraProcessSubscription
from posor_ros.lifecycle_node import PosorNode
from posor_ros.qos import KEEP_ALL_QOS
from sensor_msgs.msg import JointState

pytestmark = pytest.mark.usefixtures("ros_domain")

ROOT = Path(__file__).resolve().parents[4]
ARM = ROOT / "ros2_ws/src/posor_bringup/arms/five_axis/arm.yaml"
BAG = ROOT / "bags/five_axis"
TICKS = 40

Scan = tuple[str, bytes]  # joint and serialised RawScan
Change = Callable[[list[list[Scan]]], list[list[Scan]]]


class Feeder(PosorNode[NodeParameters]):
    """Publishes raw scans of all joints and stores the bytes of all results by topic."""

    NAME = "feeder"
    Parameters = NodeParameters

    def open(self, arm: ArmFile, namespace: str = "") -> None:
        joints, namespace = list(arm.calibrations), namespace or arm.namespace
        names = {joint: f"{namespace}/{joint}" for joint in joints}
        results: dict[str, type] = {f"{names[joint]}/{TRANSFORM_TOPIC}": JointTransform for joint in joints}
        results[f"{namespace}/{ENDPOINT_TOPIC}"] = PoseStamped
        results[f"{namespace}/{ENDPOINT_COVARIANCE_TOPIC}"] = PoseWithCovarianceStamped
        self.received: dict[str, list[bytes]] = {topic: [] for topic in results}
        for topic, kind in results.items():
            IntraProcessSubscription(self, kind, topic, KEEP_ALL_QOS, self.received[topic].append)
        states = f"{namespace}/{ENDPOINT_STATE_TOPIC}"  # with a reader, so that transforms have all fault effects
        IntraProcessSubscription(self, EndpointState, states, KEEP_ALL_QOS, lambda _: None)
        self.raw = {joint: self.publisher(f"{names[joint]}/{RAW_TOPIC}") for joint in joints}

    def publisher(self, topic: str) -> IntraProcessPublisher:
        return IntraProcessPublisher(self, RawScan, topic, KEEP_ALL_QOS)

    def feed(self, rounds: list[list[Scan]], *, together: bool) -> None:
        """Publish scans; ``together``: each list is a round, otherwise each scan is delivered by itself."""
        for scans in rounds:
            with DeliveryRound() if together else nullcontext():
                for joint, data in scans:
                    self.raw[joint].publish(data)


@pytest.fixture(scope="module")
def arm() -> ArmFile:
    return load_arm_file(ARM)


@pytest.fixture(scope="module")
def ticks(arm: ArmFile) -> list[list[Scan]]:
    """The raw scans of a simulated recording, tick by tick, in the order of the joints."""
    with opened_bag(BAG) as reader:
        by_joint = {
            joint: [data for _, _, data in read_messages(reader, (f"{arm.namespace}/{joint}/{RAW_TOPIC}",), str(BAG))]
            for joint in arm.calibrations
        }
    return [[(joint, scans[tick]) for joint, scans in by_joint.items()] for tick in range(TICKS)]


def start_nodes(
    process: NodeProcess, arm: ArmFile, namespace: str = "", of_chain: Mapping[str, object] = MappingProxyType({})
) -> dict[str, PosorNode[Any]]:
    """Start the nodes of an arm, in another namespace if one is given; return them by namespace.

    ``of_chain``: further parameters of chain_node.
    """
    nodes = dict[str, PosorNode[Any]]()
    for program in arm_programs(arm, drivers=False, parameters=HAND_FED):
        own = program.namespace.replace(arm.namespace, namespace or arm.namespace)
        # Single scans of a tick may come in any time: a loaded host may be long in opening a stream.
        further = {"max_wait": 60.0, **of_chain} if program.namespace == arm.namespace else {}
        nodes[own] = process.start(load_node_class(program.executable), own, {**program.parameters, **further})
    return nodes


def feed(arm: ArmFile, rounds: list[list[Scan]], *, together: bool) -> dict[str, list[bytes]]:
    """Return all results by topic, see ``Feeder.feed``, and the counts of chain_node."""
    with NodeProcess() as process:
        chain: Any = start_nodes(process, arm)[arm.namespace]
        feeder = process.start(Feeder)
        feeder.open(arm)
        feeder.feed(rounds, together=together)
        return {**feeder.received, "counts": [repr(chain._counts()).encode()]}


@pytest.fixture(scope="module")
def in_rounds(arm: ArmFile, ticks: list[list[Scan]]) -> dict[str, list[bytes]]:
    """Return the results of the ticks, each in a round."""
    return feed(arm, ticks, together=True)


def without_a_joint(ticks: list[list[Scan]]) -> list[list[Scan]]:
    """Leave out a scan of another joint in every third round."""
    return [
        scans if number % 3 else [scan for k, scan in enumerate(scans) if k != number // 3 % len(scans)]
        for number, scans in enumerate(ticks)
    ]


def two_ticks_in_a_round(ticks: list[list[Scan]]) -> list[list[Scan]]:
    return [[*first, *second] for first, second in zip(ticks[::2], ticks[1::2], strict=True)]


def one_joint_ahead(ticks: list[list[Scan]]) -> list[list[Scan]]:
    """Deliver the scans of the first joint one round earlier than those of the others."""
    following = [scans[0] for scans in ticks[1:]]
    return [[ticks[0][0]], *([*scans[1:], ahead] for scans, ahead in zip(ticks, following, strict=False))]


def one_joint_ahead_later(ticks: list[list[Scan]]) -> list[list[Scan]]:
    """Leave out a scan of the first joint; its scans are then a tick ahead of the others in each round."""
    return [*ticks[:5], *([later[0], *scans[1:]] for scans, later in pairwise(ticks[5:]))]


def a_scan_that_stays_open(ticks: list[list[Scan]]) -> list[list[Scan]]:
    """Deliver a scan of the first joint early, that of the second after the next tick, and none of the others."""
    return [*ticks[:10], ticks[10][:1], ticks[11], ticks[10][1:2], *ticks[12:]]


def a_stamp_that_stands(ticks: list[list[Scan]]) -> list[list[Scan]]:
    """Deliver the last tick again, with other numbers."""
    number = TICKS + 10**6
    again = [(joint, ScanTemplate(data).at(stamp_ns_of(data[STAMP]), number)) for joint, data in ticks[-1]]
    return [*ticks, again]


def with_useless_messages(ticks: list[list[Scan]]) -> list[list[Scan]]:
    """Cut a scan, repeat a scan, and begin in the middle, where no stream is open."""
    changed = [list(scans) for scans in ticks[3:]]
    joint, data = changed[5][2]
    changed[5][2] = joint, data[:50]
    changed[9][1] = changed[8][1]
    return changed


@pytest.mark.parametrize(
    "change",
    [
        list,
        without_a_joint,
        two_ticks_in_a_round,
        one_joint_ahead,
        one_joint_ahead_later,
        a_scan_that_stays_open,
        a_stamp_that_stands,
        with_useless_messages,
    ],
)
def test_scans_of_a_round_give_the_bytes_of_single_scans(arm: ArmFile, ticks: list[list[Scan]], change: Change) -> None:
    rounds = change(ticks)
    expected = feed(arm, rounds, together=False)
    assert len(expected[f"{arm.namespace}/{ENDPOINT_TOPIC}"]) > len(ticks) // 2
    assert feed(arm, rounds, together=True) == expected


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[str | int]:
    """The compiled calls: "arm" for scans and endpoint in one, or the number of the scans that run by themselves."""
    found, run, run_arm = list[str | int](), RawScanStream.run_prepared, ArmPass.run

    def noted_run(streams: tuple[RawScanStream, ...]) -> None:
        found.append(len(streams))
        run(streams)

    def noted_run_of_arm(arm_pass: ArmPass, stamp_ns: int) -> int | None:
        found.append("arm")
        return run_arm(arm_pass, stamp_ns)

    monkeypatch.setattr(RawScanStream, "run_prepared", staticmethod(noted_run))
    monkeypatch.setattr(ArmPass, "run", noted_run_of_arm)
    return found


def test_a_round_takes_one_compiled_call_and_the_endpoint_leaves_first(
    arm: ArmFile, ticks: list[list[Scan]], calls: list[str | int], monkeypatch: pytest.MonkeyPatch
) -> None:
    published = list[str]()
    publish = IntraProcessPublisher.publish_over_dds

    def noted_publish(publisher: IntraProcessPublisher, data: bytes) -> bool:
        published.append(publisher.message_type.__name__)
        return publish(publisher, data)

    monkeypatch.setattr(IntraProcessPublisher, "publish_over_dds", noted_publish)
    feed(arm, ticks, together=True)
    joints = len(arm.calibrations)
    assert calls == [0, *["arm"] * (len(ticks) - 1)]  # the first scans open the streams
    last = published[-published[::-1].index("RawScan") :]
    assert last.index("PoseStamped") < last.index("JointTransform")
    assert last.count("JointTransform") == joints


def test_a_new_calibration_and_a_lost_scan_give_the_bytes_of_single_scans(
    arm: ArmFile, ticks: list[list[Scan]], calls: list[str | int]
) -> None:
    """The transforms of a new calibration have other bytes, and a scan that begins anew needs more than the kernels."""
    joint, results = list(arm.calibrations)[1], []
    for together in (False, True):
        with NodeProcess() as process:
            nodes = start_nodes(process, arm)
            feeder = process.start(Feeder)
            feeder.open(arm)
            node: Any = nodes[f"{arm.namespace}/{joint}"]
            calls.clear()
            feeder.feed(ticks[:10], together=together)
            node._use_calibration(node._calibration.model_copy(update={"name": "another"}))
            feeder.feed(ticks[10:20], together=together)
            node._posor.tracker["initialised"] = 0
            feeder.feed(ticks[20:], together=together)
            results.append(feeder.received)
    assert results[0] == results[1]
    assert len(results[0][f"{arm.namespace}/{ENDPOINT_TOPIC}"]) > len(ticks) // 2
    of_new_stream = len(arm.calibrations) - 1
    assert calls == [0, *["arm"] * 9, of_new_stream, *["arm"] * (len(ticks) - 11)]


@pytest.mark.parametrize("over_dds", [False, True])
def test_a_later_reader_receives_transforms_that_are_taken(
    arm: ArmFile, ticks: list[list[Scan]], calls: list[str | int], monkeypatch: pytest.MonkeyPatch, *, over_dds: bool
) -> None:
    joint, received, published = list(arm.calibrations)[2], list[bytes](), list[type]()
    publish = IntraProcessPublisher.publish_over_dds

    def noted_publish(publisher: IntraProcessPublisher, data: bytes) -> bool:
        published.append(publisher.message_type)
        return publish(publisher, data)

    with NodeProcess() as process, NodeProcess() as other:
        nodes = start_nodes(process, arm)
        feeder, reader = process.start(Feeder), (other if over_dds else process).start(Feeder)
        feeder.raw = {name: feeder.publisher(f"{arm.namespace}/{name}/{RAW_TOPIC}") for name in arm.calibrations}
        publishers = [nodes[f"{arm.namespace}/{name}"]._publisher for name in arm.calibrations]  # type: ignore[attr-defined]
        feeder.feed(ticks[:1], together=True)
        wait_until(
            lambda: all(each.subscription_count == 1 for each in publishers),
            "no reader but the chain",
            process.spin_once,
        )
        monkeypatch.setattr(IntraProcessPublisher, "publish_over_dds", noted_publish)
        feeder.feed(ticks[1:5], together=True)
        assert JointTransform not in published  # nobody reads them as messages
        topic = publishers[2].topic_name
        subscription = IntraProcessSubscription(reader, JointTransform, topic, KEEP_ALL_QOS, received.append)
        wait_until(lambda: publishers[2].subscription_count == 2, "a match", other.spin_once)
        wait_until(lambda: subscription.publishers == 1, "its match", subscription.find_publishers)
        for number, scans in enumerate(ticks[5:], start=1):
            feeder.feed([scans], together=True)
            wait_until(lambda count=number: len(received) == count, "a transform", other.spin_once)  # type: ignore[misc]
    assert [data[STAMP] for data in received] == [dict(scans)[joint][STAMP] for scans in ticks[5:]]
    assert calls == [0, *["arm"] * (len(ticks) - 1)]


@pytest.mark.parametrize("in_round", [False, True])
def test_scans_that_a_pose_causes_give_the_same_bytes(
    arm: ArmFile, ticks: list[list[Scan]], in_rounds: dict[str, list[bytes]], *, in_round: bool
) -> None:
    """As of a simulated controller in this process: the next scans are published while the pose is."""
    following = iter(ticks)
    with NodeProcess() as process:
        chain: Any = start_nodes(process, arm)[arm.namespace]
        feeder = process.start(Feeder)
        feeder.open(arm)

        def publish_next(_pose: bytes) -> None:
            for joint, data in next(following, ()):
                feeder.raw[joint].publish(data)

        begin = [next(following) for _ in range(10)]
        feeder.feed(begin[:-1], together=True)
        topic = f"{arm.namespace}/{ENDPOINT_TOPIC}"
        IntraProcessSubscription(feeder, PoseStamped, topic, KEEP_ALL_QOS, publish_next)
        feeder.feed(begin[-1:], together=in_round)
        found = {**feeder.received, "counts": [repr(chain._counts()).encode()]}
    assert next(following, None) is None
    assert found == in_rounds


def test_a_prediction_uses_the_transforms_that_are_taken(
    arm: ArmFile, ticks: list[list[Scan]], calls: list[str | int]
) -> None:
    encoders = f"{arm.namespace}/encoders"
    with opened_bag(BAG) as reader:
        readings = [data for _, _, data in read_messages(reader, (encoders,), str(BAG))][:TICKS]
    parameters = {"encoders.topic": encoders, "encoders.sigma": [1e-5] * len(arm.calibrations)}
    results = []
    for together in (False, True):
        with NodeProcess() as process:
            start_nodes(process, arm, of_chain=parameters)
            feeder, predicted = process.start(Feeder), list[bytes]()
            feeder.open(arm)
            IntraProcessSubscription(
                feeder, Odometry, f"{arm.namespace}/{PREDICTED_TOPIC}", KEEP_ALL_QOS, predicted.append
            )
            publisher = IntraProcessPublisher(feeder, JointState, encoders, KEEP_ALL_QOS)
            for scans, reading in zip(ticks, readings, strict=True):
                feeder.feed([scans], together=together)
                publisher.publish(reading)
        results.append(predicted)
    assert results[0] == results[1]
    assert len(results[0]) > TICKS // 2
    assert calls[-TICKS + 1 :] == ["arm"] * (TICKS - 1)


@pytest.mark.parametrize(
    ("step", "taken"), [*product(["prepare_scan", "finish_scan"], [False, True]), ("complete_scan", True)]
)
def test_a_failure_ends_the_node_that_fails_and_the_other_joints_continue(
    arm: ArmFile, ticks: list[list[Scan]], monkeypatch: pytest.MonkeyPatch, step: str, *, taken: bool
) -> None:
    if not taken:
        monkeypatch.setattr(ArmPass, "of", lambda *_: None)
    with NodeProcess() as process:
        nodes = start_nodes(process, arm)
        feeder = process.start(Feeder)
        feeder.open(arm)
        feeder.feed(ticks[:5], together=True)
        broken = nodes[f"{arm.namespace}/{list(arm.calibrations)[2]}"]
        monkeypatch.setattr(broken, step, Mock(side_effect=ValueError("of one joint")))
        feeder.feed(ticks[5:10], together=True)
        assert [node for node in nodes.values() if node.exit_requested] == [broken]
        with pytest.raises(ValueError, match="of one joint"):
            broken.raise_failure()
        counts = [len(feeder.received[f"{arm.namespace}/{joint}/{TRANSFORM_TOPIC}"]) for joint in arm.calibrations]
        assert sorted(counts) == [5 + (step == "complete_scan"), *[10] * (len(counts) - 1)]


@pytest.mark.parametrize("step", ["_take_scans", "run", "_publish_pose"])
def test_a_failure_of_the_chain_ends_it_and_leaves_the_joints_alone(
    arm: ArmFile, ticks: list[list[Scan]], monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    run, failure = ArmPass.run, ValueError("of the chain")

    def run_and_fail(arm_pass: ArmPass, stamp_ns: int) -> None:
        run(arm_pass, stamp_ns)
        raise failure

    with NodeProcess() as process:
        nodes = start_nodes(process, arm)
        feeder, states = process.start(Feeder), list[bytes]()
        feeder.open(arm)
        topic = f"{arm.namespace}/{ENDPOINT_STATE_TOPIC}"
        IntraProcessSubscription(feeder, EndpointState, topic, KEEP_ALL_QOS, states.append)
        feeder.feed(ticks[:5], together=True)
        before, chain = len(states), nodes[arm.namespace]
        if step == "run":
            monkeypatch.setattr(ArmPass, "run", run_and_fail)
        elif step == "_take_scans":
            for subscription in chain._transforms:  # type: ignore[attr-defined]
                monkeypatch.setattr(subscription, "group", subscription.group._replace(take=Mock(side_effect=failure)))
        else:
            monkeypatch.setattr(chain, step, Mock(side_effect=failure))
        feeder.feed(ticks[5:10], together=True)
        assert [node for node in nodes.values() if node.exit_requested] == [chain]
        assert len(states) == before
        assert all(subscription.closed for subscription in chain._transforms)  # type: ignore[attr-defined]
        for joint in arm.calibrations:
            received = feeder.received[f"{arm.namespace}/{joint}/{TRANSFORM_TOPIC}"]
            assert [data[STAMP] for data in received] == [dict(scans)[joint][STAMP] for scans in ticks[:10]]


def test_a_chain_with_another_lock_receives_messages(
    arm: ArmFile, ticks: list[list[Scan]], calls: list[str | int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where its topics are remapped to those of another namespace."""
    with NodeProcess() as process:
        chain: Any = start_nodes(process, arm)[arm.namespace]
        feeder, lock = process.start(Feeder), RLock()
        feeder.open(arm)
        for subscription in chain._transforms:
            monkeypatch.setattr(subscription, "group", subscription.group._replace(lock=lock))
        feeder.feed(ticks, together=True)
        assert len(feeder.received[f"{arm.namespace}/{ENDPOINT_TOPIC}"]) > len(ticks) // 2
    assert calls == [0, *[len(arm.calibrations)] * (len(ticks) - 1)]


def test_an_arm_whose_subscriber_blocks_does_not_stop_another_arm(
    arm: ArmFile, ticks: list[list[Scan]], monkeypatch: pytest.MonkeyPatch
) -> None:
    with NodeProcess() as process:
        arms = []
        for name in ("first", "second"):
            start_nodes(process, arm, f"/{name}")
            arms.append(process.start(Feeder, f"/{name}"))
            arms[-1].open(arm, f"/{name}")
        publish, blocked, released = IntraProcessPublisher.publish_over_dds, Event(), Event()

        def publish_or_block(publisher: IntraProcessPublisher, data: bytes) -> bool:
            if publisher.message_type is JointTransform and publisher.topic_name.startswith("/first"):
                blocked.set()
                assert released.wait(60.0)
            return publish(publisher, data)

        monkeypatch.setattr(IntraProcessPublisher, "publish_over_dds", publish_or_block)
        threads = [Thread(target=partial(each.feed, ticks[:5], together=True)) for each in arms]
        try:
            threads[0].start()
            assert blocked.wait(60.0)
            threads[1].start()
            threads[1].join(10.0)
            assert not threads[1].is_alive()
        finally:
            released.set()
            for thread in threads:
                thread.join()
        counts = {len(messages) for each in arms for topic, messages in each.received.items() if "transform" in topic}
        assert counts == {5}
