# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Results of ``reprocess``: a rosbag2 bag with the messages that the nodes would have published, or tables."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from rosbags.interfaces import QosReliability

from posor.bags.bag_writer import BagWriter, TopicMessages
from posor.bags.data_frames import endpoint_columns, joint_columns
from posor.messages.endpoint_messages import endpoint_layouts, pack_endpoint
from posor.messages.joint_transform import pack_joint_transforms
from posor.messages.message_definitions import MessageTypes
from posor.ros_names import (
    ENDPOINT_COVARIANCE_TOPIC,
    ENDPOINT_TOPIC,
    JOINT_STATE,
    JOINT_STATES_TOPIC,
    JOINT_TRANSFORM,
    POSE_STAMPED,
    POSE_WITH_COVARIANCE_STAMPED,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from rosbags.interfaces import Qos

    from posor.bags.arm_estimator import ArmEstimator
    from posor.bags.reprocess_task import BagTopics
    from posor.messages.estimate_arrays import ArmEstimates

TableFormat = Literal["parquet", "csv"]
CHUNK_BYTES = 4 << 20  # approximate bytes of messages in a chunk
ENDPOINT_TOPICS = {
    ENDPOINT_TOPIC: POSE_STAMPED,
    ENDPOINT_COVARIANCE_TOPIC: POSE_WITH_COVARIANCE_STAMPED,
    JOINT_STATES_TOPIC: JOINT_STATE,
}


class BagOutput:
    """Writes one bag."""

    def __init__(
        self, folder: Path, topics: BagTopics, estimator: ArmEstimator, custom_data: Mapping[str, str], where: Path
    ) -> None:
        """Create the bag.

        ``folder``: does not exist yet; ``topics``: of the raw scans; the transforms have the same quality of service;
        ``custom_data``: of the bag's metadata; ``where``: names the bag in errors.
        """
        self._types = types = MessageTypes()
        self._writer = BagWriter(folder, custom_data, where)
        transform = types.schema(JOINT_TRANSFORM)
        self._joints = {
            name: (
                self._add_topic(topic, JOINT_TRANSFORM, topics.offered),
                estimator.transforms[name].layout(transform),
            )
            for name, topic in topics.transforms.items()
        }
        self._endpoint: tuple[int, ...] = ()
        end = estimator.endpoint
        if end is not None:
            reliable = [profile._replace(reliability=QosReliability.RELIABLE) for profile in topics.offered]
            self._endpoint = tuple(
                self._add_topic(f"{topics.namespace}/{topic}", kind, reliable)
                for topic, kind in ENDPOINT_TOPICS.items()
            )
            self._endpoint_layouts = endpoint_layouts(end.frame, end.joints)

    def _add_topic(self, topic: str, kind: str, profiles: Sequence[Qos]) -> int:
        return self._writer.add_topic(topic, kind, self._types.definition(kind), profiles)

    def write(self, estimates: ArmEstimates) -> None:
        """Write the messages of a block."""
        parts = []
        for name, joint in estimates.joints.items():
            channel, layout = self._joints[name]
            messages = pack_joint_transforms(layout, joint).messages
            parts.append(TopicMessages(channel, joint.log_times_ns, messages))
        if estimates.chain:
            tables = pack_endpoint(self._endpoint_layouts, estimates.endpoint)
            for channel, table in zip(self._endpoint, tables, strict=True):
                parts.append(TopicMessages(channel, estimates.endpoint.log_times_ns, table.messages))
        self._write_chunks([part for part in parts if len(part.times_ns)])

    def _write_chunks(self, parts: Sequence[TopicMessages]) -> None:
        if not parts:
            return
        count = -(-sum(part.messages.nbytes for part in parts) // CHUNK_BYTES)
        longest = max(parts, key=lambda part: len(part.times_ns)).times_ns
        ends = [int(longest[len(longest) * n // count]) for n in range(1, count)]
        bounds = [[0] * len(parts)]
        bounds += [[int(np.searchsorted(part.times_ns, end)) for part in parts] for end in ends]
        bounds.append([len(part.times_ns) for part in parts])
        for begins, ends_ in pairwise(bounds):
            self._writer.write_messages(
                [
                    TopicMessages(part.channel, part.times_ns[begin:end], part.messages[begin:end])
                    for part, begin, end in zip(parts, begins, ends_, strict=True)
                ]
            )

    def close(self) -> None:
        """Write index and metadata."""
        self._writer.close()


class TableOutput:
    """Writes a folder of tables."""

    def __init__(self, folder: Path, kind: TableFormat, joints: Sequence[str], chain: Sequence[str] | None) -> None:
        """Create the files.

        ``folder``: does not exist yet; ``kind``: format of the files; ``joints``: names of the joints; ``chain``: names
        of the chain's joints; None: no chain.
        """
        folder.mkdir()
        self._tables = {name: _Table(folder / f"{name}.{kind}", kind) for name in joints}
        self._endpoint = None if chain is None else _Table(folder / f"endpoint.{kind}", kind)

    def write(self, estimates: ArmEstimates) -> None:
        """Write the estimates of a block."""
        for name, joint in estimates.joints.items():
            self._tables[name].write(joint_columns(joint))
        if self._endpoint is not None:
            self._endpoint.write(endpoint_columns(estimates.endpoint, estimates.chain))

    def close(self) -> None:
        """Write what belongs at the end of the files."""
        for table in [*self._tables.values(), self._endpoint]:
            if table is not None:
                table.close()


class _Table:
    """One file; created with its first rows."""

    def __init__(self, path: Path, kind: TableFormat) -> None:
        self._path, self._kind = path, kind
        self._writer: Any = None

    def write(self, columns: Mapping[str, Any]) -> None:
        import pyarrow.csv  # noqa: PLC0415  pyarrow is an optional library
        import pyarrow.parquet  # noqa: PLC0415

        batch = pyarrow.RecordBatch.from_pydict(dict(columns))
        if self._writer is None and self._kind == "csv":
            self._writer = pyarrow.csv.CSVWriter(self._path, batch.schema)
        elif self._writer is None:
            self._writer = pyarrow.parquet.ParquetWriter(
                self._path, batch.schema, compression="zstd", use_dictionary=False
            )
        self._writer.write(batch)

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()
