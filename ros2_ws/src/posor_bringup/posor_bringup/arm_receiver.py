"""Receives all that an arm publishes and puts it together tick by tick; tells the arm the time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Vector3Stamped
from posor_drivers.simulated_messages import SimulatedTopics
from posor_drivers.simulator.ticks import NS, stamp_of
from posor_estimator.ros.listeners import STATUS as LISTENERS
from posor_estimator.ros.messages import pose_from_message, why_unusable
from posor_estimator.ros.qos import ENDPOINT_COVARIANCE_TOPIC, TRANSFORM_TOPIC
from posor_msgs.msg import JointTransform
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from posor_bringup.arm_record import CHAIN, GIVEN_UP, NO_SCAN, TRUTH, ArmRecord, poses_of
from posor_bringup.receiver import KEEP_ALL_QOS, Receiver

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    import pinocchio as pin
    from posor_estimator.core.chain import Chain


class ArmReceiver(Receiver):
    """Subscribes to the truth, the endpoint, the encoders, the stage and all transforms of an arm."""

    def __init__(self, arm: str, chain: Chain, *, stage: bool) -> None:
        """Subscribe.

        Args:
            arm: The arm's name, its namespace.
            chain: Its kinematics.
            stage: Whether it has a stage.

        """
        super().__init__("arm_demo")
        self._arm, self._chain = arm, chain
        self._topics = topics = SimulatedTopics(arm)
        self.truths = self.keep(PoseStamped, topics.endpoint.name)
        self.targets = self.keep(PoseStamped, topics.target.name)
        self.encoders = self.keep(JointState, topics.encoders.name)
        self.stage = self.keep(Vector3Stamped, topics.stage.name)
        self.commands = self.keep(Vector3Stamped, topics.stage_command.name)
        self.poses = self.keep(PoseWithCovarianceStamped, f"/{arm}/{ENDPOINT_COVARIANCE_TOPIC}")
        self.transforms = {
            joint.name: self.keep(JointTransform, f"/{arm}/{joint.name}/{TRANSFORM_TOPIC}") for joint in chain.joints
        }
        self._time = self.create_publisher(Clock, "/clock", KEEP_ALL_QOS)
        self._always: dict[str, dict[int, Any]] = {
            "truth/endpoint": self.truths,
            "target/endpoint": self.targets,
            "encoders": self.encoders,
            **({"stage/position": self.stage} if stage else {}),
        }

    def missing_topics(self) -> list[str]:
        """Return what nothing has come of yet, of all that makes a tick complete."""
        stores: Mapping[str, Mapping[int, Any]] = {
            **self._always,
            **{f"{joint}/{TRANSFORM_TOPIC}": store for joint, store in self.transforms.items()},
            ENDPOINT_COVARIANCE_TOPIC: self.poses,
        }
        return [topic for topic, store in stores.items() if not store]

    def unready(self) -> list[str]:
        """Return what is not yet so that every node is at work and heard by all that listen to it."""
        arm, joints = self._arm, list(self.transforms)
        wanted = {f"/{arm}/chain_node": (ENDPOINT_COVARIANCE_TOPIC, 1)}
        wanted |= {f"/{arm}/{joint}/posor_node": (TRANSFORM_TOPIC, 2) for joint in joints}  # by the chain, by us
        lacking = [
            f"{count} subscriptions to the {topic} of {node}"
            for node, (topic, count) in wanted.items()
            if int(self.value(f"{node}: {LISTENERS}", topic) or 0) < count
        ]
        drivers = [f"/{arm}/{joint}/driver_node" for joint in joints]
        lacking += [f"{node} running" for node in drivers if self.value(f"{node}: source", "message") != "running"]
        nodes = len(wanted) + len(drivers)
        if self._time.get_subscription_count() < nodes:
            lacking.append(f"{nodes} subscriptions to the clock")
        return lacking

    def set_clock(self, now_ns: int) -> None:
        """Tell all nodes what time it is [ns]."""
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(now_ns, NS)
        self._time.publish(message)

    def has_controller(self) -> bool:
        """Return whether something commands the stage, by our clock."""
        listening = self._time.get_subscription_count() > 1 + 2 * len(self.transforms)
        return listening and self.count_publishers(self._topics.stage_command.name) > 0

    def outstanding(self, stamp: int, dropped: Collection[str]) -> list[str]:
        """Return what must still come of a tick.

        Args:
            stamp: Of the tick [ns].
            dropped: Joints that send no scan.

        """
        lacking = [name for name, store in self._always.items() if stamp not in store]
        usable = not dropped
        for joint, store in self.transforms.items():
            transform = store.get(stamp)
            if transform is not None:
                usable = usable and not why_unusable(transform)
            elif joint not in dropped:
                lacking.append(f"the transform of {joint}")
        if usable and not lacking and stamp not in self.poses:
            lacking.append("the endpoint")
        return lacking

    def why_no_pose(self, stamp: int) -> dict[str, str]:
        """Return why there is no pose at a tick, or no truth, by who is the reason; empty where both are."""
        if stamp in self.poses:
            return {} if stamp in self.truths else {TRUTH: NO_SCAN}
        reasons = {}
        for joint, store in self.transforms.items():
            transform = store.get(stamp)
            why = NO_SCAN if transform is None else why_unusable(transform)
            if why:
                reasons[joint] = why
        return reasons or {CHAIN: GIVEN_UP}

    def record(self, ticks: range, rate: int) -> ArmRecord:
        """Return what was received of ticks at a rate [Hz]."""
        stamps = [stamp_of(tick, rate) for tick in ticks]
        posor = [self.poses.get(stamp) for stamp in stamps]
        stage = [self.stage.get(stamp) for stamp in stamps]
        nan = float("nan")
        return ArmRecord(
            ticks=ticks,
            times_s=np.arange(len(ticks)) / rate,
            truth=poses_of([_pose(self.truths.get(stamp)) for stamp in stamps]),
            posor=poses_of([None if said is None else pose_from_message(said.pose.pose) for said in posor]),
            covariances=np.array(
                [np.full((6, 6), nan) if said is None else np.reshape(said.pose.covariance, (6, 6)) for said in posor]
            ),
            encoders=poses_of([self._nominal(self.encoders.get(stamp)) for stamp in stamps]),
            target=poses_of([_pose(self.targets.get(stamp)) for stamp in stamps]),
            stage=np.array(
                [[nan, nan, nan] if said is None else [said.vector.x, said.vector.y, said.vector.z] for said in stage]
            ),
            reasons=tuple(self.why_no_pose(stamp) for stamp in stamps),
        )

    def _nominal(self, said: JointState | None) -> pin.SE3 | None:
        """Return where the encoders alone put the endpoint."""
        if said is None:
            return None
        return self._chain.nominal_endpoint(dict(zip(said.name, said.position, strict=True)))


def _pose(said: PoseStamped | None) -> pin.SE3 | None:
    return None if said is None else pose_from_message(said.pose)
