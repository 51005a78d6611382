"""Air and straightness optics: derivatives of the index, values of NIST, ray geometry, wrong arguments."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from posor.errors import ParameterError
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


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"temperature": 20.0}, r"temperature of moist air: 20 K; expected a value from 273.15 to 373.15 K\."),
        ({"temperature_change": 100.0}, "temperature of moist air: 393.15 K"),
        ({"humidity_change": 30.0}, "relative humidity: 30.5"),
        ({"pressure_change": math.nan}, "pressure: nan Pa"),
        ({"wavelength": 6e-4}, "wavelength: 0.0006 m"),
    ],
)
def test_wrong_air_is_refused(wrong: dict[str, Any], message: str) -> None:
    changes = {"temperature_change": 1.0, "pressure_change": 1.0, "humidity_change": 0.1}
    with pytest.raises(ParameterError, match=message):
        air_effects(**{**changes, **wrong})


@pytest.mark.parametrize(
    ("path_change", "angle", "message"),
    [
        (1e-6, 0.0, "angle: 0 is not positive"),
        (1e-6, 1.6, r"angle: 1.6 rad; expected less than a right angle\."),
        (math.nan, 0.02, "path_change: nan is not finite"),
    ],
)
def test_wrong_optics_are_refused(path_change: float, angle: float, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        straightness_optics(path_change, angle)
