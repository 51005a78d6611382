# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The model of chapter 5 against numerical derivatives of the closed forms of the thesis."""

from __future__ import annotations

import math

import numpy as np
import pytest
from posor.numerics.array_types import FloatArray
from posor.uncertainty.budget_poses import scan_at
from posor.uncertainty.budget_quantities import PlatePoint
from posor_design.monte_carlo import BATCH, monte_carlo
from posor_lab.thesis_budgets.budget_tables import budget_tables, rig_theta
from posor_lab.thesis_budgets.chapter5 import (
    LEG_X,
    LEG_Y,
    PROBE_RANGE,
    PROBES,
    Chapter5,
    Slopes,
    gaps_effect,
    leans_effect,
    lever_effect,
    root_sum_square,
)
from scipy.constants import inch

STEP = 1e-6
WORST = Slopes(PROBE_RANGE, PROBE_RANGE)
GAPS = np.array([PROBE_RANGE + WORST.along, PROBE_RANGE - WORST.across / 2.0, PROBE_RANGE + WORST.across / 2.0])
LEVERS = np.array([1.5, 1.5, 3.0])


def thesis(gaps: FloatArray, levers: FloatArray) -> dict[str, float]:
    """Equations of section 5.3.1: inclinations [rad] and distances [inch] of gaps and a, b, c [inch]."""
    a, b, c = levers
    alpha = math.atan((gaps[1] - gaps[2]) / (a + b))
    beta = math.atan((gaps[0] - (b * gaps[1] + a * gaps[2]) / (a + b)) / c)
    slopes = math.tan(alpha), math.tan(beta)

    def distance(x: float, y: float) -> float:
        return float(gaps[2] + (b + y) * slopes[0] - x * slopes[1])

    return {"alpha": alpha, "beta": beta, "l_0_0": distance(0.0, 0.0), "l_m1_1p5": distance(-1.0, 1.5)}


def test_the_plate_is_inclined_by_the_range_of_the_probes() -> None:
    np.testing.assert_allclose(Chapter5(WORST).gaps, GAPS, atol=1e-5)
    np.testing.assert_allclose(Chapter5(Slopes()).gaps, PROBE_RANGE, rtol=1e-12)


@pytest.mark.parametrize("output", ["l_0_0", "l_m1_1p5", "alpha", "beta"])
def test_factors_of_the_probes_are_the_derivatives_of_the_closed_forms(output: str) -> None:
    def derivative(gaps_step: FloatArray, levers_step: FloatArray) -> float:
        above, below = (thesis(GAPS + s * gaps_step, LEVERS + s * levers_step)[output] for s in (STEP, -STEP))
        return (above - below) / (2.0 * STEP)

    expected = root_sum_square(*(derivative(step, np.zeros(3)) for step in np.eye(3)))
    assert gaps_effect(output) == pytest.approx(expected, rel=1e-3)
    for row, step in zip(("sigma_a", "sigma_b", "sigma_c"), np.eye(3), strict=True):
        by_lever = abs(derivative(np.zeros(3), step))
        assert abs(lever_effect(output, row)) == pytest.approx(by_lever, rel=2e-3, abs=5e-6), row
    # A probe axis that leans by e measures 1 / cos e of the gap.
    for axis in "xy":
        assert leans_effect(output, axis) == pytest.approx(expected * PROBE_RANGE / 2.0, rel=1e-3)


def test_signs_at_the_origin_are_the_printed_ones() -> None:
    assert lever_effect("l_0_0", "sigma_a") > 0.0 > lever_effect("l_0_0", "sigma_b")


def test_factors_of_the_spots_are_the_derivatives_of_the_angle_between_them() -> None:
    for leg_y in (0.0, LEG_Y):
        model = Chapter5(Slopes(), leg_y=leg_y)
        turn = [
            (math.atan2(leg_y + dy, LEG_X + dx) - math.atan2(leg_y - dy, LEG_X - dx)) / (2.0 * STEP)
            for dx, dy in ((STEP, 0.0), (0.0, STEP))
        ]
        assert model.reading_sensitivity("theta", "spot x diode_1") == pytest.approx(turn[0], abs=1e-9)
        assert model.reading_sensitivity("theta", "spot y diode_1") == pytest.approx(turn[1], abs=1e-9)


def test_squares_of_angles_on_a_diode() -> None:
    model = Chapter5(Slopes())
    u, v = "Diodes.x_axes[1,0]", "Diodes.y_axes[1,0]"
    spots = "spot x diode_2", "spot y diode_2"
    half = 0.25  # half of the spot's .5 in
    for turned, expected in (
        ({u: "x", v: "x"}, (0.0, half)),
        ({u: "y", v: "y"}, (half, 0.0)),
        ({u: "z", v: "z"}, (-half, -half)),
        ({u: "z"}, (half, 0.0)),
        ({v: "z"}, (0.0, half)),
    ):
        found = [model.quadratic_shift(spot, turned) for spot in spots]  # type: ignore[arg-type]
        assert found == pytest.approx(expected, abs=1e-6), turned


@pytest.mark.long
def test_draws_of_the_probes_noise_give_the_first_row() -> None:
    model = Chapter5(WORST)
    points = [PlatePoint(0.0, 0.0), PlatePoint(-inch, 1.5 * inch)]
    drawn = monte_carlo(
        model.posor, scan_at(model.posor, model.pose), model.pose, points, seed=1985, max_draws=2 * BATCH
    )
    noise = 10.0  # microinch, of each gap
    columns = {"alpha": 3, "beta": 4, "l_0_0": 6, "l_m1_1p5": 7}
    for output, column in columns.items():
        unit = 1e-6 * (inch if output.startswith("l_") else 1.0)
        assert drawn.sigmas[column] / unit == pytest.approx(noise * gaps_effect(output), rel=0.025), output


def test_probe_sensitivities_do_not_depend_on_the_spots() -> None:
    levels = [Chapter5(WORST, leg_y=leg_y) for leg_y in (0.0, LEG_Y)]
    for probe in PROBES:
        assert levels[0].reading_sensitivity("beta", probe) == pytest.approx(
            levels[1].reading_sensitivity("beta", probe), rel=1e-5
        )


def test_theta_of_the_real_rig_follows_x() -> None:
    by_x, by_y, total = rig_theta(budget_tables()["7.9"])
    assert by_x == pytest.approx(0.331, abs=5e-4)  # 1 / 3.012 in, less the slant
    assert by_y == pytest.approx(0.013, abs=5e-4)
    assert total == pytest.approx(math.hypot(1572.6 * by_x, 206.9 * by_y), rel=2e-3)
