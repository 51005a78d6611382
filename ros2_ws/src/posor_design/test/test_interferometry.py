# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Air and straightness optics: derivatives of the index, values of NIST, ray geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest
from posor.uncertainty.air_index import Air, index_sensitivities
from posor_design.interferometry import air_effects, straightness_optics


def test_small_changes_act_by_the_derivatives_of_the_index() -> None:
    found = air_effects(0.01, 10.0, 0.001)
    derivatives = index_sensitivities(632.99e-9, Air(293.15, 101325.0, 0.5))
    assert found.temperature_effect == pytest.approx(0.01 * derivatives.temperature, rel=1e-3)
    assert found.pressure_effect == pytest.approx(10.0 * derivatives.pressure, rel=1e-3)
    assert found.humidity_effect == pytest.approx(0.001 * derivatives.relative_humidity, rel=1e-3)
    parts = found.temperature_effect + found.pressure_effect + found.humidity_effect
    assert found.total == pytest.approx(parts, rel=1e-3)


def test_temperature_and_pressure_act_by_the_density_of_an_ideal_gas() -> None:
    found = air_effects(1.0, 338.6, 0.0)
    assert found.temperature_effect == pytest.approx(-(found.index - 1.0) / 293.15, rel=0.05)
    assert found.pressure_effect == pytest.approx((found.index - 1.0) * 338.6 / 101325.0, rel=0.01)


def test_humidity_acts_as_in_the_equation_of_edlen() -> None:
    """Birch and Downs, Metrologia 31, 315-316, 1994: 3.634e-10 for each pascal of water vapour, 2339 Pa saturated."""
    assert air_effects(0.0, 0.0, 0.8, relative_humidity=0.1).humidity_effect == pytest.approx(
        -3.634e-10 * 0.8 * 2339.0, rel=0.02
    )


def test_straightness_optics_are_the_geometry_of_two_rays() -> None:
    """A mirror square to its ray moves across the axis: the ray grows by the part of the motion along it."""
    half, motion = math.radians(0.8), np.array([0.0, 1e-4])
    rays = np.array([[math.cos(half), math.sin(half)], [math.cos(half), -math.sin(half)]])
    paths = rays @ motion
    found = straightness_optics(float(paths[0] - paths[1]), 2.0 * half)
    assert found.displacement == pytest.approx(1e-4)
    assert found.magnification == pytest.approx((paths[0] - paths[1]) / 1e-4)
