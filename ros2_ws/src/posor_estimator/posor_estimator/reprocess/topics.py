"""Which topics of a bag hold the raw scans of which joint, and on which ones the results belong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor_estimator.errors import BagError
from posor_estimator.ros.bag_reader import check_filled, checked_type, opened_bag
from posor_estimator.ros.message_types import RAW_SCAN, MessageTypes
from posor_estimator.ros.qos import RAW_TOPIC, TRANSFORM_TOPIC

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from rosbags.interfaces import Connection, Qos

    from posor_estimator.reprocess.task import JointSettings


@dataclass(frozen=True)
class BagTopics:
    """The topics of a bag that matter.

    Attributes:
        raw: Of each joint's raw scans.
        left_out: Of raw scans that belong to none of the joints.
        offered: Quality of service with which the raw scans were recorded.
        messages: How many raw scans there are of the joints.

    """

    raw: Mapping[str, str]
    left_out: tuple[str, ...]
    offered: Sequence[Qos]
    messages: int

    @property
    def transforms(self) -> dict[str, str]:
        """Of each joint's transforms: beside its raw scans."""
        return {joint: f"{topic.rpartition('/')[0]}/{TRANSFORM_TOPIC}" for joint, topic in self.raw.items()}

    @property
    def namespace(self) -> str:
        """What stands before ``/<joint>/raw`` in every joint's topic; empty where that is not one and the same."""
        found = {topic.removesuffix(f"/{joint}/{RAW_TOPIC}") for joint, topic in self.raw.items()}
        same = len(found) == 1 and not found & set(self.raw.values())
        return found.pop() if same else ""


def topics_of(bag: Path, joints: Mapping[str, JointSettings]) -> BagTopics:
    """Return the topics of a bag, checked.

    Raises:
        BagError: The bag cannot be read; a joint has no scans in it, or one can choose among several topics; the scans
            are of another type.

    """
    where = str(bag)
    with opened_bag(bag) as reader:
        types = MessageTypes()
        connections = list(reader.connections)
        raw = {joint: settings.topic or _topic(joint, connections, where) for joint, settings in joints.items()}
        for joint, topic in raw.items():
            checked_type(connections, topic, where, types, (RAW_SCAN,))
            check_filled(connections, topic, where)
            twice = [other for other, same in raw.items() if same == topic and other != joint]
            if twice:
                raise BagError(
                    f"topic {topic} is taken for the scans of {joint} and of {twice[0]}",
                    where=where,
                    expected="a topic for each joint",
                )
        mine = [connection for connection in connections if connection.topic in raw.values()]
        scans = {connection.topic for connection in connections if connection.msgtype == RAW_SCAN}
        offered = getattr(mine[0].ext, "offered_qos_profiles", [])
        return BagTopics(
            raw,
            tuple(sorted(scans - set(raw.values()))),
            list(offered[:1]),
            sum(connection.msgcount for connection in mine),
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
