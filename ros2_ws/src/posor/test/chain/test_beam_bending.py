# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The sag of the measuring beam of thesis 6.2.2 and of a cantilever, against formulas derived here by other means."""

from __future__ import annotations

import math

import numpy as np
import pytest
from posor.chain.beam_bending import PointForce, Tube, cantilever, on_gimbals
from scipy.integrate import quad, solve_bvp

INCH = 0.0254
TUBE = Tube(2.0 * INCH, 1.75 * INCH, modulus=69e9, density=2700.0)


def test_different_overhangs_and_masses_agree_with_the_moment_integrated_twice() -> None:
    """No symmetry to lean on: the moment from equilibrium, integrated numerically, the chord through the gimbals."""
    near, far, length, stiffness, load = 0.07, 0.41, 0.6, 900.0, 13.0
    forces = [PointForce(0.0, 4.0), PointForce(0.2, -3.0), PointForce(0.6, 9.0)]
    bent = on_gimbals(length, stiffness, load, forces, (near, far))
    loads = [*((each.at, each.force) for each in forces), (length / 2.0, load * length)]
    at_far = sum(force * (at - near) for at, force in loads) / (far - near)
    at_near = sum(force for _, force in loads) - at_far
    points = [near, 0.2, far]

    def curvature(x: float) -> float:
        moment = load * x**2 / 2.0
        moment += sum(each.force * max(x - each.at, 0.0) for each in forces)
        moment -= at_near * max(x - near, 0.0) + at_far * max(x - far, 0.0)
        return moment / stiffness

    def bend(x: float) -> float:
        inner = [point for point in points if point < x]
        return quad(lambda s: (x - s) * curvature(s), 0.0, x, points=inner or None, epsabs=1e-15)[0] if x else 0.0

    slope = (bend(far) - bend(near)) / (far - near)
    for x in (0.0, 0.15, 0.33, 0.6):
        assert bent.deflection(x) == pytest.approx(bend(x) - bend(near) - slope * (x - near), abs=1e-12)
        turned = quad(curvature, 0.0, x, points=[point for point in points if point < x] or None)[0] if x else 0.0
        assert bent.slope(x) == pytest.approx(turned - slope, abs=1e-11)


def test_a_cantilever_solves_its_differential_equation() -> None:
    length, stiffness, load, force, moment = 0.5, 800.0, 30.0, -9.0, 2.0
    bent = cantilever(length, stiffness, load, force, moment)

    def derivatives(_x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.vstack([y[1], y[2] / stiffness, y[3], np.full_like(y[0], load)])

    def ends(start: np.ndarray, end: np.ndarray) -> np.ndarray:
        return np.array([start[0], start[1], end[2] - moment, end[3] + force])

    x = np.linspace(0.0, length, 11)
    solved = solve_bvp(derivatives, ends, x, np.zeros((4, x.size)), tol=1e-10)
    np.testing.assert_allclose([bent.deflection(at) for at in x], solved.sol(x)[0], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose([bent.slope(at) for at in x], solved.sol(x)[1], rtol=0.0, atol=1e-11)


def test_a_tube_has_the_section_of_the_handbooks() -> None:
    radius, bore = 1.0 * INCH, 0.875 * INCH
    assert TUBE.second_moment == pytest.approx(math.pi / 4.0 * (radius**4 - bore**4))
    assert TUBE.mass_per_length == pytest.approx(2700.0 * math.pi * (radius**2 - bore**2))
