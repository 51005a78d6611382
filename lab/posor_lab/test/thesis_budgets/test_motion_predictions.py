# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Predictions of section 8.4: the printed figures, and that they follow from budgets and travels."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from posor.errors import DataFileError
from posor_lab.thesis_budgets import motion_predictions
from posor_lab.thesis_budgets.chapter5 import Slopes
from posor_lab.thesis_budgets.motion_predictions import (
    increasing_errors,
    machining_centre_alpha,
    random_alpha,
    sensor_travel,
    spots_at,
    straightness_error,
    twist_stage_alpha,
)
from posor_lab.thesis_data import URAD, data_path


@pytest.fixture
def changed_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str, str, str], None]]:
    def change(name: str, old: str, new: str) -> None:
        text = data_path(name).read_text(encoding="utf-8")
        assert old in text
        changed = tmp_path / name
        changed.write_text(text.replace(old, new), encoding="utf-8")
        monkeypatch.setattr(
            motion_predictions, "data_path", lambda wanted: changed if wanted == name else data_path(wanted)
        )
        motion_predictions._sensor_cells.cache_clear()

    yield change
    motion_predictions._sensor_cells.cache_clear()


def test_stage_straightness_is_in_proportion_to_travel_and_straightness() -> None:
    assert straightness_error() / URAD == pytest.approx(188.56, abs=0.01)  # root 2 times .0004 / 3 in
    assert straightness_error(0.009) / URAD == pytest.approx(67.9, abs=0.05)
    assert straightness_error(0.05) == pytest.approx(2.0 * straightness_error())
    assert straightness_error(straightness=0.0008) == pytest.approx(2.0 * straightness_error())


def test_errors_of_the_test_setup() -> None:
    assert machining_centre_alpha() / URAD == pytest.approx(80.81, abs=0.01)
    assert twist_stage_alpha() / URAD == pytest.approx(16.67, abs=0.01)
    assert random_alpha() / URAD == pytest.approx(83.2, abs=0.1)


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_increasing_errors_are_equations_5_21_to_5_25(scale: float) -> None:
    across, along = 0.0168 * scale, 0.0026 * scale
    predicted = increasing_errors(Slopes(across=across, along=along))
    a, b, c = 0.013561, 0.017283, 0.007313
    assert predicted.alpha == pytest.approx(across / 9.0 * (a**2 + b**2) ** 0.5, rel=1e-3)
    beta = ((across * 0.5 / 9.0) ** 2 * (a**2 + b**2) + (along / 9.0 * c) ** 2) ** 0.5
    assert predicted.beta == pytest.approx(beta, rel=1e-3)
    assert predicted.y == pytest.approx(33.4 * beta, rel=1e-3)


def test_increasing_errors_follow_the_budget(changed_table: Callable[[str, str, str], None]) -> None:
    slopes = sensor_travel("TWIS").slopes
    before = increasing_errors(slopes)
    changed_table("error_budget_table_7_12_probes.csv", "increasing,sigma_b,0.017283", "increasing,sigma_b,0.034566")
    assert increasing_errors(slopes).alpha > 1.5 * before.alpha


def test_travels_are_those_of_table_8_1(changed_table: Callable[[str, str, str], None]) -> None:
    gen = sensor_travel("GEN")
    assert gen.spots_x == pytest.approx((-0.0055, 0.0230))
    assert gen.mean_x == pytest.approx(0.01425)
    assert gen.mean_distance == pytest.approx(0.05199, abs=1e-5)
    assert (gen.slopes.across, gen.slopes.along) == pytest.approx((-0.0026, 0.0011))
    assert spots_at("GEN", "finish") == (0.4502, 0.2867, 0.4322, 0.2929)
    changed_table(
        "sensor_ranges.csv", "xd2_finish_in,0.4017,0.3852,0.3956,0.3891,0.4322", "xd2_finish_in,1,1,1,1,0.4092"
    )
    assert sensor_travel("GEN").mean_x == pytest.approx(0.00275)


def test_an_invalid_cell_is_refused(changed_table: Callable[[str, str, str], None]) -> None:
    changed_table("sensor_ranges.csv", "probe1_range_in,0.0021", "probe1_range_in,far")
    with pytest.raises(DataFileError, match="probe1_range_in, column 'ZMO': 'far' is not a number"):
        sensor_travel("ZMO")
