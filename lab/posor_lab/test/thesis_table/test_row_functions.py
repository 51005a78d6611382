# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Functions that only the files of rows call, against geometry and against other inputs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from posor_lab.arm_study import arm_budget_command
from posor_lab.replay_1985.printed_results import EndOfBeamResults, EndOfBeamTest, read_end_of_beam
from posor_lab.thesis_budgets.budget_tables import BudgetCell
from posor_lab.thesis_table import formulas, motion_values
from posor_lab.thesis_table.thesis_row import Agreement


def test_a_load_that_rises_and_falls_has_no_direction() -> None:
    assert formulas.direction([1.0, 2.0, 3.0]) == 1.0
    assert formulas.direction([3.0, 2.0]) == -1.0
    assert formulas.direction([1.0, 2.0, 1.0]) == 0.0


def test_the_printed_inclinations_follow_from_the_constants_of_the_listings() -> None:
    """The constant of the target plane over the distance of the probes, in inch."""
    about_x, about_z = formulas.target_plane_tilts()
    assert math.tan(math.radians(about_x)) == pytest.approx(0.133333 / 3.0, rel=0.02)
    assert math.tan(math.radians(about_z)) == pytest.approx(0.083333 / 1.5, rel=0.02)


def test_the_half_axis_of_a_sphere_on_a_plane_is_that_of_a_circle() -> None:
    assert formulas.half_axis_coefficient(math.pi / 2.0, 9.8, 2e11) == pytest.approx(1.0, rel=1e-6)


def test_the_humidity_effect_at_the_temperature_found() -> None:
    assert formulas.temperature_of_humidity_effect(0.3, -1e-6) == pytest.approx(46.0, abs=0.5)


def test_the_print_of_the_extended_arm_follows_from_two_terms_along_other_axes() -> None:
    np.testing.assert_allclose(arm_budget_command.extended_as_printed(), [35.6, 171.9, 203.5], rtol=0.0, atol=0.05)


def test_added_errors_act_across_the_beams(monkeypatch: pytest.MonkeyPatch) -> None:
    none = (0.0, 0.0, 0.0)
    np.testing.assert_allclose(arm_budget_command.with_calibration_and_beams(none), [50.0, 53.14, 53.14], atol=0.01)
    monkeypatch.setattr(arm_budget_command, "CALIBRATION_ERROR", 0.0)
    np.testing.assert_allclose(arm_budget_command.with_calibration_and_beams(none), [0.0, 18.0, 18.0])


def test_figures_of_the_legible_tables_follow_the_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    def doubled(test: EndOfBeamTest) -> EndOfBeamResults:
        results = read_end_of_beam(test)
        return EndOfBeamResults(results.measured, results.measured + 2.0 * results.errors)

    before = motion_values.printed_deviation("GEN", "alpha")
    monkeypatch.setattr(motion_values, "read_end_of_beam", doubled)
    assert motion_values.printed_deviation("GEN", "alpha") == pytest.approx(2.0 * before)


@pytest.mark.parametrize(("printed", "place"), [(1.0, "below"), (2.5, "in"), (4.0, "above")])
def test_place_of_a_printed_number(printed: float, place: str) -> None:
    assert motion_values.place_of_print(printed, 2.0, 3.0) == f", the print lies {place} this range"
    assert not motion_values.place_of_print("", 2.0, 3.0)


@pytest.mark.parametrize(
    ("printed", "last_digit", "computed", "rounding", "reason", "gives", "digits", "text"),
    [
        ("76", 1.0, 75.6, 0.0, "", math.nan, "76", ""),
        ("0", 0.0001, 0.003, 0.0, "", math.nan, "0.0000", "no reason is known"),
        ("nan", 1.0, 199.6, 0.0, "", math.nan, "", "not legible in the scan"),
        ("13", 1.0, 12.4, 0.2, "", math.nan, "13", "within the rounding of the cell and of the printed perturbation"),
        ("48", 1.0, 40.0, 0.0, "other factor", 48.2, "48", "other factor: 48.2"),
    ],
)
def test_a_budget_cell_keeps_its_reason(
    printed: str, last_digit: float, computed: float, rounding: float, reason: str, gives: float, digits: str, text: str
) -> None:
    place = "7.9", "group: sigma_X", "induced_sigma_theta_urad"
    cell = BudgetCell(*place, printed, last_digit, computed, rounding, reason, gives)
    assert (cell.agreement is Agreement.EXPLAINED) is bool(reason)
    columns = cell.thesis_columns
    assert (columns["table"], columns["column"], columns["unit"]) == ("7.9", "theta", "urad")
    assert (columns["printed"], columns["computed"], columns["reason"]) == (digits, computed, text)
