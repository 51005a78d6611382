# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A bag with the scans of two arms: those of the arm are used and the others named, or none fits and all are named."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from posor import load_arm
from posor.bags.bag_writer import BagWriter
from posor.bags.offline_pipeline import topics_of
from posor.bags.reprocess_task import JointSettings, Settings
from posor.errors import BagError
from posor.messages.message_definitions import MessageTypes
from posor.ros_names import RAW_SCAN, TEMPERATURE

THERMOMETERS = {"link": "/temperature/link"}


def bag_of(folder: Path, arms: Sequence[str], joints: Sequence[str], *, extra: str = "") -> Path:
    """Write a bag with a message on each topic of arms, and on another topic of scans."""
    types = MessageTypes()
    raw = [f"{arm}/{joint}/raw" for arm in arms for joint in joints] + [extra] * bool(extra)
    with BagWriter(folder / "bag") as writer:
        for topics, kind in ((raw, RAW_SCAN), ([f"{arm}/temperature/link" for arm in arms], TEMPERATURE)):
            for topic in topics:
                writer.add_topic(topic, kind, types.definition(kind))
                writer.write(topic, 1, b"")
    return folder / "bag"


@pytest.mark.parametrize("namespace", ["", "/cell2"])
def test_the_scans_of_the_arm_are_taken_from_its_own_topics(namespace: str, tmp_path: Path) -> None:
    arm = load_arm("test_rig").in_namespace(namespace)
    joints = Settings.of_arm(arm).joints
    bag = bag_of(tmp_path, ["/cell1/test_rig", "/cell2/test_rig", "/test_rig"], list(joints))
    topics = topics_of(bag, joints, THERMOMETERS)
    assert topics.raw == {joint: f"{namespace}/test_rig/{joint}/raw" for joint in joints}
    assert topics.temperatures == {"link": f"{namespace}/test_rig/temperature/link"}
    [note] = topics.notes
    assert note == f"scans of the arm's own topics are used, those on {', '.join(topics.left_out)} are left out"
    assert len(topics.left_out) == 2 * len(joints)


def test_joints_of_two_arms_are_not_mixed(tmp_path: Path) -> None:
    joints = Settings.of_arm(load_arm("five_axis")).joints
    bag = bag_of(tmp_path, ["/cell2/five_axis"], list(joints), extra="/five_axis/elbow/raw")
    with pytest.raises(BagError, match="of joint base_swivel are on /cell2/five_axis/base_swivel/raw only, those of "):
        topics_of(bag, joints)


def test_a_bag_of_one_arm_has_no_note(tmp_path: Path) -> None:
    joints = Settings.of_arm(load_arm("test_rig")).joints
    topics = topics_of(bag_of(tmp_path, ["/cell1/test_rig"], [*joints, "other"]), joints)
    assert (topics.notes, topics.left_out) == ((), ("/cell1/test_rig/other/raw",))


def test_scans_of_an_arm_of_another_name_are_named(tmp_path: Path) -> None:
    joints = Settings.of_arm(load_arm("test_rig")).joints
    first, *_ = joints
    [note] = topics_of(bag_of(tmp_path / "a", ["/cell1/rig_7"], list(joints)), joints).notes
    assert note == f"the scans of {first} are on /cell1/rig_7/{first}/raw; the files are those of an arm 'test_rig'"
    assert topics_of(bag_of(tmp_path / "b", [""], list(joints)), joints).notes == ()


@pytest.mark.parametrize(
    ("own", "option", "expected"),
    [
        ("", "", "one of these topics."),
        ("", "--topic", "one of these topics, or --topic j=TOPIC."),
        ("/arm/j/raw", "", "one of these topics, or /arm/j/raw, that of the arm."),
        ("/arm/j/raw", "--topic", "one of these topics, or /arm/j/raw, that of the arm, or --topic j=TOPIC."),
    ],
)
def test_a_choice_that_is_left_to_the_user_is_named(own: str, option: str, expected: str, tmp_path: Path) -> None:
    bag = bag_of(tmp_path, ["/a", "/b"], ["j"])
    joint = JointSettings(Path("j.yaml"), own_topic=own)
    with pytest.raises(BagError) as caught:
        topics_of(bag, {"j": joint}, option=option)
    assert str(caught.value) == f"{bag}: scans of joint j may be on /a/j/raw, /b/j/raw; expected {expected}"
    chosen = topics_of(bag, {"j": JointSettings(Path("j.yaml"), topic="/b/j/raw", own_topic=own)}, THERMOMETERS)
    assert (chosen.temperatures, chosen.notes) == ({"link": "/b/temperature/link"}, ())
