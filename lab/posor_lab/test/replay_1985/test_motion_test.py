# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Steps of a motion test and what follows from them, also without nodes: the same figures as those of a replay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from posor.errors import PosorError
from posor.model.fault import Fault, State
from posor.model.scan import DIODES_ESTIMATED, PROBES_ESTIMATED
from posor.numerics.array_types import FloatArray
from posor_calibration.attitude_fit import angles_from_displacements, deviation_from_first
from posor_lab.harness.rig_files import BAGS, CALIBRATIONS, Bag, CalibrationName
from posor_lab.replay_1985.comparison import STEPS, compare_with_thesis
from posor_lab.replay_1985.motion_test import ANGLES, TRUTH_LEVER, MotionTest, offline_motion_test
from posor_lab.replay_1985.printed_results import PrintedColumns
from scipy.constants import inch

ALPHA, BETA, THETA = range(3)
INCH = 0.0254


def test_values_are_relative_to_the_first_step(
    printed_test: Callable[..., MotionTest], printed: PrintedColumns
) -> None:
    test = printed_test()
    np.testing.assert_allclose(test.posor_angles, printed.posor, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(test.truth_angles, printed.truth, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(test.angle_errors, printed.posor - printed.truth, rtol=0.0, atol=1e-15)
    assert np.all(test.endpoint_displacement[0] == 0.0)


def test_machining_centre_angles_are_those_of_the_listings() -> None:
    inches = np.array([[0.0, 0.0, 0.0], [0.005, -0.1357, 0.0004]])  # YMO, steps 1 and 15
    alpha, beta, theta = angles_from_displacements(inches * inch, TRUTH_LEVER)[1] * 1e6
    assert alpha == 0.0
    assert beta == pytest.approx(4318.0, abs=0.6)
    assert theta == pytest.approx(-13.0, abs=0.5)


def test_standard_deviation_leaves_the_reference_out() -> None:
    errors = np.array([0.0, 3.0, 4.0, 12.0])
    assert deviation_from_first(errors) == pytest.approx(13.0 / np.sqrt(2.0))
    assert np.isnan(deviation_from_first(errors[:2]))


def test_standard_deviation_of_the_printed_table_is_the_printed_one(printed: PrintedColumns) -> None:
    deviations = [deviation_from_first(column) * 1e6 for column in (printed.posor - printed.truth).T]
    assert deviations == pytest.approx([51.0, 76.0, 179.0], abs=0.6)


def test_estimated_readings_affect_their_angles_only(printed_test: Callable[..., MotionTest]) -> None:
    test = printed_test(statuses={6: PROBES_ESTIMATED, 13: DIODES_ESTIMATED}, lost=(15,))
    without = {angle: (np.flatnonzero(~test.fully_measured(angle)) + 1).tolist() for angle in ANGLES}
    assert without == {"alpha": [6, 15], "beta": [6, 15], "theta": [13, 15]}


def test_an_estimated_reading_at_step_1_affects_every_step(printed_test: Callable[..., MotionTest]) -> None:
    test = printed_test(statuses={1: DIODES_ESTIMATED})
    assert not test.fully_measured("theta").any()
    assert test.fully_measured("beta").all()


def test_status_is_one_word(printed_test: Callable[..., MotionTest]) -> None:
    step = printed_test().steps[0]
    assert step.status == "ok"
    assert replace(step, scan_status=PROBES_ESTIMATED).status == "ok:probes_estimated"
    both = replace(step, state=State.DEGRADED, faults=Fault.RESIDUAL, scan_status=PROBES_ESTIMATED | DIODES_ESTIMATED)
    assert both.status == "degraded:RESIDUAL+probes_estimated+diodes_estimated"
    lost = replace(step, state=State.LOST, faults=Fault.OUT_OF_RANGE, scan_status=DIODES_ESTIMATED)
    assert lost.status == "lost:OUT_OF_RANGE"


def test_a_first_step_without_pose_is_refused(printed_test: Callable[..., MotionTest]) -> None:
    with pytest.raises(
        PosorError, match=r"step 1 gave no pose \(lost:OUT_OF_RANGE\); expected a pose at the first step"
    ):
        printed_test(lost=(1,))


def test_fewer_than_three_steps_are_refused(printed_test: Callable[..., MotionTest]) -> None:
    with pytest.raises(PosorError, match="2 steps were received; expected at least 3"):
        MotionTest(printed_test().steps[:2])


@pytest.mark.parametrize("bag", BAGS)
@pytest.mark.parametrize("calibration", CALIBRATIONS)
def test_every_expectation_of_the_replay_holds(bag: Bag, calibration: CalibrationName, printed: PrintedColumns) -> None:
    test = offline_motion_test(bag, calibration)
    assert len(test.steps) == STEPS[bag]
    assert compare_with_thesis(test, bag, calibration, printed if bag == "ymo" else None).holds


def angle_errors(test: MotionTest) -> FloatArray:
    """Return alpha, beta, theta less those of the machining centre [urad], relative to step 1, of steps with a pose."""
    steps = [step for step in test.steps if np.isfinite(step.angles[0])]
    angles = np.array([step.angles for step in steps])
    truth = np.array([step.truth for step in steps])
    measured = np.zeros_like(angles)
    measured[:, 1:] = -np.arctan((truth - truth[0])[:, 1:] / (31.43 * INCH))
    return np.asarray((angles - angles[0] - measured) * 1e6)


def standard_deviation(errors: FloatArray) -> float:
    """Return the standard deviation of the thesis: steps 2 to N over N - 2."""
    return float(np.sqrt(np.sum(errors[1:] ** 2) / (len(errors) - 2)))


@pytest.mark.parametrize("bag", BAGS)
@pytest.mark.parametrize("calibration", CALIBRATIONS)
def test_the_figures_of_the_thesis_come_out(bag: Bag, calibration: CalibrationName, printed: PrintedColumns) -> None:
    test = offline_motion_test(bag, calibration)
    error = angle_errors(test)
    if bag == "zmo":
        assert standard_deviation(error[:, THETA]) == pytest.approx(65.0, abs=2.0)
    if (bag, calibration) == ("ymo", "section84"):
        assert standard_deviation(error[:, BETA]) == pytest.approx(4.3, abs=0.3)
        assert error[-1, ALPHA] == pytest.approx(-23.0, abs=2.0)
    if (bag, calibration) == ("yzmo", "section84"):
        assert standard_deviation(error[:, BETA]) == pytest.approx(7.5, abs=0.3)
        assert standard_deviation(error[:, ALPHA]) == pytest.approx(2.7, abs=0.3)
    if bag == "yzmo":
        assert standard_deviation(error[:, THETA]) < 92.0
    if (bag, calibration) == ("ymo", "printed"):
        difference = np.abs(test.posor_angles - printed.posor) * 1e6
        assert difference[:, ALPHA].max() <= 1.0
        assert difference[:, BETA].max() <= 1.0
        assert difference[test.fully_measured("theta"), THETA].max() <= 6.0


def test_the_endpoint_moves_with_the_beam() -> None:
    test = offline_motion_test("ymo", "section84")
    side = test.endpoint_displacement[:, 1]
    # The lever of the endpoint is 33.4 in, that of the machining centre's line 31.43 in.
    np.testing.assert_allclose(side[1:] / test.truth_displacement[1:, 1], 33.4 / 31.43, rtol=0.25)
    assert np.isnan(offline_motion_test("yzmo", "printed").endpoint_displacement[13]).all()
