"""The topics of a bag that hold the raw scans of an arm's joints, and the topics of the results."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor.bags.bag_reader import check_filled, checked_type, opened_bag
from posor.errors import BagError
from posor.messages.message_definitions import schema_of_connection
from posor.messages.raw_scan import check_raw_scan_schema
from posor.ros_names import RAW_SCAN, RAW_TOPIC, TRANSFORM_TOPIC

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from rosbags.interfaces import Connection, Qos

    from posor.bags.reprocess_task import JointSettings
    from posor.messages.cdr_schema import Schema


@dataclass(frozen=True)
class BagTopics:
    """The topics of a bag with raw scans, and how they were recorded.

    Attributes:
        raw: Topic of each joint's raw scans.
        schemas: Of the raw scans, by joint, as the bag defines them.
        left_out: Topics of raw scans of other joints.
        offered: Quality of service with which the raw scans were recorded.
        messages: Number of raw scans of the joints.

    """

    raw: Mapping[str, str]
    schemas: Mapping[str, Schema]
    left_out: tuple[str, ...]
    offered: Sequence[Qos]
    messages: int

    @property
    def transforms(self) -> dict[str, str]:
        """Topic of each joint's transforms, beside its raw scans."""
        return {joint: f"{topic.rpartition('/')[0]}/{TRANSFORM_TOPIC}" for joint, topic in self.raw.items()}

    @property
    def namespace(self) -> str:
        """The common prefix of ``/<joint>/raw`` in all joints' topics; empty if the prefixes differ."""
        found = {topic.removesuffix(f"/{joint}/{RAW_TOPIC}") for joint, topic in self.raw.items()}
        same = len(found) == 1 and not found & set(self.raw.values())
        return found.pop() if same else ""


def topics_of(bag: Path, joints: Mapping[str, JointSettings]) -> BagTopics:
    """Return the topics of a bag after checking them.

    Raises:
        BagError: The bag cannot be read, a joint has no scans or scans on several topics, or a topic has another type.

    """
    where = str(bag)
    with opened_bag(bag) as reader:
        connections = list(reader.connections)
        raw = {joint: settings.topic or _topic(joint, connections, where) for joint, settings in joints.items()}
        for joint, topic in raw.items():
            checked_type(connections, topic, where, None, (RAW_SCAN,))
            check_filled(connections, topic, where)
            twice = [other for other, same in raw.items() if same == topic and other != joint]
            if twice:
                raise BagError(
                    f"topic {topic} is taken for the scans of {joint} and of {twice[0]}",
                    where=where,
                    expected="a topic for each joint",
                )
        own = [connection for connection in connections if connection.topic in raw.values()]
        schemas = {
            joint: schema_of_connection(next(c for c in own if c.topic == topic), where) for joint, topic in raw.items()
        }
        for joint, schema in schemas.items():
            check_raw_scan_schema(schema, f"{where}, topic {raw[joint]}")
        scans = {connection.topic for connection in connections if connection.msgtype == RAW_SCAN}
        offered = getattr(own[0].ext, "offered_qos_profiles", [])
        return BagTopics(
            raw,
            schemas,
            tuple(sorted(scans - set(raw.values()))),
            list(offered[:1]),
            sum(connection.msgcount for connection in own),
        )


def _topic(joint: str, connections: Sequence[Connection], where: str) -> str:
    names = sorted({connection.topic for connection in connections if connection.msgtype == RAW_SCAN})
    found = [name for name in names if name.endswith(f"/{joint}/{RAW_TOPIC}")]
    if len(found) == 1:
        return found[0]
    if found:
        what, expected = f"scans of joint {joint} may be on {', '.join(found)}", f"--topic {joint}=ONE of them"
    elif names:
        what = f"there are no scans of joint {joint} on .../{joint}/{RAW_TOPIC}"
        expected = f"one of {', '.join(names)}"
    else:
        what, expected = f"there are no raw scans of joint {joint}, nor of any other", "a bag of recorded raw scans"
    raise BagError(what, where=where, expected=expected)
