# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Aerostatic bearing against published cases and an independent solution of Reynolds' equation; limits."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from posor_design.air_bearing import CRITICAL_HEAD, CRITICAL_RATIO, aerostatic_bearing, nozzle_function
from scipy import sparse
from scipy.sparse.linalg import spsolve

FloatArray = NDArray[np.float64]
Method = Literal["nozzle", "thesis", "incompressible"]

AMBIENT = 101325.0
DENSITY = 1.183
THESIS: dict[str, Any] = {
    "diameter": 0.0508,
    "length": 0.0508,
    "clearance": 50.8e-6,
    "orifice_radius": 0.762e-3,
    "orifices": 8,
    "supply_pressure": 551584.0,
    "ambient_pressure": AMBIENT,
}
WATER: dict[str, Any] = {"viscosity": 1e-3, "density": 1000.0}


def ring_flow(bearing: dict[str, Any], pressure: FloatArray, method: Method, orifices: float) -> FloatArray:
    """Mass flow of a number of orifices: Bernoulli for liquid, Saint-Venant and Wantzel for gas."""
    area = orifices * 0.6 * math.pi * bearing["orifice_radius"] ** 2
    supply = bearing["supply_pressure"]
    if method == "incompressible":
        liquid: FloatArray = area * np.sqrt(2.0 * WATER["density"] * (supply - pressure))
        return liquid
    ratio = np.maximum(pressure / supply, (2.0 / 2.4) ** 3.5)
    speed = np.sqrt(2.0 * 1.4 / 0.4 * (ratio ** (2.0 / 1.4) - ratio ** (2.4 / 1.4)))
    gas: FloatArray = area * supply * math.sqrt(DENSITY / AMBIENT) * speed
    return gas


def film_matrix(conductance: FloatArray, dx: float, dz: float, along: int) -> tuple[sparse.csr_array, FloatArray]:
    """Matrix of the flow into each node of half of the bearing, and of the flow from its end at unit pressure.

    Nodes: angle (periodic) by place along the axis, from the ring (a node of half width) to the end.
    """
    around = len(conductance)
    # Row i: flow from node i + 1 to node i.
    difference = np.roll(np.eye(around), 1, axis=1) - np.eye(around)
    forward = 0.5 * (conductance + np.roll(conductance, -1))[:, None] * difference
    circumferential = forward - np.roll(forward, 1, axis=0)
    widths = np.full(along, dz / dx)
    widths[0] *= 0.5
    axial = np.eye(along, k=1) + np.eye(along, k=-1) - 2.0 * np.eye(along)
    axial[0, 0] = -1.0
    axial_conductance = conductance * dx / dz
    matrix = sparse.kron(circumferential, np.diag(widths)) + sparse.kron(np.diag(axial_conductance), axial)
    return sparse.csr_array(matrix), np.kron(axial_conductance, np.eye(along)[-1])


def reynolds_load(bearing: dict[str, Any], method: Method, eccentricity_ratio: float) -> float:
    """Load by finite volumes and Newton's method: Reynolds' equation with a line of orifices in the middle.

    The unknowns are the pressure (incompressible) or its square (compressible) on half of the bearing.
    """
    power = 1 if method == "incompressible" else 2
    viscosity, density = (1e-3, 1e3) if power == 1 else (1.853e-5, 0.5 * DENSITY / AMBIENT)
    around, along = 64, 80
    dx, dz = math.pi * bearing["diameter"] / around, 0.5 * bearing["length"] / along
    angle = (np.arange(around) + 0.5) * 2.0 * math.pi / around
    film = bearing["clearance"] * (1.0 - eccentricity_ratio * np.cos(angle))
    matrix, end = film_matrix(density * film**3 / (12.0 * viscosity), dx, dz, along)
    ring = np.arange(around) * along
    outside, supply = AMBIENT**power, bearing["supply_pressure"] ** power

    def inflow(state: FloatArray) -> FloatArray:
        """Flow of the orifices to this half of the bearing."""
        return 0.5 * ring_flow(bearing, state ** (1.0 / power), method, bearing["orifices"] / around)

    state = np.tile(outside + 0.5 * (supply - outside) * np.linspace(1.0, 0.0, along, endpoint=False), around)
    for _ in range(50):
        flow = inflow(state[ring])
        slope = np.zeros(around * along)
        slope[ring] = (inflow(state[ring] - 1e-7 * supply) - flow) / (-1e-7 * supply)
        residual = matrix @ state + end * outside
        residual[ring] += flow
        change = spsolve(sparse.csc_array(matrix + sparse.diags(slope)), -residual)
        state += change
        # Newton's method may overshoot the supply, where no flow is defined.
        state[ring] = np.minimum(state[ring], supply * (1.0 - 1e-9))
        if np.abs(change).max() < 1e-10 * supply:
            break
    else:
        pytest.fail("Newton's method does not converge")
    pressure = (state ** (1.0 / power)).reshape(around, along)
    pressure[:, 0] *= 0.5
    return float(2.0 * np.sum(pressure * np.cos(angle)[:, None]) * dx * dz)


@pytest.mark.parametrize(
    ("method", "clearance", "length"),
    [
        ("nozzle", 50.8e-6, 0.0508),
        ("nozzle", 101.6e-6, 0.0508),
        ("nozzle", 50.8e-6, 0.1016),
        ("incompressible", 101.6e-6, 0.0508),
    ],
)
def test_the_load_is_that_of_reynolds_equation(method: Method, clearance: float, length: float) -> None:
    bearing = {**THESIS, "clearance": clearance, "length": length}
    fluid = WATER if method == "incompressible" else {}
    load = aerostatic_bearing(**bearing, **fluid, method=method, eccentricity_ratio=0.02).load
    assert load == pytest.approx(reynolds_load(bearing, method, 0.02), rel=5e-3)


@pytest.mark.parametrize(("eccentricity_ratio", "excess"), [(0.1, 0.01), (0.2, 0.04), (0.5, 0.25)])
def test_the_linear_load_exceeds_the_nonlinear_one_as_documented(eccentricity_ratio: float, excess: float) -> None:
    bearing = aerostatic_bearing(**THESIS, eccentricity_ratio=eccentricity_ratio)
    nonlinear = reynolds_load(THESIS, "nozzle", eccentricity_ratio)
    assert bearing.load / nonlinear - 1.0 == pytest.approx(excess, abs=5e-3)


@pytest.mark.parametrize("orifice_radius", [0.1e-3, 0.4e-3, 1.0e-3, 3e-3])
def test_a_short_liquid_bearing_has_the_published_stiffness(orifice_radius: float) -> None:
    """Rowe, Hydrostatic, Aerostatic and Hybrid Bearing Design (2012), 3.4: with orifices, the stiffness of a pad over
    load and film is 6 b (1 - b) / (2 - b), b the ratio of the feed pressure to the supply pressure (gauge); the
    pressure of a short bearing falls linearly to its ends, and the cosine of the film halves the sum."""
    bearing = {**THESIS, "length": 1e-4, "orifice_radius": orifice_radius, "clearance": 20e-6, "orifices": 12}
    result = aerostatic_bearing(**bearing, **WATER, method="incompressible", eccentricity_ratio=0.1)
    supply = bearing["supply_pressure"] - AMBIENT
    b = (result.feed_pressure - AMBIENT) / supply
    assert 0.0 < b < 1.0
    factor = 6.0 * b * (1.0 - b) / (2.0 - b)
    area = math.pi * bearing["diameter"] * 0.5 * bearing["length"] * 0.5
    assert result.load == pytest.approx(0.1 * factor * supply * area, rel=1e-4)


def test_the_best_ratio_of_a_short_liquid_bearing_is_the_published_one() -> None:
    """Rowe (2012), 3.4: orifices give the greatest stiffness at a ratio of the pressures of 2 - sqrt(2) = .586."""
    radii = np.geomspace(1e-4, 1e-2, 2000)
    results = [
        aerostatic_bearing(
            **{**THESIS, "length": 1e-4, "orifice_radius": radius, "clearance": 20e-6}, **WATER, method="incompressible"
        )
        for radius in radii
    ]
    best = max(results, key=lambda result: result.stiffness)
    ratio = (best.feed_pressure - AMBIENT) / (THESIS["supply_pressure"] - AMBIENT)
    assert ratio == pytest.approx(2.0 - math.sqrt(2.0), abs=2e-3)


def test_choked_orifices_have_the_published_flow() -> None:
    """ISO 9300: the critical flow function of an ideal diatomic gas is .6847, at a ratio of the pressures of .5283."""
    assert pytest.approx(0.6847, abs=5e-5) == nozzle_function(CRITICAL_HEAD)
    assert pytest.approx(0.5283, abs=5e-5) == CRITICAL_RATIO
    bearing = aerostatic_bearing(**{**THESIS, "clearance": 101.6e-6})
    assert bearing.orifice_flow == "choked"
    area = 8 * 0.6 * math.pi * 0.762e-3**2
    gas_constant_temperature = AMBIENT / DENSITY
    assert bearing.mass_flow == pytest.approx(0.68473 * area * 551584.0 / math.sqrt(gas_constant_temperature), rel=1e-5)


def test_wide_orifices_leave_the_flow_to_the_film() -> None:
    """Powell, Design of Aerostatic Bearings (1970): isothermal flow of a slot, w h^3 (p1^2 - p2^2) / (24 mu l R T)."""
    bearing = aerostatic_bearing(**{**THESIS, "orifice_radius": 20e-3})
    width, length = 2.0 * math.pi * 0.0508, 0.0254
    slot = width * 50.8e-6**3 * (551584.0**2 - AMBIENT**2) / (24.0 * 1.853e-5 * length * AMBIENT / DENSITY)
    assert bearing.mass_flow == pytest.approx(slot, rel=1e-4)
    assert bearing.feed_pressure == pytest.approx(551584.0, rel=1e-4)
    assert bearing.load < 0.01 * aerostatic_bearing(**THESIS).load


def test_a_gas_at_small_pressure_difference_behaves_as_a_liquid() -> None:
    bearing = {**THESIS, "supply_pressure": AMBIENT * 1.0001, "clearance": 20e-6}
    gas = aerostatic_bearing(**bearing)
    liquid = aerostatic_bearing(**bearing, method="incompressible")
    assert gas.load == pytest.approx(liquid.load, rel=1e-3)
    assert gas.mass_flow == pytest.approx(liquid.mass_flow, rel=1e-3)


@pytest.mark.parametrize("method", ["nozzle", "thesis", "incompressible"])
def test_the_load_is_linear_in_the_eccentricity(method: Method) -> None:
    small, large = (aerostatic_bearing(**THESIS, eccentricity_ratio=ratio, method=method) for ratio in (0.1, 0.4))
    assert large.load == pytest.approx(4.0 * small.load, rel=1e-12)
    assert large.stiffness == pytest.approx(large.load / (0.4 * 50.8e-6), rel=1e-12)
    assert aerostatic_bearing(**THESIS, eccentricity_ratio=0.0, method=method).load == 0.0


@pytest.mark.parametrize("method", ["nozzle", "thesis", "incompressible"])
@pytest.mark.parametrize("changed", [{"length": 50.0}, {"clearance": 1e-9}, {"clearance": 5e-3}, {"length": 1e-6}])
def test_extreme_bearings_have_finite_results(method: Method, changed: dict[str, float]) -> None:
    result = aerostatic_bearing(**{**THESIS, **changed}, method=method)
    assert 0.0 <= result.load < math.inf
    assert AMBIENT <= result.feed_pressure <= 551584.0
    assert 0.0 < result.mass_flow < math.inf
