# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The example that filters the endpoint with its two covariances, on simulated arms."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

EXAMPLE = runpy.run_path(str(Path(__file__).resolve().parents[1] / "examples" / "filter_endpoint.py"))
CONSIDER, WHITE = EXAMPLE["CONSIDER"], EXAMPLE["WHITE"]


def test_a_constant_error_changes_no_estimate_and_stays_in_its_covariance() -> None:
    chance, count = np.random.default_rng(3), 50
    roots = 1e-6 * chance.normal(size=(2, 3, 3))
    random, systematic = np.tile(roots @ np.swapaxes(roots, 1, 2), (count, 1, 1, 1)).swapaxes(0, 1)
    times_s, positions = 0.005 * np.arange(count), 1e-5 * chance.normal(size=(count, 3))
    found, covariances = EXAMPLE["filter_positions"](times_s, positions, random, systematic, 1e-3)
    alone, own = EXAMPLE["filter_positions"](times_s, positions, random, np.zeros_like(systematic), 1e-3)
    np.testing.assert_allclose(found, alone, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(covariances, own + systematic, rtol=1e-6)
    assert np.trace(own[-1]) < 0.5 * np.trace(random[-1])


@pytest.mark.timeout(600)
@pytest.mark.parametrize(("arms", "tolerance"), [(20, 0.05), pytest.param(60, 0.02, marks=pytest.mark.long)])
def test_the_truth_is_inside_the_region_unless_the_sum_is_taken_as_white(
    arms: int, tolerance: float, tmp_path: Path
) -> None:
    shares = EXAMPLE["main"](["--arms", str(arms), "--figure", str(tmp_path / "figure.png")])
    for in_motion in (False, True):
        assert shares[CONSIDER, in_motion] == pytest.approx(0.95, abs=tolerance)
        assert shares[WHITE, in_motion] < 0.65
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
