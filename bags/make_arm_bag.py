# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Make the bag of the simulated five-axis arm: one cycle of its scenario, and the endpoint estimated from its scans.

``make data`` runs it in the environment of the workspace; an optional argument is the output folder. Scans and truth
come from the simulator, as the drivers publish them; ``endpoint/pose`` comes from the numerical core, as the nodes
estimate it. Every run gives the same bytes.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.bags.arm_estimator import ArmEstimator
from posor.bags.bag_writer import replace_bag
from posor.bags.reprocess_task import Settings
from posor.errors import PosorError
from posor.messages.message_definitions import MessageTypes
from posor.numerics.stamps import tick_stamp_ns
from posor.ros_names import ENDPOINT_TOPIC, POSE_STAMPED, RAW_SCAN, RAW_TOPIC
from posor_bringup.arms import load_checked_arm
from posor_drivers.message_builder import SimulatedMessages
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.sources.source import SourceMessage, Topic
from posor_lab.harness.message_conversion import recorded_scans
from posor_msgs.msg import RawScan
from posor_ros.qos import RELIABLE_QOS, SENSOR_QOS
from rclpy.serialization import deserialize_message

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from posor.chain.arm_file import ArmFile
    from posor.messages.estimate_arrays import EndpointEstimates

HERE = Path(__file__).resolve().parent
ARM = "five_axis"
START_S = 1_767_225_600
"""2026-01-01 00:00:00 UTC, the beginning of a cycle of the scenario."""


def arm_endpoints(arm: ArmFile, scans: Mapping[str, Sequence[RawScan]]) -> EndpointEstimates:
    """Return the endpoint at every stamp for which a chain_node has one, in order, without any node.

    Args:
        arm: The arm.
        scans: Of every joint, in the order of their stamps, all with the same readings.

    Raises:
        PosorError: A file of the arm is invalid.

    """
    estimator = ArmEstimator(Settings.of_arm(arm))
    return estimator.estimate_block({joint: [recorded_scans(each)] for joint, each in scans.items()}).endpoint


class ArmBag:
    """One cycle of an arm's scenario, as messages."""

    def __init__(self, arm: ArmFile, types: MessageTypes) -> None:
        """Simulate the cycle."""
        self._simulation = ArmSimulation(arm)
        self._make = SimulatedMessages(types, self._simulation)
        self._rate = self._simulation.scenario.ticks_per_second
        first = START_S * self._rate
        self._ticks = np.arange(first, first + self._simulation.scenario.cycle_ticks)
        self._scans = {joint: self._raw_messages(joint) for joint in self._simulation.joints}
        self._measured_topic = Topic(f"/{arm.name}/{ENDPOINT_TOPIC}", POSE_STAMPED)
        scans = {
            joint: [deserialize_message(message.data, RawScan) for message in messages.values()]
            for joint, messages in self._scans.items()
        }
        endpoint = arm_endpoints(arm, scans)
        poses = map(pin.XYZQUATToSE3, endpoint.poses)
        self._endpoints = dict(zip(endpoint.stamps_ns.tolist(), poses, strict=True))

    def _raw_messages(self, joint: str) -> dict[int, SourceMessage]:
        """Return the published scans of a joint, by stamp [ns]."""
        scans = self._simulation.scans(joint, self._ticks)
        name = f"/{self._simulation.arm.name}/{joint}/{RAW_TOPIC}"
        raw = (self._make.raw_scan(joint, scans, n) for n in np.flatnonzero(scans.sent).tolist())
        return {message.time_ns: SourceMessage(name, message.time_ns, message.data) for message in raw}

    def topics(self) -> list[Topic]:
        """Return all topics."""
        make = self._make.topics
        raw = [Topic(f"/{self._simulation.arm.name}/{joint}/{RAW_TOPIC}", RAW_SCAN) for joint in self._scans]
        return [*raw, self._measured_topic, make.endpoint, make.target, make.encoders]

    def messages(self) -> Iterator[SourceMessage]:
        """Yield all messages in the order of their stamps."""
        truth = self._simulation.truth(self._ticks)
        for n, tick in enumerate(self._ticks.tolist()):
            time_ns = tick_stamp_ns(tick, self._rate)
            yield from (messages[time_ns] for messages in self._scans.values() if time_ns in messages)
            if time_ns in self._endpoints:
                pose = self._endpoints[time_ns]
                yield self._make.pose(self._measured_topic, time_ns, self._simulation.chain.base_frame, pose)
            yield from self._make.arm_truth(time_ns, truth, n)


def main(folder: Path) -> None:
    """Make the bag in ``folder``."""
    types = MessageTypes()
    bag = ArmBag(load_checked_arm(ARM), types)
    with replace_bag(folder / ARM) as writer:
        for topic in bag.topics():
            qos = SENSOR_QOS if topic.type_name == RAW_SCAN else RELIABLE_QOS
            writer.add_topic(topic.name, topic.type_name, types.definition(topic.type_name), [qos])
        for message in bag.messages():
            writer.write(message.topic, message.time_ns, message.data)
    print(f"made {folder / ARM}")


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
    except PosorError as error:
        sys.exit(str(error))
