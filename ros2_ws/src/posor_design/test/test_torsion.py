# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Discs, shafts and torsional vibration: published closed forms, a chain of discs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from posor_design.beam_section import make_section
from posor_design.torsion import beam_torsion, disc_inertia, shaft_stress

BEAM: dict[str, Any] = {
    "shape": "tube",
    "height": 0.05,
    "wall": 0.003,
    "length": 0.8,
    "modulus": 73e9,
    "density": 2768.0,
    "poisson_ratio": 0.33,
}
SHEAR_MODULUS = 73e9 / 2.66


def test_a_disc_and_a_ring_have_the_published_inertia() -> None:
    """Disc: m r^2 / 2 and m (3 r^2 + t^2) / 12; ring: m (r^2 + b^2) / 2 and m (3 (r^2 + b^2) + t^2) / 12."""
    disc = disc_inertia(0.2, 0.01, 2700.0)
    assert disc.mass == pytest.approx(2700.0 * math.pi * 0.1**2 * 0.01)
    assert disc.axis_inertia == pytest.approx(disc.mass * 0.1**2 / 2.0)
    assert disc.diameter_inertia == pytest.approx(disc.mass * (3.0 * 0.1**2 + 0.01**2) / 12.0)
    ring = disc_inertia(0.2, 0.01, 2700.0, bore=0.12)
    assert ring.mass == pytest.approx(2700.0 * math.pi * (0.1**2 - 0.06**2) * 0.01)
    assert ring.axis_inertia == pytest.approx(ring.mass * (0.1**2 + 0.06**2) / 2.0)
    assert ring.diameter_inertia == pytest.approx(ring.mass * (3.0 * (0.1**2 + 0.06**2) + 0.01**2) / 12.0)


def test_shaft_stress_has_the_published_form() -> None:
    assert shaft_stress(100.0, 0.02).stress == pytest.approx(16.0 * 100.0 / (math.pi * 0.02**3))
    hollow = 16.0 * 100.0 * 0.02 / (math.pi * (0.02**4 - 0.01**4))
    assert shaft_stress(100.0, 0.02, bore=0.01).stress == pytest.approx(hollow)


def test_without_discs_a_side_is_a_quarter_wave() -> None:
    found = beam_torsion(**BEAM, gimbal=0.2, modes=3)
    speed = math.sqrt(SHEAR_MODULUS / BEAM["density"])
    quarters = np.array([1.0, 3.0, 5.0])
    np.testing.assert_allclose(found.start_frequencies, quarters * speed / (4.0 * 0.2))
    np.testing.assert_allclose(found.end_frequencies, quarters * speed / (4.0 * 0.6))
    np.testing.assert_allclose(np.array(found.end_frequencies) * 2.0 * math.pi, found.end_angular_frequencies)


def test_with_heavy_discs_the_beam_is_a_spring() -> None:
    found = beam_torsion(**BEAM, gimbal=0.2, plate_inertias=(100.0, 50.0))
    stiffness = SHEAR_MODULUS * make_section("tube", 0.05, 0.0, 0.003).torsion_constant
    assert found.start_angular_frequencies[0] == pytest.approx(math.sqrt(stiffness / 0.2 / 100.0), rel=1e-4)
    assert found.end_angular_frequencies[0] == pytest.approx(math.sqrt(stiffness / 0.6 / 50.0), rel=1e-4)


def test_a_box_agrees_with_a_chain_of_discs() -> None:
    """Of 400 equal pieces; the torsion constant of a thin box is Bredt's."""
    values = {**BEAM, "shape": "box", "height": 0.06, "width": 0.04, "wall": 0.002}
    found = beam_torsion(**values, gimbal=0.0, plate_inertias=(0.0, 1e-3), modes=3)
    h, b, count = 0.058, 0.038, 400
    constant = 4.0 * (h * b) ** 2 * 0.002 / (2.0 * (h + b))
    upright = (0.04 * 0.06**3 - 0.036 * 0.056**3) / 12.0
    sideways = (0.06 * 0.04**3 - 0.056 * 0.036**3) / 12.0
    piece = BEAM["length"] / count
    inertia = np.full(count, BEAM["density"] * (upright + sideways) * piece)
    inertia[-1] = 0.5 * inertia[-1] + 1e-3
    twice = np.full(count, 2.0)
    twice[-1] = 1.0
    spring = SHEAR_MODULUS * constant / piece
    matrix = spring * (np.diag(twice) - np.diag(np.ones(count - 1), 1) - np.diag(np.ones(count - 1), -1))
    squares = scipy.linalg.eigvalsh(matrix, np.diag(inertia), subset_by_index=(0, 2))
    np.testing.assert_allclose(found.end_angular_frequencies, np.sqrt(squares), rtol=1e-4)
    assert found.start_frequencies == ()
