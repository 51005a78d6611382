# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from posor.errors import PosorError
from posor.numerics.stamps import NS
from posor_drivers.simulator.scenario import StageSettings
from posor_drivers.simulator.stage import Stage

SETTINGS = StageSettings.model_validate(
    {
        "stroke": {"value": 5e-4, "unit": "m"},
        "speed": {"value": 1e-3, "unit": "m/s"},
        "resolution": {"value": 1e-7, "unit": "m"},
        "command_age": {"value": 0.5, "unit": "s"},
    }
)
NOW = 1000 * NS


def stage() -> Stage:
    new = Stage(SETTINGS, "endpoint")
    assert np.array_equal(new.position_at(NOW), np.zeros(3))
    return new


def test_stage_moves_straight_to_its_goal_at_its_speed() -> None:
    moving = stage()
    moving.add_command(np.array([3e-4, -4e-4, 0.0]), "endpoint", NOW, NOW)
    assert np.allclose(moving.position_at(NOW + NS // 10), [6e-5, -8e-5, 0.0], rtol=0.0, atol=1e-12)
    assert np.allclose(moving.position_at(NOW + NS), [3e-4, -4e-4, 0.0], rtol=0.0, atol=1e-12)


def test_stage_stands_at_its_steps() -> None:
    moving = stage()
    moving.add_command(np.array([1.26e-7, -1.4e-7, 2.6e-7]), "endpoint", NOW, NOW)
    assert np.allclose(moving.position_at(NOW + NS), [1e-7, -1e-7, 3e-7], rtol=0.0, atol=1e-15)


def test_command_takes_effect_at_its_arrival() -> None:
    early, late = stage(), stage()
    for moving in (early, late):
        moving.add_command(np.array([1e-4, 0.0, 0.0]), "endpoint", NOW, NOW + NS // 100)
    before = early.position_at(NOW + NS // 200)
    assert np.array_equal(before, np.zeros(3))
    assert np.array_equal(early.position_at(NOW + NS // 20), late.position_at(NOW + NS // 20))
    assert np.allclose(late.position_at(NOW + NS // 20), [4e-5, 0.0, 0.0], rtol=0.0, atol=1e-12)


def test_new_goal_replaces_the_old_one_on_the_way() -> None:
    moving = stage()
    moving.add_command(np.array([4e-4, 0.0, 0.0]), "endpoint", NOW, NOW)
    moving.add_command(np.zeros(3), "endpoint", NOW + 1, NOW + NS // 10)
    assert np.allclose(moving.position_at(NOW + NS // 10), [1e-4, 0.0, 0.0], rtol=0.0, atol=1e-12)
    assert np.allclose(moving.position_at(NOW + 3 * NS // 20), [5e-5, 0.0, 0.0], rtol=0.0, atol=1e-12)


HERE = [0.0, 0.0, 0.0]
ORDER, IN_TIME = "commands in the order of their stamps", "a stamp within 0.5 s"


@pytest.mark.parametrize(
    ("goal", "frame", "stamp", "what", "expected"),
    [
        ([5.1e-4, 0.0, 0.0], "endpoint", NOW, "is (0.00051, 0, 0) m", "at most 0.0005 m to either side, the stroke"),
        ([0.0, np.nan, 0.0], "endpoint", NOW, "is (0, nan, 0) m", "finite numbers"),
        (HERE, "base", NOW, "is in frame 'base'", "'endpoint'"),
        (HERE, "endpoint", NOW - NS, "arrived at 1000.000000 s, 1 s after its stamp", IN_TIME),
        (HERE, "endpoint", NOW + NS, "arrived at 1000.000000 s, -1 s after its stamp", IN_TIME),
        (HERE, "endpoint", NOW - NS // 4, "arrived after the command of 999.900000 s", ORDER),
    ],
)
def test_invalid_command_is_refused_and_changes_nothing(
    goal: list[float], frame: str, stamp: int, what: str, expected: str
) -> None:
    moving = stage()
    moving.add_command(np.array([1e-4, 0.0, 0.0]), "endpoint", NOW - NS // 10, NOW)
    with pytest.raises(PosorError) as refused:
        moving.add_command(np.array(goal), frame, stamp, NOW)
    assert (refused.value.what, refused.value.expected) == (what, expected)
    assert refused.value.where == f"stage command of {stamp / NS:.6f} s"
    assert np.allclose(moving.position_at(NOW + NS), [1e-4, 0.0, 0.0], rtol=0.0, atol=1e-12)


def test_stage_keeps_its_position_when_time_goes_back() -> None:
    moving = stage()
    moving.add_command(np.array([4e-4, 0.0, 0.0]), "endpoint", NOW, NOW)
    there = moving.position_at(NOW + NS // 10)
    moving.restart()
    assert np.array_equal(moving.position_at(NOW - 500 * NS), there)
    assert np.array_equal(moving.position_at(NOW - 450 * NS), there)
    moving.add_command(np.zeros(3), "endpoint", NOW - 400 * NS, NOW - 400 * NS)
    assert np.array_equal(moving.position_at(NOW - 300 * NS), np.zeros(3))
