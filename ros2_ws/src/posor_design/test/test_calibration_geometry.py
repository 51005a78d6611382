# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Geometry of calibration measurements: values of the thesis, independent geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest
from posor_design.calibration_geometry import axis_offsets, light_source_angles, probe_spacing


def test_offsets_of_the_thesis() -> None:
    angle, sigma = math.radians(89.503239), math.radians(0.029424)
    found = axis_offsets(3.0, angle, sigma, 0.000012, 0.000035)
    assert found.x_uncertainty == pytest.approx(0.001541, abs=1e-6)
    assert found.y_uncertainty == pytest.approx(0.000037, abs=1e-6)


def test_offsets_lead_from_one_reading_to_the_other() -> None:
    """A point has the readings r1 on diode 1 and r2 on diode 2, whose origin lies at the offset."""
    offset, first, motion = np.array([0.05, 3.0]), np.array([0.1, -0.2]), np.array([0.3, 2.9])
    second = first + motion - offset
    found = axis_offsets(
        math.hypot(*motion),
        math.atan2(motion[1], motion[0]),
        0.0,
        x_difference=first[0] - second[0],
        y_difference=first[1] - second[1],
    )
    assert (found.x, found.y) == pytest.approx(tuple(offset + 0.0)), "sign of the differences"


def test_angles_of_the_thesis() -> None:
    found = light_source_angles(-0.746148, 0.003996, 0.0908, 0.000638)
    assert found.alpha == pytest.approx(-0.002713, abs=5e-7)
    assert found.alpha_uncertainty == pytest.approx(0.000514, abs=1e-6)
    assert found.beta == pytest.approx(-0.002934, abs=5e-7)
    assert light_source_angles(0.748083, 0.002762).alpha_uncertainty == 0.0


def test_small_uncertainties_act_by_the_derivatives() -> None:
    found = light_source_angles(0.7, 0.004, 1e-5, 0.0)
    assert found.alpha_uncertainty == pytest.approx(0.004 * math.cos(0.7) * 1e-5, rel=1e-4)
    assert found.beta_uncertainty == pytest.approx(0.004 * math.sin(0.7) * 1e-5, rel=1e-4)
    only = light_source_angles(0.7, 0.004, 0.0, 1e-4)
    assert math.hypot(only.alpha_uncertainty, only.beta_uncertainty) == pytest.approx(1e-4)


def test_spacing_of_the_thesis() -> None:
    found = probe_spacing(0.05, 0.05 / 3.0, 100e-6, 100e-6, 3.0)
    assert found.spacing_error == pytest.approx(-0.0179, abs=1e-4)
    assert found.gap_error == pytest.approx(5e-6)
    assert found.spacing == pytest.approx(3.0, rel=1e-3)


def test_the_spacing_follows_from_a_tilted_plane() -> None:
    normal = np.array([math.sin(0.02), 0.0, math.cos(0.02)])
    gaps = [-normal[0] * x / normal[2] for x in (-1.2, 1.8)]
    assert probe_spacing(gaps[0] - gaps[1], 0.02).spacing == pytest.approx(3.0)
