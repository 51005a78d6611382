# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from posor.model.gap import MAX_HARMONICS, multiple_angle
from posor.model.reading_rows import RING
from posor_lab.harness.row_builder import read_row


def test_a_bump_turned_to_the_probe_shortens_the_gap() -> None:
    bump = 1e-4
    row = np.array([0.052, 0.0, 0.005, -1.0, 0.0, 0.0, 0.05, 1.0, 4.0, 0.0, bump])
    valley, top = pin.SE3.Identity(), pin.SE3(pin.utils.rotate("z", -math.pi / 8.0), np.zeros(3))
    assert read_row(RING, row, valley) == pytest.approx(0.002, abs=1e-16)
    assert read_row(RING, row, top) == pytest.approx(0.002 - bump, abs=1e-16)


def test_a_probe_that_looks_past_the_ring_reads_no_number() -> None:
    row = np.array([0.052, 0.0, 0.005, 0.0, 1.0, 0.0, 0.05, 1.0, 4.0, 0.0, 1e-4])
    assert math.isnan(read_row(RING, row, pin.SE3.Identity()))


def test_multiples_of_an_angle_are_those_of_cosine_and_sine() -> None:
    for angle in np.linspace(-math.pi, math.pi, 41):
        for k in (0, 1, 2, 3, 35, 36, 37, 108, 240):
            found = multiple_angle(math.cos(angle), math.sin(angle), k)
            expected = (math.cos(k * angle), math.sin(k * angle))
            np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-15 * (1 + 4 * k))


def test_harmonics_in_any_order_give_the_same_gap(rng: np.random.Generator) -> None:
    """The harmonics are evaluated from one order to the next, so their order in the file must not matter."""
    orders = [1, 2, 3, 36, 72, 108, 5, 37, 4]
    pose = pin.SE3(pin.utils.rotate("z", 0.3), np.array([1e-4, -2e-4, 0.0]))
    harmonics = np.array([[k, *rng.uniform(-2e-5, 2e-5, 2)] for k in orders])
    fixed = [0.052, 0.0, 0.005, -1.0, 0.0, 0.0, 0.05, len(orders)]
    expected = read_row(RING, [*fixed, *harmonics.ravel()], pose)
    for _ in range(20):
        rng.shuffle(harmonics)
        assert read_row(RING, [*fixed, *harmonics.ravel()], pose) == pytest.approx(expected, abs=1e-16)
    assert len(orders) <= MAX_HARMONICS
