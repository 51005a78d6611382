# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The recording of a commissioning: scans of all joints, encoders, a reference of the endpoint, and the steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.bags.bag_reader import checked_type, opened_bag
from posor.bags.block_reader import read_messages
from posor.bags.calibration_recording import bag_sha256, read_scans
from posor.bags.recording import Track
from posor.errors import BagError, TopicError
from posor.messages.joint_position import joint_position
from posor.messages.message_definitions import schema_of_topic
from posor.numerics.stamps import time_ns
from posor.ros_names import COMMISSIONING_STEP, JOINT_STATE, POINT_STAMPED

from posor_calibration.commissioning.plan import Step

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path
    from typing import Any

    from posor.bags.ordered_reader import OrderedReader
    from posor.model.scan import Scans

ANNOUNCED, BEGIN, END = range(3)
"""Phases of ``posor_msgs/CommissioningStep``."""


@dataclass(frozen=True)
class CommissioningTopics:
    """Topics of an arm."""

    raw: Mapping[str, str]  # of the scans, by joint
    encoders: Mapping[str, tuple[str, str]]  # of each joint's encoder, and the joint's name in its messages
    steps: str  # of the steps
    reference: str = ""  # of the reference of the endpoint (geometry_msgs/PointStamped); empty: none


@dataclass(frozen=True)
class RecordedStep:
    """A step and the time that it took [ns]."""

    step: Step
    begin_ns: int
    end_ns: int

    def select(self, scans: Scans) -> Scans:
        """Return the scans of the step."""
        stamps = scans.stamps_ns
        return scans.select((stamps >= self.begin_ns) & (stamps <= self.end_ns))


@dataclass(frozen=True)
class CommissioningRecording:
    """All that the checks need."""

    scans: Mapping[str, Scans]  # by joint
    encoders: Mapping[str, Track]  # angle of each joint that has one [rad]
    steps: Sequence[RecordedStep]
    reference: Track | None  # position of the endpoint [m]; None: no reference
    reference_frame: str  # frame of the reference
    source: str  # name of the recording
    sha256: str = ""  # of the bag; empty: not from a bag

    def find(self, step: Step) -> RecordedStep | None:
        """Return the last recording of a step, whatever its size; None: there is none."""
        same = [each for each in self.steps if each.step[:3] == step[:3]]
        return same[-1] if same else None


def load_commissioning(bag: Path, topics: CommissioningTopics) -> CommissioningRecording:
    """Read the recording of a commissioning.

    Raises BagError: the bag cannot be read, lacks scans or steps, a step has no end, or it is unknown which of several
    positions is that of a joint.
    """
    where = str(bag)
    scans = {joint: read_scans(bag, topic) for joint, topic in topics.raw.items()}
    with opened_bag(bag) as reader:
        steps = _paired([each for _, each in _read(reader, topics.steps, COMMISSIONING_STEP, where)], where)
        filled = {each.topic for each in reader.connections if each.msgcount}
        states = {
            topic: _read(reader, topic, JOINT_STATE, where)
            for topic in {topic for topic, _ in topics.encoders.values()} & filled
        }
        encoders = {
            joint: track
            for joint, (topic, name) in topics.encoders.items()
            if topic in states and (track := _encoder_track(states[topic], name, f"{where}, topic {topic}")) is not None
        }
        points = _read(reader, topics.reference, POINT_STAMPED, where) if topics.reference else []
    frame = str(points[0][1]["header.frame_id"]) if points else ""
    values = np.array([[each[f"point.{axis}"] for axis in "xyz"] for _, each in points])
    reference = (
        Track(np.array([stamp for stamp, _ in points]), values, np.zeros(3), f"{where}, topic {topics.reference}")
        if points
        else None
    )
    return CommissioningRecording(scans, encoders, steps, reference, frame, where, bag_sha256(bag))


def _read(reader: OrderedReader, topic: str, kind: str, where: str) -> list[tuple[int, Mapping[str, Any]]]:
    """Return stamp [ns] and values of all messages of a topic."""
    checked_type(reader.connections, topic, where, None, (kind,), filled=True)
    schema = schema_of_topic(reader.connections, topic, where)
    values = [schema.values(data) for _, _, data in read_messages(reader, [topic], where)]
    return [(time_ns(each["header.stamp.sec"], each["header.stamp.nanosec"]), each) for each in values]


def _encoder_track(messages: Sequence[tuple[int, Mapping[str, Any]]], name: str, where: str) -> Track | None:
    """Return the angles of a joint; None: no message holds it. Raises BagError: it has no name among several."""
    found: dict[int, float] = {}
    for stamp, values in messages:
        names, positions = list(values["name"]), list(values["position"])
        if not positions or (name and name not in names):
            continue  # efforts, or other joints of the topic
        try:
            found[stamp] = joint_position(names, positions, name)
        except TopicError as error:
            raise BagError(error.what, where=where, expected=error.expected) from error
    if not found:
        return None
    stamps = sorted(found)
    return Track(np.array(stamps), np.array([[found[stamp]] for stamp in stamps]), np.zeros(1), where)


def _paired(messages: Sequence[Mapping[str, Any]], where: str) -> list[RecordedStep]:
    """Return the steps that the messages on begins and ends describe."""
    steps: list[RecordedStep] = []
    begun: tuple[Step, int] | None = None
    for values in messages:
        step = Step(*(values[name] for name in Step._fields))
        stamp = time_ns(values["header.stamp.sec"], values["header.stamp.nanosec"])
        if values["phase"] == BEGIN:
            begun = step, stamp
        elif values["phase"] == END:
            if begun is None or begun[0] != step:
                raise BagError(f"step '{step.name}' ends", where=where, expected="its begin before")
            steps.append(RecordedStep(step, begun[1], stamp))
            begun = None
    if begun is not None:
        raise BagError(f"step '{begun[0].name}' has no end", where=where, expected="a recording of whole steps")
    return steps
