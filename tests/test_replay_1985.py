"""The 1985 bags through real node processes over real DDS, every step checked against the thesis and the core."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from posor_bringup.comparison import compare
from posor_bringup.expectations import BAGS, CALIBRATIONS, STEPS, Bag, CalibrationName
from posor_bringup.findings import Verdict
from posor_bringup.installed import data_path
from posor_bringup.motion import DIODES_ESTIMATED, PROBES_ESTIMATED, MotionTest
from posor_bringup.replay import TOPICS
from posor_bringup.thesis import PRINTED_FILES, read_printed
from posor_estimator.core.fault import Fault, State
from posor_msgs.msg import JointTransform
from rclpy.serialization import deserialize_message

from tests.graphs import all_bits, bits, located, placed, recorded, replayed, rig

if TYPE_CHECKING:
    from pathlib import Path

    from posor_bringup.replay import ReplayPlan
    from posor_estimator.core.types import FloatArray

RAW, TRANSFORM, ENDPOINT, TRUTH = TOPICS
ALPHA, BETA, THETA = range(3)
INCH = 0.0254

ESTIMATED: dict[Bag, dict[int, int]] = {
    "ymo": {14: DIODES_ESTIMATED},
    "yzmo": {6: PROBES_ESTIMATED, 13: DIODES_ESTIMATED, 14: DIODES_ESTIMATED},
    "zmo": dict.fromkeys((3, 6, 9, 11, 14, 17), DIODES_ESTIMATED),
}
"""Steps whose readings the source does not show, and their flags."""


@dataclass(frozen=True)
class Outcome:
    """A replay that has run to its end."""

    bag: Bag
    calibration: CalibrationName
    plan: ReplayPlan
    test: MotionTest

    @property
    def case(self) -> tuple[Bag, CalibrationName]:
        return self.bag, self.calibration


@pytest.fixture(
    scope="module",
    params=[(bag, calibration) for bag in BAGS for calibration in CALIBRATIONS],
    ids="-".join,
)
def outcome(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """Replay one bag with one calibration, as fast as possible."""
    bag, calibration = request.param
    plan = rig(tmp_path_factory.mktemp(bag), bag, calibration)
    return Outcome(bag, calibration, plan, MotionTest(tuple(replayed(plan).steps())))


def errors(outcome: Outcome) -> FloatArray:
    """Return alpha, beta, theta less those of the machining centre [urad], step 1 taken off, steps with a pose."""
    steps = [step for step in outcome.test.steps if np.isfinite(step.angles[0])]
    angles = np.array([step.angles for step in steps])
    truth = np.array([step.truth for step in steps])
    measured = np.zeros_like(angles)
    measured[:, 1:] = -np.arctan((truth - truth[0])[:, 1:] / (31.43 * INCH))
    found: FloatArray = (angles - angles[0] - measured) * 1e6
    return found


def deviation(error: FloatArray) -> float:
    """Return the thesis' standard deviation: steps 2 to N over N - 2."""
    return float(np.sqrt(np.sum(error[1:] ** 2) / (len(error) - 2)))


def test_no_step_is_lost_on_the_way(outcome: Outcome) -> None:
    assert outcome.test.numbers == list(range(1, STEPS[outcome.bag] + 1))
    counts = {topic: len(messages) for topic, messages in recorded(outcome.plan.recorded).items()}
    poses = sum(step.has_pose for step in outcome.test.steps)
    assert counts == {
        RAW: STEPS[outcome.bag],
        TRANSFORM: STEPS[outcome.bag],
        TRUTH: STEPS[outcome.bag],
        ENDPOINT: poses,
    }


def test_the_comparison_of_the_demo_holds(outcome: Outcome) -> None:
    name = PRINTED_FILES.get(outcome.bag)
    comparison = compare(outcome.test, *outcome.case, read_printed(data_path(name)) if name else None)
    assert [item for item in comparison.findings if item.verdict is Verdict.FAILS] == []
    assert comparison.holds


def test_the_figures_of_the_thesis_come_out(outcome: Outcome) -> None:
    error = errors(outcome)
    if outcome.bag == "zmo":
        assert deviation(error[:, THETA]) == pytest.approx(65.0, abs=2.0)
    if outcome.case == ("ymo", "section84"):
        assert deviation(error[:, BETA]) == pytest.approx(4.3, abs=0.3)
        assert error[-1, ALPHA] == pytest.approx(-23.0, abs=2.0)
    if outcome.case == ("yzmo", "section84"):
        assert deviation(error[:, BETA]) == pytest.approx(7.5, abs=0.3)
        assert deviation(error[:, ALPHA]) == pytest.approx(2.7, abs=0.3)
    if outcome.bag == "yzmo":
        assert deviation(error[:, THETA]) < 92.0
    if outcome.case == ("ymo", "printed"):
        printed = read_printed(data_path(PRINTED_FILES["ymo"])).posor * 1e6
        difference = np.abs(outcome.test.posor * 1e6 - printed)
        assert difference[:, ALPHA].max() <= 1.0
        assert difference[:, BETA].max() <= 1.0
        assert difference[outcome.test.measured_throughout("theta"), THETA].max() <= 6.0


def test_estimated_steps_are_marked_and_step_14_of_yzmo_is_refused(outcome: Outcome) -> None:
    flags = {step.number: step.scan_status for step in outcome.test.steps if step.scan_status}
    assert flags == ESTIMATED[outcome.bag]
    refused = {step.number: (step.state, step.faults) for step in outcome.test.steps if not step.has_pose}
    assert refused == ({14: (State.LOST, Fault.OUT_OF_RANGE)} if outcome.bag == "yzmo" else {})


def test_the_nodes_publish_what_the_core_computes(outcome: Outcome) -> None:
    messages = recorded(outcome.plan.recorded)
    transforms = located(outcome.plan, messages[RAW])
    assert [bits(transform) for transform in transforms] == all_bits(JointTransform, messages[TRANSFORM])
    published = [deserialize_message(data, PoseStamped).pose for data in messages[ENDPOINT]]
    assert [bits(pose) for pose in published] == [bits(pose) for pose in placed(outcome.plan, transforms)]


@pytest.mark.parametrize("outcome", [("yzmo", "printed")], indirect=True, ids="-".join)
def test_a_recorded_bag_replays_to_the_same_bits_at_another_rate(outcome: Outcome, tmp_path: Path) -> None:
    first = outcome.plan
    second = replace(rig(tmp_path / "second", "yzmo", "printed", rate=10.0), bag=first.recorded)
    replayed(second)
    before, after = recorded(first.recorded), recorded(second.recorded)
    assert set(before) == set(after) == set(TOPICS)
    assert before[RAW] == after[RAW]
    assert before[TRUTH] == after[TRUTH]
    assert all_bits(JointTransform, before[TRANSFORM]) == all_bits(JointTransform, after[TRANSFORM])
    assert all_bits(PoseStamped, before[ENDPOINT]) == all_bits(PoseStamped, after[ENDPOINT])
    assert len(before[TRANSFORM]) == STEPS["yzmo"]
    assert len(before[ENDPOINT]) == STEPS["yzmo"] - 1
