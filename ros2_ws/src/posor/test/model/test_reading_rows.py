# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Readings of all kinds of rows against ray tracing, and their derivatives against finite differences."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from posor.model.reading_rows import GAP, RING, SPOT_X, SPOT_Y
from posor.numerics.array_types import FloatArray
from posor_lab.harness.row_builder import parameter_derivatives, read_row, tangent_derivative

from .random_rows import random_gap, random_ring_gap, random_spot

CASES = 40
WHOLE_NUMBERS = {RING: (7, 8, 11, 14)}  # the number of harmonics, and each k: not to be differentiated


def gaps(case: dict[str, Any]) -> list[tuple[int, list[float]]]:
    plane = case["target_plane"]
    normal = plane["normal"]  # unit, toward the probes
    tilt = math.atan2(normal[1], -normal[2]), -math.asin(normal[0])
    return [(GAP, [*probe["tip"], *probe["axis"], *plane["point"], *tilt, 0.0]) for probe in case["probes"]]


def ring_gaps(case: dict[str, Any]) -> list[tuple[int, list[float]]]:
    ring = case["ring"]
    orders = sorted({*ring["cos"], *ring["sin"]}, key=int)
    harmonics = [(float(k), ring["cos"].get(k, 0.0), ring["sin"].get(k, 0.0)) for k in orders]
    common = [ring["mean_radius"], len(orders), *np.ravel(harmonics)]
    return [(RING, [*probe["tip"], *probe["axis"], *common]) for probe in case["ring_probes"]]


def spots(case: dict[str, Any]) -> list[tuple[int, list[float]]]:
    """Return kind and parameters of the light spots of a ray-traced case, X and Y of each diode."""
    return [
        (kind, [*diode["origin"], *diode["u"], *diode["v"], *source["origin"], *source["direction"], 0.0])
        for diode, source in zip(case["diodes"], case["sources"], strict=True)
        for kind in (SPOT_X, SPOT_Y)
    ]


@pytest.mark.parametrize("rows_of", [gaps, ring_gaps, spots])
def test_readings_are_those_of_ray_tracing(
    rows_of: Callable[[dict[str, Any]], list[tuple[int, list[float]]]], golden_cases: list[dict[str, Any]]
) -> None:
    for case in golden_cases:
        pose = pin.SE3(np.array(case["T_R_T"]["rotation"]), np.array(case["T_R_T"]["translation"]))
        found = [read_row(kind, row, pose) for kind, row in rows_of(case)]
        traced = np.ravel(case["readings"][rows_of.__name__])
        np.testing.assert_allclose(found, traced, rtol=0.0, atol=1e-12, err_msg=f"case {case['case']}")


@pytest.mark.parametrize(
    ("kind", "random_case"), [(GAP, random_gap), (RING, random_ring_gap), (SPOT_X, random_spot), (SPOT_Y, random_spot)]
)
def test_derivatives_are_those_of_finite_differences(
    kind: int,
    random_case: Callable[[np.random.Generator], tuple[FloatArray, pin.SE3]],
    rng: np.random.Generator,
    central_difference: Callable[[Callable[[FloatArray], float], int], FloatArray],
) -> None:
    for _ in range(CASES):
        row, pose = random_case(rng)
        differentiable = np.ones(row.size)
        differentiable[list(WHOLE_NUMBERS.get(kind, ()))] = 0.0
        # Both functions are used at once, within this turn of the loop.
        by_tangent = central_difference(lambda step: read_row(kind, row, pose * pin.exp6(step)), 6)  # noqa: B023
        by_parameters = central_difference(lambda step: read_row(kind, row + step * differentiable, pose), row.size)  # noqa: B023
        for found, expected in (
            (tangent_derivative(kind, row, pose), by_tangent),
            (parameter_derivatives(kind, row, pose), by_parameters),
        ):
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())
