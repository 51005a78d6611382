# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recordings for the live page from raw scans: transforms and states of the endpoint, as the nodes publish them.

The numbers are those of the pipeline of ``reprocess``, the verdicts those of ``chain_node``. The age of a state is not
known, because nothing was published.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from posor.bags.arm_estimator import ArmEstimator
from posor.bags.bag_reader import opened_bag
from posor.bags.bag_writer import BagWriter, TopicMessages
from posor.bags.offline_pipeline import estimate_bag, topics_of
from posor.bags.reprocess_task import Settings
from posor.chain.beam_temperatures import PERIOD_NS
from posor.chain.fault_bounds import EndpointBounds
from posor.errors import ChainError
from posor.messages.endpoint_messages import MAX_REASON, POSE
from posor.messages.estimate_arrays import EndpointEstimates
from posor.messages.joint_transform import pack_joint_transforms
from posor.messages.message_definitions import MessageTypes
from posor.messages.message_table import TableLayout
from posor.model.fault import State
from posor.numerics.stamps import NS
from posor.ros_names import ENDPOINT_STATE, ENDPOINT_STATE_TOPIC, JOINT_TRANSFORM, RAW_TOPIC, TRANSFORM_TOPIC
from posor_estimator.endpoint_verdict import SOUND, JointStatus, degraded_by, degraded_verdict, unusable_verdict
from posor_ros.qos import RELIABLE_QOS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from posor.bags.arm_estimator import EndpointPipeline
    from posor.chain.arm_file import ArmFile
    from posor.messages.endpoint_messages import EndpointVerdict
    from posor.messages.estimate_arrays import ArmEstimates
    from posor.messages.joint_transform import TransformConstants
    from posor.messages.message_table import MessageTable
    from posor.numerics.array_types import BoolArray, IntArray

MISSING = -1  # state of a joint without a transform


class JointStates(NamedTuple):
    """States of one joint that wait for those of the others."""

    stamps_ns: IntArray  # shape (n,)
    log_times_ns: IntArray
    states: IntArray
    faults: IntArray

    def select(self, which: BoolArray) -> JointStates:
        """Return some of the states."""
        return JointStates(*(array[which] for array in self))


class EndpointStates:
    """Makes the states of the endpoint from the estimates of block after block."""

    def __init__(self, endpoint: EndpointPipeline, child_frame: str, types: MessageTypes) -> None:
        self._endpoint, self._schema = endpoint, types.schema(ENDPOINT_STATE)
        self._frames = {"header.frame_id": endpoint.frame, "child_frame_id": child_frame, "age": np.nan}
        nothing = np.zeros(0, dtype=np.int64)
        self._waiting = {name: JointStates(*[nothing] * 4) for name in endpoint.joints}

    def add(self, estimates: ArmEstimates, bounds: EndpointBounds) -> list[tuple[int, bytes]]:
        """Return log time and message at all stamps to which no joint can add a transform any more."""
        for name, before in self._waiting.items():
            own = estimates.joints[name]
            usable = own.stamps_ns != 0
            new = (own.stamps_ns, own.log_times_ns, own.states, own.faults)
            self._waiting[name] = JointStates(
                *(np.concatenate([old, each[usable]]) for old, each in zip(before, new, strict=True))
            )
        end = min(int(each.stamps_ns.max(initial=-1)) for each in self._waiting.values())
        return self._states(end, estimates.endpoint, bounds)

    def finish(self) -> list[tuple[int, bytes]]:
        """Return those at the stamps that wait for a transform."""
        end = max(int(each.stamps_ns.max(initial=-1)) for each in self._waiting.values())
        return self._states(end, EndpointEstimates.none(), EndpointBounds.allocate(0))

    def _states(self, end_ns: int, endpoint: EndpointEstimates, bounds: EndpointBounds) -> list[tuple[int, bytes]]:
        joints = {name: each.select(each.stamps_ns <= end_ns) for name, each in self._waiting.items()}
        self._waiting = {name: each.select(each.stamps_ns > end_ns) for name, each in self._waiting.items()}
        stamps = np.unique(np.concatenate([each.stamps_ns for each in joints.values()]))
        count = len(stamps)
        states, faults = np.full((count, len(joints)), MISSING), np.zeros((count, len(joints)), dtype=np.int64)
        log_times = np.zeros(count, dtype=np.int64)
        for j, each in enumerate(joints.values()):
            rows = np.searchsorted(stamps, each.stamps_ns)
            states[rows, j], faults[rows, j] = each.states, each.faults
            log_times[rows] = np.maximum(log_times[rows], each.log_times_ns)
        place = np.full(count, MISSING)  # of the endpoint
        place[np.searchsorted(stamps, endpoint.stamps_ns)] = np.arange(len(endpoint))
        causes = np.full((count, 12), MISSING)
        causes[place >= 0] = np.concatenate([bounds.joints, bounds.causes], axis=1)[place[place >= 0]]
        reasons = [self._endpoint.reasons.get(period, "") for period in (stamps // PERIOD_NS).tolist()]
        reason_of = np.unique(reasons, return_inverse=True)[1]
        keys = np.concatenate([states, faults, causes, (place >= 0)[:, None], reason_of[:, None]], axis=1)
        kinds, kind_of = np.unique(keys, axis=0, return_inverse=True)
        found: list[tuple[int, bytes]] = []
        for kind in range(len(kinds)):
            rows = np.flatnonzero(kind_of.ravel() == kind)
            first = rows[0]
            verdict = self._verdict(list(joints), states[first], faults[first], has_pose=bool(place[first] >= 0))
            if verdict.has_pose:
                verdict = degraded_by(verdict, reasons[first])
            set_by = self._endpoint.set_by(bounds, int(place[first])) if verdict.has_pose else ()
            table = self._table(verdict, set_by, len(rows))
            table["header.stamp.sec"], table["header.stamp.nanosec"] = np.divmod(stamps[rows], NS)
            if verdict.has_pose:
                own = place[rows]
                table.span(POSE, 7)[:] = endpoint.poses[own]
                table["covariance_random"] = endpoint.covariances_random[own].reshape(-1, 36)
                table["covariance_systematic"] = endpoint.covariances_systematic[own].reshape(-1, 36)
                table["protection_level"] = endpoint.protection_levels[own]
            messages = (message.tobytes() for message in table.messages)
            found += zip(log_times[rows].tolist(), messages, strict=True)
        return sorted(found, key=lambda each: each[0])

    def _table(self, verdict: EndpointVerdict, set_by: Sequence[tuple[str, str]], count: int) -> MessageTable:
        """Return copies of a message with a verdict; every number is NaN."""
        values: dict[str, Any] = {
            "state": verdict.state,
            "faults": verdict.faults,
            "joint": verdict.joint,
            "reason": verdict.reason.encode()[:MAX_REASON].decode(errors="ignore"),
            "protection_causes": [f"{joint}: {cause}" if cause else "" for joint, cause in set_by],
        }
        table = TableLayout.of(self._schema.encode(self._frames | values), self._schema).copies(count)
        table.span(POSE, 7)[:] = np.nan
        for name in ("covariance_random", "covariance_systematic", "protection_level"):
            table[name] = np.nan
        return table

    @staticmethod
    def _verdict(names: Sequence[str], states: IntArray, faults: IntArray, *, has_pose: bool) -> EndpointVerdict:
        """Return the verdict of ``chain_node`` on a stamp."""
        joints = [
            JointStatus(name, int(State.LOST if state == MISSING else state), int(fault))
            for name, state, fault in zip(names, states, faults, strict=True)
        ]
        if missing := [name for name, state in zip(names, states, strict=True) if state == MISSING]:
            reason = f"{', '.join(missing)}: transform missing from a scan that the other joints sent"
            return unusable_verdict(joints)._replace(joint=missing[0], reason=reason)
        if not has_pose:
            return unusable_verdict(joints)
        return SOUND if max(states) == State.OK else degraded_verdict(joints)


def estimate_raw_scans(bag: Path, arm: ArmFile, folder: Path, copied: Iterable[str]) -> Path:
    """Write the transforms and states of a bag with raw scans into a new bag below a folder; return the bag.

    ``copied``: topics whose messages are taken over. Raises PosorError: the bag or a file of the arm cannot be used.
    """
    settings = Settings.of_arm(arm)
    joints = {
        name: replace(each, topic=f"{arm.namespace}/{name}/{RAW_TOPIC}") for name, each in settings.joints.items()
    }
    estimator, types = ArmEstimator(settings), MessageTypes()
    topics = topics_of(bag, joints, estimator.thermometers)
    with BagWriter(folder / arm.name) as writer:
        recording = Recording(writer, arm, estimator, estimator.transforms)
        with opened_bag(bag) as reader:
            connections = [each for each in reader.connections if each.topic in set(copied)]
            for connection, time_ns, data in reader.messages(connections) if connections else ():
                kind = connection.msgtype
                channel = writer.add_topic(connection.topic, kind, types.definition(kind))
                writer.write_message(channel, time_ns, bytes(data))
        for estimates in estimate_bag(bag, topics, estimator):
            recording.write(estimates, recording.endpoint.bounds)
        recording.finish()
    return writer.path


class Recording:
    """Writes the transforms and states of an arm into a bag.

    Attributes:
        endpoint: The kinematic chain.

    """

    def __init__(
        self, writer: BagWriter, arm: ArmFile, estimator: ArmEstimator, transforms: Mapping[str, TransformConstants]
    ) -> None:
        """Add the topics; ``transforms``: what is the same in all of a joint.

        Raises ChainError: the estimator has no kinematic chain.
        """
        if estimator.endpoint is None:
            raise ChainError("there is no kinematic chain", where=str(arm.path), expected="an arm with a URDF")
        self._writer, self.endpoint, types = writer, estimator.endpoint, MessageTypes()
        self._states = EndpointStates(self.endpoint, arm.endpoint_frame, types)

        def add_topic(topic: str, kind: str) -> int:
            return writer.add_topic(f"{arm.namespace}/{topic}", kind, types.definition(kind), [RELIABLE_QOS])

        schema = types.schema(JOINT_TRANSFORM)
        self._joints = {
            name: (add_topic(f"{name}/{TRANSFORM_TOPIC}", JOINT_TRANSFORM), constants.layout(schema))
            for name, constants in transforms.items()
        }
        self._channel = add_topic(ENDPOINT_STATE_TOPIC, ENDPOINT_STATE)

    def write(self, estimates: ArmEstimates, bounds: EndpointBounds) -> None:
        """Write the messages of a block; ``bounds``: of its endpoints."""
        parts = []
        for name, (channel, layout) in self._joints.items():
            own = estimates.joints[name]
            parts.append(TopicMessages(channel, own.log_times_ns, pack_joint_transforms(layout, own).messages))
        self._writer.write_messages(parts)
        self._write_states(self._states.add(estimates, bounds))

    def finish(self) -> None:
        """Write the states that wait for transforms."""
        self._write_states(self._states.finish())

    def _write_states(self, messages: Iterable[tuple[int, bytes]]) -> None:
        for time_ns, data in messages:
            self._writer.write_message(self._channel, time_ns, data)
