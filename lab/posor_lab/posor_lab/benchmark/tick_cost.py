# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Processor time of the nodes in a tick: the scans of all joints are published in a loop, in one process.

The thread's processor time leaves out the time in which the host ran others, so the figures of a busy host can be
compared. Drivers and other processes do not take part.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from time import thread_time_ns, time_ns
from typing import TYPE_CHECKING

import numpy as np
from geometry_msgs.msg import PoseStamped
from posor.bags.bag_reader import opened_bag
from posor.bags.block_reader import read_messages
from posor.messages.raw_scan import ScanTemplate
from posor.node_parameters import NodeParameters
from posor.numerics.stamps import first_tick_after, tick_stamp_ns
from posor.ros_names import ENDPOINT_STATE_TOPIC, ENDPOINT_TOPIC, RAW_TOPIC
from posor_bringup.arm_programs import group_programs
from posor_estimator.composition_file import load_composition
from posor_msgs.msg import EndpointState, RawScan
from posor_ros.delivery_round import DeliveryRound
from posor_ros.intra_process import IntraProcessPublisher, IntraProcessSubscription
from posor_ros.lifecycle_node import PosorNode
from posor_ros.qos import result_qos
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.logging import set_logger_level

from posor_lab.benchmark.generated_arm import RATE
from posor_lab.benchmark.graph_load import GraphLoad, node_programs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.chain.arm_file import ArmFile

    from posor_lab.benchmark.graph_load import NodeKind

TICKS, WARM_UP_TICKS = 4000, 500
BLOCK = 50  # ticks of which the mean is taken


class ScanFeeder(PosorNode[NodeParameters]):
    """Has publishers of the scans of all joints, and may receive the state of the endpoint."""

    NAME = "scan_feeder"
    Parameters = NodeParameters

    pose_ns = 0  # processor time of the thread at the last published pose of the endpoint

    def open(self, arm: ArmFile, *, receives_state: bool) -> list[IntraProcessPublisher]:
        """Return the publishers of the joints of an arm."""
        qos = result_qos(self.parameters)
        IntraProcessSubscription(self, PoseStamped, f"/{arm.name}/{ENDPOINT_TOPIC}", qos, self._on_pose)
        if receives_state:
            topic = f"/{arm.name}/{ENDPOINT_STATE_TOPIC}"
            IntraProcessSubscription(self, EndpointState, topic, qos, lambda _: None)
        topics = (f"/{arm.name}/{joint}/{RAW_TOPIC}" for joint in arm.calibrations)
        return [IntraProcessPublisher(self, RawScan, topic, qos) for topic in topics]

    def _on_pose(self, _data: bytes) -> None:
        self.pose_ns = thread_time_ns()


def tick_cost(
    arm: ArmFile, bag: Path, kind: NodeKind, *, receives_state: bool = False, number_step: int = 1
) -> dict[str, float]:
    """Return least and median processor time of a tick [us], whole and up to the pose; needs ROS initialised.

    ``bag``: scans of all joints; ``receives_state``: whether the endpoint's state has a subscription; ``number_step``:
    of the scan numbers from tick to tick, more than 1 as after missed ticks.
    """
    set_logger_level("", LoggingSeverity.WARN)
    with ExitStack() as opened:
        folder = Path(opened.enter_context(TemporaryDirectory()))
        programs = node_programs(GraphLoad(arm, kind, "composed", RATE), drivers=False)
        (program,) = group_programs(programs, "composed", folder)
        composition, _ = load_composition(Path(program.arguments[0]))
        feeder = ScanFeeder()
        for node in (*(entry.create_node() for entry in composition.nodes), feeder):
            opened.callback(node.stop)
            node.start()
        publishers = feeder.open(arm, receives_state=receives_state)
        templates = [_templates(f"/{arm.name}/{joint}/{RAW_TOPIC}", bag) for joint in arm.calibrations]
        count, first = len(templates[0]), first_tick_after(time_ns(), RATE)
        whole_us, to_pose_us = list[float](), list[float]()
        for begin in range(first, first + WARM_UP_TICKS + TICKS, BLOCK):
            ticks = [(tick, tick_stamp_ns(tick, RATE)) for tick in range(begin, begin + BLOCK)]
            scans = [
                [each[tick % count].at(stamp_ns, number_step * tick) for each in templates] for tick, stamp_ns in ticks
            ]
            whole_ns = to_pose_ns = 0
            for of_tick in scans:
                begin_ns = thread_time_ns()
                with DeliveryRound():  # as the scheduler of the drivers
                    for publisher, data in zip(publishers, of_tick, strict=True):
                        publisher.publish(data)
                whole_ns += thread_time_ns() - begin_ns
                to_pose_ns += feeder.pose_ns - begin_ns
            whole_us.append(whole_ns / BLOCK / 1e3)
            to_pose_us.append(to_pose_ns / BLOCK / 1e3)
        skipped = WARM_UP_TICKS // BLOCK
        return _figures("", whole_us[skipped:]) | _figures("pose_", to_pose_us[skipped:])


def _figures(prefix: str, costs_us: Sequence[float]) -> dict[str, float]:
    return {f"{prefix}least_us": min(costs_us), f"{prefix}median_us": float(np.median(costs_us))}


def _templates(topic: str, bag: Path) -> list[ScanTemplate]:
    """Return the scans of a topic, every second one forwards and the others backwards, as the drivers play them."""
    with opened_bag(bag) as reader:
        recorded = [ScanTemplate(data) for _, _, data in read_messages(reader, (topic,), str(bag))]
    return recorded[::2] + recorded[1::2][::-1]
