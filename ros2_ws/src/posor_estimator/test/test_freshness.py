# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Silence, stamps, order and publishers of inputs: the rules, and posor_node as a program."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from posor.node_parameters import FreshnessParameters
from posor.numerics.stamps import NS
from posor_lab.harness.graph import Graph, values_of, wait_for_value
from posor_lab.harness.program import Program, installed
from posor_msgs.msg import JointTransform, RawScan
from posor_msgs.srv import Acknowledge
from posor_ros.freshness import ScanOrder, StampLimits
from posor_ros.input_watch import InputWatch
from posor_ros.ros_arguments import ros_arguments
from rclpy.duration import Infinite
from sensor_msgs.msg import JointState

from .live_topics import PERIOD_S, POSOR, ScanSender

pytestmark = pytest.mark.usefixtures("ros_domain")

ERROR, WARN = b"\x02", b"\x01"
INPUT, ESTIMATE = "/posor_node: input", "/posor_node: estimate"
COUNT = 30


def test_silence_is_the_longer_of_the_limit_and_ten_periods() -> None:
    watch = InputWatch("/joint1/raw")
    watch.restart(100.0)
    assert not watch.silence(100.19, 0.2)
    assert watch.silence(100.25, 0.2) == "no input on /joint1/raw since activation, 0.25 s"
    for n in range(10):  # a period of 0.1 s
        watch.record(101.0 + 0.1 * n)
        assert not watch.silence(101.0 + 0.1 * n, 0.2)
    assert not watch.silence(101.9 + 0.95, 0.2)
    assert watch.silence(101.9 + 1.05, 0.2) == "no input on /joint1/raw for 1.05 s"
    assert not watch.silence(1e9, math.inf)


def test_neither_a_pause_nor_a_burst_changes_the_period() -> None:
    watch = InputWatch("/raw")
    watch.restart(0.0)
    now_s = 0.0
    for n in range(50):
        now_s += 8.0 if n == 30 else 1e-6 if n == 40 else 0.05
        watch.record(now_s)
        watch.silence(now_s, 0.2)
    assert not watch.silence(now_s + 0.45, 0.2)
    assert watch.silence(now_s + 0.55, 0.2)


def test_stamps_beyond_the_limits_are_named_with_the_parameter() -> None:
    now_ns = 1000 * NS
    limits = StampLimits.of(lambda: now_ns, FreshnessParameters(max_age=1.0, max_future=0.1))
    assert not limits.fault(now_ns - NS)
    assert not limits.fault(now_ns + NS // 10)
    assert limits.fault(now_ns - 2 * NS) == (
        "the stamp is 2 s old; expected at most 1 s, or the parameter 'freshness.max_age' .inf for a recording"
    )
    assert limits.fault(now_ns + NS // 2) == (
        "the stamp is 0.5 s ahead of ROS time; expected at most 0.1 s, "
        "or the parameter 'freshness.max_future' .inf for a recording"
    )
    unlimited = StampLimits.of(lambda: now_ns, FreshnessParameters(max_age=math.inf, max_future=math.inf))
    assert not unlimited.fault(NS)
    assert not unlimited.fault(10**6 * NS)
    assert "/clock" in StampLimits.of(lambda: 0, FreshnessParameters()).fault(now_ns)


def test_missing_repeated_and_backward_numbers_are_counted() -> None:
    order = ScanOrder()
    scans = [(1, 7), (2, 8), (2, 8), (3, 11), (4, 11), (5, 5), (6, 6)]
    seen = [order.describe(scan, last, is_same=scan == last) for last, scan in pairwise(scans)]
    assert seen == [
        ("", ""),
        ("scans_repeated", "scan 8 was repeated"),
        ("", ""),
        ("numbers_backward", "scan 11 came after scan 11"),
        ("numbers_backward", "scan 5 came after scan 11"),
        ("", ""),
    ]
    kind, text = order.describe((6, 6), (6, 6), is_same=False)
    assert (kind, text) == ("numbers_backward", "scan 6 came again with other readings")
    assert order.count_missing(11, 2) == ("numbers_missing", "scans missing before scan 11: 2")
    assert order.counts == {"numbers_missing": 2, "scans_repeated": 1, "numbers_backward": 3}
    last = 2**64 - 1  # after scan 11, as a kernel subtracts 64-bit numbers
    assert order.count_missing(last, -13)[1] == f"scans missing before scan {last}: {last - 12}"


class Rig:
    """A posor_node with the limits of a live source."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.transforms: list[Any] = graph.collect(JointTransform, "transform")
        graph.watch_diagnostics()
        self.sender = ScanSender(graph)
        wait_for_value(graph, "/posor_node: listeners", "transform", "1")

    def wait_for_sound_scan(self) -> None:
        """Send scans until the last one is used."""

        def is_sound() -> bool:
            return bool(self.transforms) and self.transforms[-1].state == JointTransform.STATE_OK

        self.transforms.clear()
        self.graph.wait_until(is_sound, "a sound scan", self.sender.send_later)

    def wait_for_input_status(self, text: str, level: bytes) -> DiagnosticStatus:
        """Return a status of the input that contains a text, from now on."""

        def found() -> list[DiagnosticStatus]:
            return [s for s in self.graph.diagnostics if s.name == INPUT and text in s.message and s.level == level]

        self.graph.wait_until(lambda: bool(found()), text)
        return found()[0]

    def wait_for_count(self, key: str, count: int) -> None:
        """Wait until a count of the input has reached a number."""

        def has_come() -> bool:
            status = self.graph.latest(INPUT)
            return status is not None and int(values_of(status).get(key, 0)) >= count

        self.graph.wait_until(has_come, f"{count} {key}")


@pytest.fixture(scope="module")
def shared_rig() -> Iterator[Rig]:
    command = [*installed("posor_estimator", "posor_node"), *ros_arguments({**POSOR, "lossless": True})]
    with Program(command) as node, Graph() as graph:
        yield Rig(graph)
        assert node.end() == 0


@pytest.fixture
def rig(shared_rig: Rig) -> Rig:
    shared_rig.wait_for_sound_scan()
    shared_rig.graph.diagnostics.clear()
    return shared_rig


def test_a_stopped_source_is_an_error_within_half_a_second(rig: Rig) -> None:
    rig.sender.send_for(0.5)
    rig.graph.diagnostics.clear()
    status = rig.wait_for_input_status("no input on /raw for", ERROR)
    assert float(re.findall(r"for ([\d.]+) s", status.message)[0]) < 0.5
    estimate = rig.graph.wait_for_status(ESTIMATE, "no estimate: no input on /raw for")
    assert estimate.level == ERROR
    rig.wait_for_sound_scan()
    rig.graph.wait_for_status(ESTIMATE, "ok: none")


@pytest.mark.parametrize(("age_s", "reason"), [(3600.0, "s old; expected"), (-3600.0, "s ahead of ROS time; expected")])
def test_a_scan_with_a_wrong_stamp_is_not_used(rig: Rig, age_s: float, reason: str) -> None:
    for _ in range(10):
        rig.sender.send(age_s)
    rig.graph.wait_until(lambda: len(rig.transforms) >= 10 and rig.transforms[-1].state, "lost transforms")
    last = rig.transforms[-1]
    assert (last.state, last.faults) == (JointTransform.STATE_LOST, JointTransform.FAULT_BAD_READING)
    assert math.isnan(last.pose.position.x)
    status = wait_for_value(rig.graph, ESTIMATE, "reason", reason)
    assert "freshness.max_" in values_of(status)["reason"]


def test_scans_out_of_order_are_named_and_a_repeated_scan_is_dropped(rig: Rig) -> None:
    sender = rig.sender
    before = len(rig.transforms)
    data = sender.template.at(time.time_ns(), sender.number + 1)
    sender.number += 1
    for _ in range(2):
        sender.publisher.publish(data)
    assert rig.wait_for_input_status("was repeated", WARN)
    sender.number += 5
    sender.send()
    sender.number -= 3
    rig.wait_for_sound_scan()
    for key, count in (("scans_repeated", 1), ("numbers_missing", 5), ("numbers_backward", 1)):
        rig.wait_for_count(key, count)
    sender.number += 3  # after the late scan, the next one in order
    rig.wait_for_sound_scan()
    rig.wait_for_count("numbers_missing", 5)
    assert sum(t.scan == sender.number for t in rig.transforms[before:]) <= 1


def test_missing_scans_are_reported_once_a_second_until_none_is_missing(rig: Rig) -> None:
    """A host that misses ticks all the time does not make the node publish at the highest rate."""

    def reports() -> list[str]:
        return [s.message for s in rig.graph.diagnostics if s.name == INPUT and s.level == WARN]

    def send_with_gaps() -> None:
        rig.sender.number += 1
        rig.sender.send_later()

    def is_in_time() -> bool:
        status = rig.graph.latest(INPUT)
        return status is not None and status.message == "in time"

    rig.graph.wait_until(is_in_time, "the end of earlier warnings", rig.sender.send_later)
    rig.graph.diagnostics.clear()
    begin_s = time.monotonic()
    rig.graph.wait_until(lambda: len(set(reports())) > 2, "three reports", send_with_gaps)
    end_s = time.monotonic()
    assert end_s - begin_s > 0.9
    assert all(re.fullmatch(r"scans missing before scan \d+: 1", text) for text in reports())
    rig.graph.wait_until(is_in_time, "the end of the warning", rig.sender.send_later)


def test_two_publishers_are_an_error_and_their_scans_are_not_used(rig: Rig) -> None:
    impostor = rig.graph.node.create_publisher(RawScan, "raw", rig.sender.publisher.qos_profile)
    try:
        rig.graph.wait_until(lambda: impostor.get_subscription_count() == 1, "the match")
        rig.wait_for_input_status("2 publishers on /raw; expected one", ERROR)
        rig.transforms.clear()
        for _ in range(10):
            rig.sender.number += 1
            impostor.publish(rig.sender.template.at(time.time_ns(), rig.sender.number))
        rig.graph.wait_until(lambda: len(rig.transforms) == 10, "transforms")
        assert {transform.state for transform in rig.transforms} == {JointTransform.STATE_LOST}
    finally:
        rig.graph.node.destroy_publisher(impostor)
    rig.wait_for_sound_scan()


def test_the_age_of_scans_shows_that_a_restarted_driver_has_another_clock() -> None:
    command = [*installed("posor_estimator", "posor_node"), *ros_arguments({**POSOR, "lossless": True})]
    with Program(command), Graph() as graph:
        rig = Rig(graph)

        def send_regularly(begin_s: float, age_s: float) -> list[JointTransform]:
            """Send scans at a steady rate that are of an age when they are sent; return the transforms."""
            rig.transforms.clear()
            for number in range(COUNT):
                exposed_s = begin_s + number * PERIOD_S
                time.sleep(max(0.0, exposed_s - time.time()))
                rig.sender.publisher.publish(rig.sender.template.at(round((exposed_s - age_s) * NS), number))
            graph.wait_until(lambda: len(rig.transforms) == COUNT, "all transforms")
            return rig.transforms

        begin_s = time.time()
        transforms = send_regularly(begin_s, 0.0)
        assert transforms[-1].state == JointTransform.STATE_OK
        assert not any(transforms[-1].stamp_shift)
        begin_s += (COUNT + 15) * PERIOD_S  # so the stamps go on forward
        transforms = send_regularly(begin_s, 10 * PERIOD_S)
        assert transforms[-1].state == JointTransform.STATE_OK
        assert min(transforms[-1].stamp_shift) > 0.0
        assert graph.wait_for_status("/posor_node: stamps", "have stepped by 0.").level == WARN


def test_no_deadline_and_no_liveliness_is_requested() -> None:
    """Their events block the executor for good (rmw_fastrtps 8.4.3)."""
    arguments = ros_arguments({**POSOR, "encoder.sigma": 1e-3})
    with Program([*installed("posor_estimator", "posor_node"), *arguments]), Graph() as graph:
        publisher = graph.node.create_publisher(JointState, "encoder", 10)
        scans = graph.node.create_publisher(RawScan, "raw", 10)
        graph.wait_until(lambda: publisher.get_subscription_count() == scans.get_subscription_count() == 1, "the match")
        for topic in ("/raw", "/encoder"):
            (found,) = graph.node.get_subscriptions_info_by_topic(topic)
            assert found.qos_profile.deadline == Infinite
            assert found.qos_profile.liveliness_lease_duration == Infinite


def test_an_encoder_that_disagrees_latches_a_fault_until_it_agrees() -> None:
    parameters = {**POSOR, "lossless": True, "freshness.max_silence": math.inf}
    parameters |= {"encoder.sigma": 1e-3, "encoder.topic": "/arm/encoders"}
    command = [*installed("posor_estimator", "posor_node"), *ros_arguments(parameters)]
    with Program(command), Graph() as graph:
        rig = Rig(graph)
        encoder = graph.publisher(JointState, "/arm/encoders")

        def acknowledge() -> str:
            request = Acknowledge.Request(caller="a test", reason="the encoder was inspected")
            return str(graph.call(Acknowledge, "/posor_node/acknowledge", request).message)

        rig.sender.send()  # one scan: a loaded host would send several at unequal intervals, a step of their stamps
        graph.wait_until(lambda: bool(rig.transforms), "a transform")
        assert acknowledge() == "there is no latched fault"
        message = JointState(name=["joint1"], position=[0.5])
        message.header.stamp = graph.node.get_clock().now().to_msg()
        encoder.publish(JointState())
        rig.wait_for_input_status("/arm/encoders: 0 positions; expected one, or the parameter 'encoder.joint'", WARN)

        def send_both() -> None:
            time.sleep(PERIOD_S)
            message.header.stamp = graph.node.get_clock().now().to_msg()
            encoder.publish(message)
            rig.sender.send()

        def has_encoder_fault() -> bool:
            return any(transform.faults & JointTransform.FAULT_ENCODER for transform in rig.transforms)

        graph.wait_until(has_encoder_fault, "the disagreement", send_both)
        assert "the last scan is not plausible" in acknowledge()
        message.position = [rig.transforms[0].native[5]]
        encoder.publish(message)
        rig.wait_for_sound_scan()
