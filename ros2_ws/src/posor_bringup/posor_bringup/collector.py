"""Receives what the graph publishes during a replay and puts it together, step by step."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PointStamped, PoseStamped
from posor_estimator.core.fault import Fault, State
from posor_estimator.ros.messages import is_usable
from posor_estimator.ros.qos import ENDPOINT_TOPIC, TRANSFORM_TOPIC, TRUTH_TOPIC
from posor_msgs.msg import JointTransform

from posor_bringup.motion import Step
from posor_bringup.receiver import Receiver


class Collector(Receiver):
    """Subscribes to one joint's transforms, the endpoint and the machining centre, and joins them by stamp."""

    def __init__(self, joint: str) -> None:
        """Subscribe.

        Args:
            joint: Namespace of the joint, such as ``joint1``.

        """
        super().__init__("demo")
        self.transforms = self.keep(JointTransform, f"/{joint}/{TRANSFORM_TOPIC}")
        self.poses = self.keep(PoseStamped, f"/{ENDPOINT_TOPIC}")
        self.truths = self.keep(PointStamped, TRUTH_TOPIC)

    def missing(self) -> list[str]:
        """Return what has not arrived although something else of the same scan has."""
        known = sorted(self.truths.keys() | self.transforms.keys() | self.poses.keys())
        lacking = [f"machining-centre reading of {self._scan(stamp)}" for stamp in known if stamp not in self.truths]
        lacking += [f"transform of {self._scan(stamp)}" for stamp in known if stamp not in self.transforms]
        lacking += [
            f"endpoint of {self._scan(stamp)}"
            for stamp, transform in self.transforms.items()
            if is_usable(transform) and stamp not in self.poses
        ]
        return lacking

    def _scan(self, stamp: int) -> str:
        transform = self.transforms.get(stamp)
        return f"the scan at {stamp / 1e9:.3f} s" if transform is None else f"scan {transform.scan}"

    def steps(self) -> list[Step]:
        """Return the complete steps received so far, up to the first of which something is still missing.

        Complete is a step with transform and truth, and with an endpoint if the transform is usable.
        """
        steps = []
        for stamp in sorted(self.truths.keys() | self.transforms.keys()):
            transform = self.transforms.get(stamp)
            if transform is None or stamp not in self.truths or (is_usable(transform) and stamp not in self.poses):
                break
            steps.append(self._step(stamp))
        return steps

    def _step(self, stamp: int) -> Step:
        transform, truth, pose = self.transforms[stamp], self.truths[stamp].point, self.poses.get(stamp)
        point = None if pose is None else pose.pose.position
        return Step(
            number=int(transform.scan),
            state=State(transform.state),
            faults=Fault(transform.faults),
            scan_status=int(transform.scan_status),
            angles=np.array(transform.native[3:6], dtype=float),
            truth=np.array([truth.x, truth.y, truth.z]),
            endpoint=np.full(3, np.nan) if point is None else np.array([point.x, point.y, point.z]),
        )
