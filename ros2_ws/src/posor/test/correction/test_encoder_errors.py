# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of encoders with known backlash, eccentricity, slope and windup."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from posor.correction.encoder_errors import describe_lateness, directions, encoder_errors

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

BACKLASH, ECCENTRICITY, SLOPE, WINDUP = 4e-5, 2e-5, 3e-6, 5e-7
PERIOD_S = 5e-3


def even_times(angles: FloatArray) -> FloatArray:
    return np.linspace(0.0, PERIOD_S * (len(angles) - 1), len(angles))


def test_backlash_slope_eccentricity_and_windup_are_found_in_noise() -> None:
    random = np.random.default_rng(3)
    angles = 2.5 * np.sin(np.linspace(0.0, 9.0 * math.pi, 9000))
    efforts = 8.0 * random.normal(size=len(angles))
    side = np.where(np.gradient(angles) > 0.0, 0.5, -0.5)
    readings = angles + 1e-3 + 2.0 * math.pi + BACKLASH * side + ECCENTRICITY * np.cos(angles - 0.7) + SLOPE * angles
    readings += WINDUP * efforts + 1e-6 * random.normal(size=len(angles))
    found = encoder_errors(angles, readings, even_times(angles), efforts)
    assert found.offset == pytest.approx(1e-3, abs=2e-6)  # at the mean angle
    assert found.backlash == pytest.approx(BACKLASH, abs=3e-7)
    assert found.eccentricity == pytest.approx(ECCENTRICITY, abs=3e-7)
    assert found.slope == pytest.approx(SLOPE, abs=3e-7)
    assert found.windup == pytest.approx(WINDUP, rel=0.02)
    assert found.rest == pytest.approx(1e-6, rel=0.1)
    assert len(found.table) == 72
    forward, backward = ({row[1]: row[2] for row in found.table if row[0] == sign} for sign in (1, -1))
    middle = min(forward, key=abs)
    assert forward[middle] - backward[middle] == pytest.approx(BACKLASH, abs=2e-6)


@pytest.mark.parametrize("slope", [5e-3, 5e-2])
def test_a_scale_of_the_encoder_is_no_backlash(slope: float) -> None:
    angles = 0.5 * np.sin(np.linspace(0.0, 5.0 * math.pi, 700))  # unequal angles of both directions within a bin
    side = np.where(np.gradient(angles) > 0.0, 0.5, -0.5)
    found = encoder_errors(angles, angles + BACKLASH * side + slope * angles, even_times(angles))
    assert found.backlash == pytest.approx(BACKLASH, abs=0.05 * BACKLASH)
    assert found.slope == pytest.approx(slope, rel=1e-3)


@pytest.mark.parametrize("lateness", [-2e-3, 0.0, 2e-3])
def test_late_readings_are_no_backlash_where_the_speed_changes(lateness: float) -> None:
    random, times = np.random.default_rng(4), even_times(np.empty(4000))
    side = np.where(np.cos(0.9 * times) > 0.0, 0.5, -0.5)
    angles = 0.8 * np.sin(0.9 * times) + 1e-6 * random.normal(size=len(times))
    readings = 0.8 * np.sin(0.9 * (times - lateness)) + BACKLASH * side
    found = encoder_errors(angles, readings, times)
    assert found.lateness == pytest.approx(lateness, abs=2e-6)
    assert found.backlash == pytest.approx(BACKLASH, abs=0.05 * BACKLASH)
    assert found.rest < 3e-6


def test_a_lateness_within_its_uncertainty_is_neither_taken_off_nor_reported() -> None:
    random, times = np.random.default_rng(6), even_times(np.empty(2000))
    angles = 0.02 * np.sin(0.9 * times)  # slow: a millisecond is 18 µrad
    side = np.where(np.cos(0.9 * times) > 0.0, 0.5, -0.5)
    found = encoder_errors(angles, angles + BACKLASH * side + 1e-5 * random.normal(size=len(times)), times)
    assert found.lateness_sigma > 3e-5
    assert abs(found.lateness) < 4.0 * found.lateness_sigma
    assert not describe_lateness(found._replace(lateness=4.0 * found.lateness_sigma), 0.0)
    assert describe_lateness(found._replace(lateness=0.1), 0.0) == "its readings are 100 ms late"
    assert found.backlash == pytest.approx(BACKLASH, abs=3e-6)


def test_late_readings_at_one_speed_are_not_told_from_backlash() -> None:
    times = even_times(np.empty(4000))
    angles, side = np.abs(np.mod(0.3 * times, 2.0) - 1.0), np.where(np.mod(0.3 * times, 2.0) > 1.0, 0.5, -0.5)
    found = encoder_errors(angles, angles + BACKLASH * side - 2e-3 * 0.6 * side, times)
    assert math.isnan(found.lateness)
    assert found.backlash == pytest.approx(BACKLASH - 2e-3 * 0.6, rel=5e-3)


def test_a_gap_in_the_scans_has_no_rate() -> None:
    times = even_times(np.empty(4000))
    kept = np.mod(times, 2.0) < 1.7  # some without their reversals
    times = times[kept]
    angles, late = 0.8 * np.sin(0.9 * times), 0.8 * np.sin(0.9 * (times - 2e-3))
    found = encoder_errors(angles, late, times)
    assert found.lateness == pytest.approx(2e-3, abs=1e-5)
    assert found.readings < len(times)


def test_what_the_motion_does_not_determine_is_not_stated() -> None:
    angles = np.linspace(0.0, 0.05, 200)
    found = encoder_errors(angles, angles + 1e-4, even_times(angles))
    assert found.offset == pytest.approx(1e-4)
    assert np.isnan([found.backlash, found.slope, found.eccentricity, found.windup, found.lateness]).all()
    still = encoder_errors(np.zeros(50), 1e-6 * np.ones(50), even_times(np.zeros(50)))
    assert (still.readings, still.table) == (0, [])
    assert math.isnan(still.offset)


def test_a_direction_is_known_from_some_way_after_a_reversal() -> None:
    found = directions(np.array([0.0, 0.4, 1.0, 2.0, 1.9, 2.1, 1.5, 1.0, 0.5]), settled=1.0)
    assert found.tolist() == [0, 0, 1, 1, 0, 1, 0, -1, -1]


@pytest.mark.parametrize("others_move", [True, False])
def test_gravity_in_changing_postures_is_no_backlash(*, others_move: bool) -> None:
    random, times = np.random.default_rng(5), np.linspace(0.0, 9.0 * math.pi, 9000)
    angles = (0.5 if others_move else 2.0) * np.sin(times)
    lean = 0.6 * np.cos(times) * others_move  # of the links before, in step with the direction of motion
    before = np.column_stack([np.sin(lean), np.zeros(len(lean)), -np.cos(lean)])
    after = np.column_stack([np.sin(lean - angles), np.zeros(len(lean)), -np.cos(lean - angles)])
    side = np.where(np.gradient(angles) > 0.0, 0.5, -0.5)
    bent = 6e-5 * before[:, 0] + 3e-5 * after[:, 0]
    readings = angles + BACKLASH * side + bent + 1e-6 * random.normal(size=len(angles))
    found = encoder_errors(angles, readings, even_times(angles), gravity=np.hstack([before, after]))
    assert found.backlash == pytest.approx(BACKLASH, abs=3e-7)
    assert found.rest == pytest.approx(1e-6, rel=0.1)
    if others_move:
        assert found.gravity > 2e-5
        without = encoder_errors(angles, readings, even_times(angles))
        assert without.lateness < -1e-4  # in step with the rate
        assert math.isnan(without.gravity)
    else:  # then gravity is a matter of the own angle
        assert math.isnan(found.gravity)
