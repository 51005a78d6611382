# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What layouts achieve: noise and its reserve, converter bits, agreement with the error budget."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pinocchio as pin
import pytest
from posor.estimation.posor import Posor
from posor.uncertainty.budget_poses import scan_at
from posor.uncertainty.first_order import error_budget
from posor.uncertainty.reliability import joint_reliability
from posor_design.layout_evaluation import evaluate, extreme_poses, with_noise
from posor_design.layout_geometry import LayoutKind
from posor_design.posor_layout import BITS

from .layout_examples import BUMPS, RING_OF_LIGHTS, candidate, example

GAP = 2
KINDS = (RING_OF_LIGHTS, BUMPS)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_uncertainties_are_those_of_the_error_budget(kind: LayoutKind) -> None:
    """The budget has a measured supply voltage and temperature, which improves the gap most."""
    poses = extreme_poses(example(), candidate(kind).layout.gap)
    posor = Posor(candidate(kind).layout.calibration(example()))
    for n in (0, len(poses.thetas) - 1):
        pose = pin.SE3(poses.rotations[n], poses.translations[n])
        sigmas = np.sqrt(candidate(kind).random[n] + candidate(kind).systematic[n])
        budget = error_budget(posor, scan_at(posor, pose), pose).sigmas
        assert np.all(budget <= 1.0001 * sigmas)
        assert np.all(np.delete(sigmas, GAP) <= 1.1 * np.delete(budget, GAP))
    assert candidate(kind).fault == joint_reliability(posor, scan_at(posor, pose), pose).biases.max()


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_the_largest_noise_uses_up_the_requirement(kind: LayoutKind) -> None:
    quiet = with_noise(example(), candidate(kind), 0.25, extreme_poses(example(), candidate(kind).layout.gap))
    factor = quiet.largest_noise(example().sigmas)
    loud = with_noise(example(), quiet, 0.25 * factor, extreme_poses(example(), quiet.layout.gap))
    assert np.max(loud.sigmas / example().sigmas) == pytest.approx(1.0, rel=0.05)
    assert quiet.largest_noise(1e-3 * example().sigmas) == 0.0


def test_noise_grows_with_the_scan_rate_and_needs_fewer_bits() -> None:
    layout = candidate().layout
    fast = example().changed(scan_rate=4000.0)
    poses = extreme_poses(example(), layout.gap)
    found = evaluate(fast, RING_OF_LIGHTS, layout, poses)
    np.testing.assert_allclose(found.random, 4.0 * candidate().random, rtol=0.05)
    np.testing.assert_allclose(found.systematic, candidate().systematic, rtol=1e-3)
    bits = [replace(layout, noise=noise).bits(1000.0) for noise in (1e-3, 0.25, 1.0, 8.0)]
    assert bits == sorted(bits, reverse=True)
    assert set(bits) <= set(BITS)
    assert bits[0] > bits[-1]


def test_corners_reach_the_ends_of_the_range_in_all_pairs() -> None:
    native = extreme_poses(example(), 1e-3).native
    corners = native[native[:, 0] != 0.0]
    np.testing.assert_allclose(np.abs(corners[:, :2]), 1e-4)
    np.testing.assert_allclose(np.abs(corners[:, 3:5]), 1e-3)
    signs = np.sign(corners[:, :5] - [0, 0, 1e-3, 0, 0])
    for i, j in combinations(range(5), 2):
        assert len(np.unique(signs[:, [i, j]], axis=0)) == 4
    assert np.ptp(native[:, 5]) > 0.9 * 2.0 * example().rotation
