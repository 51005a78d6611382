"""Results as a rosbag2 bag: the messages that the nodes would have published, on the same topics."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rosbags.interfaces import QosReliability
from sensor_msgs.msg import JointState

from posor_estimator.bulk.bag_writer import BulkWriter, Part
from posor_estimator.bulk.layout import TableLayout
from posor_estimator.core.kernels.stamps import NS
from posor_estimator.ros.message_types import (
    JOINT_STATE,
    JOINT_TRANSFORM,
    POSE_STAMPED,
    POSE_WITH_COVARIANCE_STAMPED,
    MessageTypes,
)
from posor_estimator.ros.qos import ENDPOINT_COVARIANCE_TOPIC, ENDPOINT_TOPIC, JOINT_STATES_TOPIC

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from rosbags.interfaces import Connection, Qos

    from posor_estimator.core.types import ByteArray
    from posor_estimator.reprocess.endpoint import Endpoints
    from posor_estimator.reprocess.transforms import Transforms

CHUNK = 4 << 20
"""Bytes of messages in a chunk, about."""


class BagOutput:
    """Writes one bag."""

    def __init__(
        self,
        folder: Path,
        topics: Mapping[str, str],
        endpoint: EndpointTopics | None,
        offered: Sequence[Qos],
    ) -> None:
        """Create the bag.

        Args:
            folder: Where; not yet there.
            topics: Of each joint's transforms.
            endpoint: What is said of the endpoint; None: nothing.
            offered: Quality of service of the raw scans; the transforms have the same.

        """
        types = MessageTypes()
        self._writer = BulkWriter(folder)
        self._writer.open()

        def connection(topic: str, kind: str, profiles: Sequence[Qos]) -> Connection:
            text, type_hash = types.definition(kind)
            return self._writer.add_connection(
                topic, kind, msgdef=text, rihs01=type_hash, offered_qos_profiles=list(profiles)
            )

        self._transforms = {name: connection(topic, JOINT_TRANSFORM, offered) for name, topic in topics.items()}
        self._endpoint = endpoint
        reliable = [profile._replace(reliability=QosReliability.RELIABLE) for profile in offered]
        self._results = [] if endpoint is None else [connection(*each, reliable) for each in endpoint.topics()]

    def write(self, transforms: Mapping[str, Transforms], endpoints: Endpoints | None) -> None:
        """Write what a block has given."""
        parts = [Part(self._transforms[name], each.times_ns, each.table.messages) for name, each in transforms.items()]
        if endpoints is not None and self._endpoint is not None:
            for connection, messages in zip(self._results, self._endpoint.messages(endpoints), strict=True):
                parts.append(Part(connection, endpoints.times_ns, messages))
        parts = [part for part in parts if len(part.times_ns)]
        if not parts:
            return
        count = -(-sum(part.messages.nbytes for part in parts) // CHUNK)
        longest = max(parts, key=lambda part: len(part.times_ns)).times_ns
        ends = [int(longest[len(longest) * n // count]) for n in range(1, count)]
        begins = [[0] * len(parts)]
        begins += [[int(np.searchsorted(part.times_ns, end)) for part in parts] for end in ends]
        begins.append([len(part.times_ns) for part in parts])
        for begin, end in pairwise(begins):
            self._writer.write_parts(
                [
                    Part(part.connection, part.times_ns[b:e], part.messages[b:e])
                    for part, b, e in zip(parts, begin, end, strict=True)
                ]
            )

    def close(self) -> None:
        """Write index and metadata."""
        self._writer.close()


class EndpointTopics:
    """What a chain_node says of the endpoint, as messages."""

    def __init__(self, namespace: str, frame: str, joints: Sequence[str]) -> None:
        """Prepare messages.

        Args:
            namespace: Of the arm's topics, such as ``/five_axis``; empty: the root.
            frame: In which the endpoint is.
            joints: Names of the joints.

        """
        pose, with_covariance = PoseStamped(), PoseWithCovarianceStamped()
        pose.header.frame_id = with_covariance.header.frame_id = frame
        joint_states = JointState(name=list(joints), position=[0.0] * len(joints))
        self._namespace = namespace
        self._pose = TableLayout.like(pose)
        self._with_covariance = TableLayout.like(with_covariance)
        self._joint_states = TableLayout.like(joint_states)

    def topics(self) -> list[tuple[str, str]]:
        """Return names and types, in the order of ``messages``."""
        return [
            (f"{self._namespace}/{ENDPOINT_TOPIC}", POSE_STAMPED),
            (f"{self._namespace}/{ENDPOINT_COVARIANCE_TOPIC}", POSE_WITH_COVARIANCE_STAMPED),
            (f"{self._namespace}/{JOINT_STATES_TOPIC}", JOINT_STATE),
        ]

    def messages(self, endpoints: Endpoints) -> list[ByteArray]:
        """Return the messages of each topic, (n, bytes)."""
        pose, with_covariance, joint_states = (
            layout.new(len(endpoints)) for layout in (self._pose, self._with_covariance, self._joint_states)
        )
        for table in (pose, with_covariance, joint_states):
            table["header.stamp.sec"] = endpoints.stamps_ns // NS
            table["header.stamp.nanosec"] = endpoints.stamps_ns % NS
        pose.span("pose.position.x", 7)[:] = endpoints.poses
        with_covariance.span("pose.pose.position.x", 7)[:] = endpoints.poses
        with_covariance["pose.covariance"] = endpoints.covariances.reshape(-1, 36)
        joint_states["position"] = endpoints.angles
        return [pose.messages, with_covariance.messages, joint_states.messages]
