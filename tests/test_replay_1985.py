# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The 1985 bags through node processes over DDS: every step is that of the numerical core.

The steps without nodes are compared with the thesis in ``lab/posor_lab/test/replay_1985/test_motion_test.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from posor.model.fault import Fault, State
from posor.model.scan import DIODES_ESTIMATED, PROBES_ESTIMATED
from posor_lab.harness.rig_files import BAGS, CALIBRATIONS, Bag, CalibrationName
from posor_lab.replay_1985.comparison import STEPS
from posor_lab.replay_1985.motion_test import MotionTest, offline_motion_test
from posor_lab.replay_1985.replay import TOPICS, ReplayPlan
from posor_msgs.msg import JointTransform
from rclpy.serialization import deserialize_message

from tests.rig_messages import (
    all_message_bits,
    estimate_endpoints,
    estimate_transforms,
    make_plan,
    message_bits,
    read_bag_messages,
)
from tests.rig_replay import run_replay

RAW, TRANSFORM, ENDPOINT, TRUTH = TOPICS
SHORT = (("ymo", "section84"), ("yzmo", "printed"))  # each calibration file; the second with a step without pose
ESTIMATED: dict[Bag, dict[int, int]] = {  # flags of steps whose readings are illegible in the source
    "ymo": {14: DIODES_ESTIMATED},
    "yzmo": {6: PROBES_ESTIMATED, 13: DIODES_ESTIMATED, 14: DIODES_ESTIMATED},
    "zmo": dict.fromkeys((3, 6, 9, 11, 14, 17), DIODES_ESTIMATED),
}


@dataclass(frozen=True)
class CompletedReplay:
    bag: Bag
    calibration: CalibrationName
    plan: ReplayPlan
    test: MotionTest


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(
            (bag, calibration), id=f"{bag}-{calibration}", marks=() if (bag, calibration) in SHORT else pytest.mark.long
        )
        for bag in BAGS
        for calibration in CALIBRATIONS
    ],
)
def replay(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> CompletedReplay:
    bag, calibration = request.param
    plan = make_plan(tmp_path_factory.mktemp(bag), bag, calibration)
    return CompletedReplay(bag, calibration, plan, MotionTest(tuple(run_replay(plan).complete_steps())))


def test_no_step_is_lost_on_the_way(replay: CompletedReplay) -> None:
    assert replay.test.numbers == list(range(1, STEPS[replay.bag] + 1))
    counts = {topic: len(messages) for topic, messages in read_bag_messages(replay.plan.recorded).items()}
    poses = sum(step.has_pose for step in replay.test.steps)
    assert counts == {RAW: STEPS[replay.bag], TRANSFORM: STEPS[replay.bag], TRUTH: STEPS[replay.bag], ENDPOINT: poses}


def test_every_step_is_that_without_nodes(replay: CompletedReplay) -> None:
    expected = offline_motion_test(replay.bag, replay.calibration)
    for step, other in zip(replay.test.steps, expected.steps, strict=True):
        assert (step.number, step.status, step.scan_status) == (other.number, other.status, other.scan_status)
        for name in ("angles", "truth", "endpoint"):
            np.testing.assert_allclose(getattr(step, name), getattr(other, name), rtol=0.0, atol=1e-12)


def test_estimated_steps_are_marked_and_step_14_of_yzmo_is_refused(replay: CompletedReplay) -> None:
    flags = {step.number: step.scan_status for step in replay.test.steps if step.scan_status}
    assert flags == ESTIMATED[replay.bag]
    refused = {step.number: (step.state, step.faults) for step in replay.test.steps if not step.has_pose}
    assert refused == ({14: (State.LOST, Fault.OUT_OF_RANGE | Fault.FLAGGED)} if replay.bag == "yzmo" else {})


def test_the_nodes_publish_what_the_core_computes(replay: CompletedReplay) -> None:
    messages = read_bag_messages(replay.plan.recorded)
    transforms = estimate_transforms(replay.plan, messages[RAW])
    assert [message_bits(transform) for transform in transforms] == all_message_bits(
        JointTransform, messages[TRANSFORM]
    )
    published = [deserialize_message(data, PoseStamped).pose for data in messages[ENDPOINT]]
    assert [message_bits(pose) for pose in published] == [
        message_bits(pose) for pose in estimate_endpoints(replay.plan, transforms)
    ]


@pytest.mark.long
@pytest.mark.parametrize("replay", [("yzmo", "printed")], indirect=True, ids="-".join)
def test_a_recorded_bag_replays_to_the_same_bits_at_another_rate(replay: CompletedReplay, tmp_path: Path) -> None:
    first = replay.plan
    second = replace(make_plan(tmp_path / "second", "yzmo", "printed", rate=10.0), bag=first.recorded)
    run_replay(second)
    before, after = read_bag_messages(first.recorded), read_bag_messages(second.recorded)
    assert set(before) == set(after) == set(TOPICS)
    assert before[RAW] == after[RAW]
    assert before[TRUTH] == after[TRUTH]
    assert all_message_bits(JointTransform, before[TRANSFORM]) == all_message_bits(JointTransform, after[TRANSFORM])
    assert all_message_bits(PoseStamped, before[ENDPOINT]) == all_message_bits(PoseStamped, after[ENDPOINT])
    assert len(before[TRANSFORM]) == STEPS["yzmo"]
    assert len(before[ENDPOINT]) == STEPS["yzmo"] - 1
