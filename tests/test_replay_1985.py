# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The 1985 bags through node processes over DDS: every step against the thesis and the numerical core."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from posor.model.fault import Fault, State
from posor.model.scan import DIODES_ESTIMATED, PROBES_ESTIMATED
from posor.numerics.array_types import FloatArray
from posor_lab.harness.rig_files import BAGS, CALIBRATIONS, Bag, CalibrationName
from posor_lab.replay_1985.comparison import STEPS, compare_with_thesis
from posor_lab.replay_1985.motion_test import MotionTest
from posor_lab.replay_1985.printed_results import PRINTED_FILES, read_printed
from posor_lab.replay_1985.replay import TOPICS, ReplayPlan
from posor_lab.reports.findings import Verdict
from posor_lab.thesis_data import data_path
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
ALPHA, BETA, THETA = range(3)
INCH = 0.0254

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

    @property
    def case(self) -> tuple[Bag, CalibrationName]:
        return self.bag, self.calibration


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(
            (bag, calibration),
            id=f"{bag}-{calibration}",
            marks=() if (bag == "ymo" or calibration == "printed") else pytest.mark.long,
        )
        for bag in BAGS
        for calibration in CALIBRATIONS
    ],
)
def replay(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> CompletedReplay:
    bag, calibration = request.param
    plan = make_plan(tmp_path_factory.mktemp(bag), bag, calibration)
    return CompletedReplay(bag, calibration, plan, MotionTest(tuple(run_replay(plan).complete_steps())))


def angle_errors(replay: CompletedReplay) -> FloatArray:
    """Return alpha, beta, theta less those of the machining centre [urad], relative to step 1, of steps with a pose."""
    steps = [step for step in replay.test.steps if np.isfinite(step.angles[0])]
    angles = np.array([step.angles for step in steps])
    truth = np.array([step.truth for step in steps])
    measured = np.zeros_like(angles)
    measured[:, 1:] = -np.arctan((truth - truth[0])[:, 1:] / (31.43 * INCH))
    return np.asarray((angles - angles[0] - measured) * 1e6)


def standard_deviation(errors: FloatArray) -> float:
    """Return the standard deviation of the thesis: steps 2 to N over N - 2."""
    return float(np.sqrt(np.sum(errors[1:] ** 2) / (len(errors) - 2)))


def test_no_step_is_lost_on_the_way(replay: CompletedReplay) -> None:
    assert replay.test.numbers == list(range(1, STEPS[replay.bag] + 1))
    counts = {topic: len(messages) for topic, messages in read_bag_messages(replay.plan.recorded).items()}
    poses = sum(step.has_pose for step in replay.test.steps)
    assert counts == {RAW: STEPS[replay.bag], TRANSFORM: STEPS[replay.bag], TRUTH: STEPS[replay.bag], ENDPOINT: poses}


def test_the_comparison_of_the_demo_holds(replay: CompletedReplay) -> None:
    name = PRINTED_FILES.get(replay.bag)
    comparison = compare_with_thesis(replay.test, *replay.case, read_printed(data_path(name)) if name else None)
    assert [item for item in comparison.findings if item.verdict is Verdict.FAILS] == []
    assert comparison.holds


def test_the_figures_of_the_thesis_come_out(replay: CompletedReplay) -> None:
    error = angle_errors(replay)
    if replay.bag == "zmo":
        assert standard_deviation(error[:, THETA]) == pytest.approx(65.0, abs=2.0)
    if replay.case == ("ymo", "section84"):
        assert standard_deviation(error[:, BETA]) == pytest.approx(4.3, abs=0.3)
        assert error[-1, ALPHA] == pytest.approx(-23.0, abs=2.0)
    if replay.case == ("yzmo", "section84"):
        assert standard_deviation(error[:, BETA]) == pytest.approx(7.5, abs=0.3)
        assert standard_deviation(error[:, ALPHA]) == pytest.approx(2.7, abs=0.3)
    if replay.bag == "yzmo":
        assert standard_deviation(error[:, THETA]) < 92.0
    if replay.case == ("ymo", "printed"):
        printed = read_printed(data_path(PRINTED_FILES["ymo"])).posor * 1e6
        difference = np.abs(replay.test.posor_angles * 1e6 - printed)
        assert difference[:, ALPHA].max() <= 1.0
        assert difference[:, BETA].max() <= 1.0
        assert difference[replay.test.fully_measured("theta"), THETA].max() <= 6.0


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
