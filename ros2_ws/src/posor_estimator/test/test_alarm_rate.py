# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""When scans without a pose are a fault."""

from __future__ import annotations

import numpy as np
import pytest
from posor_estimator.alarm_rate import SIGNIFICANCE, WINDOW, AlarmRate, alarm_limit
from scipy.stats import binom


@pytest.mark.parametrize("probability", [1e-4, 1e-3, 6e-3, 0.1])
def test_the_limit_is_the_first_that_sound_scans_reach_too_rarely(probability: float) -> None:
    limit = alarm_limit(probability)
    assert binom.sf(limit - 1, WINDOW, probability) <= SIGNIFICANCE
    assert binom.sf(limit - 2, WINDOW, probability) > SIGNIFICANCE


def test_scans_in_a_row_are_a_fault() -> None:
    alarms = AlarmRate(1e-3, 3)
    assert [alarms.add(scan) for scan in (10, 11, 13, 14, 15, 16)] == [False, False, False, False, True, True]


def test_sound_scans_are_no_fault_and_a_higher_rate_is_one() -> None:
    random = np.random.default_rng(16)
    probability = 6e-3
    sound = AlarmRate(probability, 5)
    scans = np.flatnonzero(random.random(300_000) < probability)
    assert len(scans) > 1000
    assert not any(sound.add(int(scan)) for scan in scans)
    faulty = AlarmRate(probability, 5)
    seen = [scan for scan in np.flatnonzero(random.random(5000) < 0.1) if faulty.add(int(scan))]
    assert seen[0] < WINDOW
    assert faulty.excess(int(seen[-1])).startswith(f"{alarm_limit(probability)} of the last {WINDOW} scans")
    assert not faulty.excess(int(seen[-1]) + WINDOW)


def test_scans_that_something_else_explains_are_forgotten() -> None:
    alarms = AlarmRate(1e-3, 5)
    limit = alarm_limit(1e-3)
    assert not any(alarms.add(scan) for scan in range(0, 2 * limit - 2, 2))
    alarms.forget()
    assert not alarms.add(2 * limit)
    assert [alarms.add(scan) for scan in range(2 * limit + 2, 4 * limit, 2)][-1]


def test_a_lasting_fault_does_not_count_for_the_rate_afterwards() -> None:
    alarms = AlarmRate(1e-3, 5)
    assert [alarms.add(scan) for scan in range(100)] == [False] * 4 + [True] * 96
    assert not alarms.excess(100)
    assert not alarms.add(102)
