# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors at the end of an arm: geometry, limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from posor_design.error_chain import endpoint_error, position_bits, straight_linkage


def test_joint_errors_move_the_end_of_a_straight_arm() -> None:
    """Against the positions of the end of a planar arm."""
    lengths, errors = (0.8, 0.5, 0.2), (1e-6, 2e-6, 3e-6)
    end = sum(length * np.exp(1j * angle) for length, angle in zip(lengths, np.cumsum(errors), strict=True))
    found = endpoint_error(lengths, errors)
    assert found.worst_case == pytest.approx(end.imag, rel=1e-9)
    assert found.parts == pytest.approx((1.5e-6, 1.4e-6, 0.6e-6))
    assert found.root_sum_square == pytest.approx(math.sqrt(1.5**2 + 1.4**2 + 0.6**2) * 1e-6)
    assert endpoint_error(lengths, (-1e-6, 2e-6, 3e-6)) == found


def test_bits_double_the_parts() -> None:
    assert position_bits(1.024, 0.001).bits == pytest.approx(10.0)
    assert position_bits(1.024, 0.001).parts == pytest.approx(1024.0)


def test_a_straight_linkage_is_in_equilibrium() -> None:
    for force in (1e-3, 10.0, 1e5):
        found = straight_linkage(0.7, 4e-4, 200e9, force)
        assert found.tension * math.sin(found.angle) == pytest.approx(force)
        assert found.stretch == pytest.approx(found.tension * 0.7 / (4e-4 * 200e9))
        assert (0.7 + found.stretch) * math.cos(found.angle) == pytest.approx(0.7)


def test_a_light_force_gives_the_closed_form() -> None:
    """Small angles: 2 T^3 = A E F^2."""
    found = straight_linkage(0.7, 4e-4, 200e9, 1.0)
    assert found.tension == pytest.approx((0.5 * 4e-4 * 200e9) ** (1.0 / 3.0), rel=1e-4)
