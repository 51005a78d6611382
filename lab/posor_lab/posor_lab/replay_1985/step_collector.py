"""Collects the steps of a replay: joins transform, endpoint and machining-centre reading by stamp."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PointStamped, PoseStamped
from posor.model.fault import Fault, State
from posor.ros_names import ENDPOINT_TOPIC, TRANSFORM_TOPIC, TRUTH_TOPIC
from posor_msgs.msg import JointTransform
from posor_ros.message_conversion import is_usable

from posor_lab.replay_1985.motion_test import MotionStep
from posor_lab.reports.graph_receiver import GraphReceiver


class StepCollector(GraphReceiver):
    """Subscribes to the transforms of one joint, the endpoint and the machining centre.

    A step is complete with a transform and a machining-centre reading, and an endpoint if the transform is usable.
    """

    def __init__(self, joint: str) -> None:
        """Subscribe; ``joint``: namespace of the joint, such as ``joint1``."""
        super().__init__("demo")
        self.transforms = self.store_topic(JointTransform, f"/{joint}/{TRANSFORM_TOPIC}")
        self.poses = self.store_topic(PoseStamped, f"/{ENDPOINT_TOPIC}")
        self.truths = self.store_topic(PointStamped, TRUTH_TOPIC)

    def missing(self) -> list[str]:
        """Return the messages that are missing although another message of the same scan has arrived."""
        stamps = sorted(self.truths.keys() | self.transforms.keys() | self.poses.keys())
        usable = [stamp for stamp, transform in self.transforms.items() if is_usable(transform)]
        return [
            *(f"machining-centre reading of {self._scan_name(stamp)}" for stamp in stamps if stamp not in self.truths),
            *(f"transform of {self._scan_name(stamp)}" for stamp in stamps if stamp not in self.transforms),
            *(f"endpoint of {self._scan_name(stamp)}" for stamp in usable if stamp not in self.poses),
        ]

    def _scan_name(self, stamp: int) -> str:
        transform = self.transforms.get(stamp)
        return f"the scan at {stamp / 1e9:.3f} s" if transform is None else f"scan {transform.scan}"

    def complete_steps(self) -> list[MotionStep]:
        """Return the steps received so far, up to the first incomplete one."""
        steps = []
        for stamp in sorted(self.truths.keys() | self.transforms.keys()):
            transform = self.transforms.get(stamp)
            if transform is None or stamp not in self.truths or (is_usable(transform) and stamp not in self.poses):
                break
            steps.append(self._step(stamp))
        return steps

    def _step(self, stamp: int) -> MotionStep:
        transform, truth, pose = self.transforms[stamp], self.truths[stamp].point, self.poses.get(stamp)
        point = None if pose is None else pose.pose.position
        return MotionStep(
            number=int(transform.scan),
            state=State(transform.state),
            faults=Fault(transform.faults),
            scan_status=int(transform.scan_status),
            angles=np.array(transform.native[3:6], dtype=float),
            truth=np.array([truth.x, truth.y, truth.z]),
            endpoint=np.full(3, np.nan) if point is None else np.array([point.x, point.y, point.z]),
        )
