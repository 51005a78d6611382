# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Receives everything that a simulated arm publishes, tick by tick, and publishes its clock."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Vector3Stamped
from posor.model.fault import Fault, State
from posor.numerics.stamps import NS, tick_stamp_ns
from posor.ros_names import ENDPOINT_COVARIANCE_TOPIC, TRANSFORM_TOPIC
from posor_drivers.message_builder import SimulatedTopics
from posor_msgs.msg import JointTransform
from posor_ros.lifecycle_node import LISTENERS_STATUS as LISTENERS
from posor_ros.qos import KEEP_ALL_QOS
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from posor_lab.arm_study.arm_record import CHAIN, GIVEN_UP, NO_SCAN, TRUTH, ArmRecord, pose_array
from posor_lab.harness.message_conversion import is_usable, pose_from_message
from posor_lab.reports.graph_receiver import GraphReceiver

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    import pinocchio as pin
    from posor.chain.kinematic_chain import Chain
    from posor.numerics.array_types import FloatArray


class ArmReceiver(GraphReceiver):
    """Subscribes to the truth, the endpoint, the encoders, the stage and all transforms of an arm."""

    def __init__(self, arm: str, chain: Chain, *, stage: bool) -> None:
        """Subscribe to the topics of the arm in the namespace ``arm``; ``stage``: whether it has a stage."""
        super().__init__("arm_demo")
        self._arm, self._chain = arm, chain
        topics = SimulatedTopics(f"/{arm}")
        self._endpoint_topic = f"/{arm}/{ENDPOINT_COVARIANCE_TOPIC}"
        self.truths = self.store_topic(PoseStamped, topics.endpoint.name)
        self.targets = self.store_topic(PoseStamped, topics.target.name)
        self.encoders = self.store_topic(JointState, topics.encoders.name)
        self.stage = self.store_topic(Vector3Stamped, topics.stage.name)
        self.command_topic = topics.stage_command.name
        self.commands = self.store_topic(Vector3Stamped, self.command_topic)
        self.poses = self.store_topic(PoseWithCovarianceStamped, self._endpoint_topic)
        self.transforms = {
            joint.name: self.store_topic(JointTransform, self._transform_topic(joint.name)) for joint in chain.joints
        }
        self._clock_publisher = self.create_publisher(Clock, "/clock", KEEP_ALL_QOS)
        self._driver_topics: dict[str, dict[int, Any]] = {
            topics.endpoint.name: self.truths,
            topics.target.name: self.targets,
            topics.encoders.name: self.encoders,
            **({topics.stage.name: self.stage} if stage else {}),
        }

    def missing_topics(self) -> list[str]:
        """Return the topics of a complete tick without any message yet."""
        stores: Mapping[str, Mapping[int, Any]] = {
            **self._driver_topics,
            **{self._transform_topic(joint): store for joint, store in self.transforms.items()},
            self._endpoint_topic: self.poses,
        }
        return [topic for topic, store in stores.items() if not store]

    def missing_connections(self) -> list[str]:
        """Return the nodes that do not run yet, and the topics whose subscriptions are not connected yet."""
        arm, joints = self._arm, list(self.transforms)
        wanted = {f"/{arm}/chain_node": (self._endpoint_topic, ENDPOINT_COVARIANCE_TOPIC, 1)}
        for joint in joints:  # chain_node and this node
            wanted[f"/{arm}/{joint}/posor_node"] = (self._transform_topic(joint), TRANSFORM_TOPIC, 2)
        missing = []
        for node, (topic, key, count) in wanted.items():
            found = self.status_value(f"{node}: {LISTENERS}", key)
            if found is None:
                missing.append(f"{topic} (no diagnostics of {node} yet)")
            elif int(found) < count:
                missing.append(f"{topic} ({found} of {count} subscriptions)")
        drivers = [f"/{arm}/{joint}/driver_node" for joint in joints]
        missing += [
            f"{node} (not running)" for node in drivers if self.status_value(f"{node}: source", "message") != "running"
        ]
        nodes, found_nodes = len(wanted) + len(drivers), self._clock_publisher.get_subscription_count()
        if found_nodes < nodes:
            missing.append(f"/clock ({found_nodes} of {nodes} subscriptions)")
        return missing

    def _transform_topic(self, joint: str) -> str:
        return f"/{self._arm}/{joint}/{TRANSFORM_TOPIC}"

    def set_clock(self, now_ns: int) -> None:
        """Publish the time [ns] to all nodes."""
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(now_ns, NS)
        self._clock_publisher.publish(message)

    def has_controller(self) -> bool:
        """Return whether a controller with this clock publishes commands for the stage."""
        connected = self._clock_publisher.get_subscription_count() > 1 + 2 * len(self.transforms)
        return connected and self.count_publishers(self.command_topic) > 0

    def missing_of_tick(self, stamp: int, dropped: Collection[str]) -> list[str]:
        """Return the messages that are still missing of a tick; ``dropped``: joints without a scan at this tick."""
        missing = [name for name, store in self._driver_topics.items() if stamp not in store]
        usable = not dropped
        for joint, store in self.transforms.items():
            transform = store.get(stamp)
            if transform is not None:
                usable = usable and is_usable(transform)
            elif joint not in dropped:
                missing.append(self._transform_topic(joint))
        if usable and not missing and stamp not in self.poses:
            missing.append(self._endpoint_topic)
        return missing

    def reasons_without_pose(self, stamp: int) -> dict[str, str]:
        """Return why pose or truth of a tick are missing, by joint, ``CHAIN`` or ``TRUTH``; empty if both came."""
        if stamp in self.poses:
            return {} if stamp in self.truths else {TRUTH: NO_SCAN}
        reasons = {}
        for joint, store in self.transforms.items():
            transform = store.get(stamp)
            if transform is None:
                reasons[joint] = NO_SCAN
            elif not is_usable(transform):
                reasons[joint] = f"is {State(transform.state).name.lower()} ({Fault(transform.faults).name})"
        return reasons or {CHAIN: GIVEN_UP}

    def record(self, ticks: range, rate: int) -> ArmRecord:
        """Return the record of ticks at a rate [Hz]."""
        stamps = [tick_stamp_ns(tick, rate) for tick in ticks]

        def read(store: Mapping[int, Any], extract: Callable[[Any], Any], unknown: Any = None) -> list[Any]:
            return [unknown if (message := store.get(stamp)) is None else extract(message) for stamp in stamps]

        def covariance(message: PoseWithCovarianceStamped) -> FloatArray:
            return np.reshape(message.pose.covariance, (6, 6))

        def pose(message: PoseStamped) -> pin.SE3:
            return pose_from_message(message.pose)

        return ArmRecord(
            ticks=ticks,
            times_s=np.arange(len(ticks)) / rate,
            truth=pose_array(read(self.truths, pose)),
            posor=pose_array(read(self.poses, lambda message: pose_from_message(message.pose.pose))),
            covariances=np.array(read(self.poses, covariance, np.full((6, 6), np.nan))),
            encoders=pose_array(read(self.encoders, self._nominal_endpoint)),
            target=pose_array(read(self.targets, pose)),
            stage=np.array(read(self.stage, lambda m: [m.vector.x, m.vector.y, m.vector.z], np.full(3, np.nan))),
            reasons=tuple(self.reasons_without_pose(stamp) for stamp in stamps),
        )

    def _nominal_endpoint(self, message: JointState) -> pin.SE3:
        """Return the endpoint by the encoders alone."""
        return self._chain.nominal_endpoint(dict(zip(message.name, message.position, strict=True)))
