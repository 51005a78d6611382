"""What a simulated arm sends, as messages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from posor_estimator.ros.message_types import JOINT_STATE, POSE_STAMPED, RAW_SCAN, VECTOR_STAMPED
from posor_estimator.ros.qos import RAW_TOPIC

from posor_drivers.sources.base import SourceMessage, Topic

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray
    from posor_estimator.ros.message_types import MessageTypes

    from posor_drivers.simulator.arm import ArmSimulation, ArmTruth
    from posor_drivers.simulator.electronics import SimulatedScans

NS = 1_000_000_000


class SimulatedTopics:
    """Names of an arm's topics; all but that of the scans are absolute, since they are the arm's."""

    def __init__(self, arm: str) -> None:
        """Make the names."""
        self._arm = arm
        self.endpoint = Topic(f"/{arm}/truth/endpoint", POSE_STAMPED)
        self.target = Topic(f"/{arm}/target/endpoint", POSE_STAMPED)
        self.encoders = Topic(f"/{arm}/encoders", JOINT_STATE)
        self.stage = Topic(f"/{arm}/stage/position", VECTOR_STAMPED)
        self.stage_command = Topic(f"/{arm}/stage/command", VECTOR_STAMPED)

    def joint(self, joint: str) -> Topic:
        """Return the topic of a joint's true ``T_parent_child``."""
        return Topic(f"/{self._arm}/truth/{joint}", POSE_STAMPED)


class SimulatedMessages:
    """Turns what an ``ArmSimulation`` gives into serialised messages; ``n`` is the index of the tick in it."""

    def __init__(self, types: MessageTypes, simulation: ArmSimulation) -> None:
        """Take the names of topics and frames from the arm."""
        self.topics = SimulatedTopics(simulation.arm.name)
        self._types = types
        self._base = simulation.chain.base_frame
        self._endpoint = simulation.arm.endpoint_frame
        self._receiving = {joint.name: joint.parent for joint in simulation.chain.joints}

    def raw(self, joint: str, scans: SimulatedScans, n: int) -> SourceMessage:
        """Return a scan."""
        scan, none = scans.scans[n], np.empty(0)
        message = self._types.new(
            RAW_SCAN,
            header=self._header(scan.stamp_ns, self._receiving[joint]),
            scan=scan.number,
            samples=1,
            status=int(scans.statuses[n]),
            gap_voltages=scan.gap_voltages,
            gap_voltage_spreads=none,
            ring_voltages=scan.ring_voltages,
            ring_voltage_spreads=none,
            diode_currents=scan.diode_currents.ravel(),
            diode_current_spreads=none,
            lit_sources=np.array(scan.lit_sources, dtype=np.uint8),
            supply_voltage=scan.supply_voltage,
            temperature=scan.temperature,
        )
        return self._sent(Topic(RAW_TOPIC, RAW_SCAN), scan.stamp_ns, message)

    def joint_truth(self, joint: str, stamp_ns: int, truth: ArmTruth, n: int) -> SourceMessage:
        """Return a joint's true ``T_parent_child``."""
        pose = truth.T_parent_child[joint][n]
        return self.pose(self.topics.joint(joint), stamp_ns, self._receiving[joint], pose)

    def arm_truth(self, stamp_ns: int, truth: ArmTruth, n: int) -> list[SourceMessage]:
        """Return what is told of the whole arm: where its endpoint is, where it should be, and the encoders."""
        none = np.empty(0)
        encoders = self._types.new(
            JOINT_STATE,
            header=self._header(stamp_ns, ""),
            name=list(truth.joints),
            position=truth.encoder[n],
            velocity=none,
            effort=none,
        )
        return [
            self.pose(self.topics.endpoint, stamp_ns, self._base, truth.endpoint[n]),
            self.pose(self.topics.target, stamp_ns, self._base, truth.target[n]),
            self._sent(self.topics.encoders, stamp_ns, encoders),
        ]

    def stage(self, stamp_ns: int, position: FloatArray) -> SourceMessage:
        """Return where the stage is, (3,) [m]."""
        x, y, z = position.tolist()
        message = self._types.new(
            VECTOR_STAMPED,
            header=self._header(stamp_ns, self._endpoint),
            vector=self._types.new("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
        )
        return self._sent(self.topics.stage, stamp_ns, message)

    def pose(self, topic: Topic, stamp_ns: int, frame: str, pose: pin.SE3) -> SourceMessage:
        """Return a pose in a frame (geometry_msgs/PoseStamped), on any topic."""
        x, y, z, *q = pin.SE3ToXYZQUAT(pose).tolist()
        message = self._types.new(
            POSE_STAMPED,
            header=self._header(stamp_ns, frame),
            pose=self._types.new(
                "geometry_msgs/msg/Pose",
                position=self._types.new("geometry_msgs/msg/Point", x=x, y=y, z=z),
                orientation=self._types.new("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", q, strict=True))),
            ),
        )
        return self._sent(topic, stamp_ns, message)

    def _header(self, stamp_ns: int, frame: str) -> Any:
        sec, nanosec = divmod(stamp_ns, NS)
        stamp = self._types.new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        return self._types.new("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _sent(self, topic: Topic, stamp_ns: int, message: Any) -> SourceMessage:
        return SourceMessage(topic.name, stamp_ns, self._types.serialize(message, topic.type_name))
