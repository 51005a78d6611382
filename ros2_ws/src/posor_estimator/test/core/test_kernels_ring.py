from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
import pytest
from posor_estimator.core.kernels import ring as kernel

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_estimator.core.types import FloatArray

CASES = 200
WHOLE_NUMBERS = (7, 8, 11, 14)  # the number of harmonics, and each k: not to be differentiated


def read(row: FloatArray, pose: pin.SE3) -> float:
    return kernel.ring_gap(
        row[None], 0, np.empty((1, 1)), pose.rotation.copy(), pose.translation.copy(), np.empty((1, 6))
    )


@pytest.fixture
def random_case(rng: np.random.Generator) -> Callable[[], tuple[FloatArray, pin.SE3]]:
    """Return a maker of a probe that looks at a ring of 36 bumps, anywhere around it, and a pose."""

    def make() -> tuple[FloatArray, pin.SE3]:
        lean = np.array([*rng.uniform(-0.05, 0.05, 2), 0.0])
        turn = pin.utils.rotate("z", rng.uniform(-math.pi, math.pi))
        pose = pin.SE3(pin.exp3(lean) @ turn, rng.uniform(-5e-4, 5e-4, 3))
        around = rng.uniform(-math.pi, math.pi)
        outward = np.array([math.cos(around), math.sin(around), 0.0])
        axis = -outward + rng.uniform(-0.05, 0.05, 3)
        harmonics = [[k, *rng.uniform(-size, size, 2)] for k, size in ((1, 1e-4), (36, 1e-4), (72, 1e-5))]
        radius = rng.uniform(0.03, 0.06)
        tip = (radius + 1e-3) * outward + [0.0, 0.0, 0.005]
        return np.array([*tip, *(axis / np.linalg.norm(axis)), radius, 3, *np.ravel(harmonics)]), pose

    return make


def test_ring_gaps_are_those_of_ray_tracing(golden_cases: list[dict[str, Any]]) -> None:
    for case in golden_cases:
        pose = pin.SE3(np.array(case["T_R_T"]["rotation"]), np.array(case["T_R_T"]["translation"]))
        ring = case["ring"]
        orders = sorted({*ring["cos"], *ring["sin"]}, key=int)
        harmonics = [(float(k), ring["cos"].get(k, 0.0), ring["sin"].get(k, 0.0)) for k in orders]
        read_gaps = [
            read(
                np.array([*probe["tip"], *probe["axis"], ring["mean_radius"], len(orders), *np.ravel(harmonics)]), pose
            )
            for probe in case["ring_probes"]
        ]
        traced = case["readings"]["ring_gaps"]
        np.testing.assert_allclose(read_gaps, traced, rtol=0.0, atol=1e-12, err_msg=f"case {case['case']}")


def test_a_bump_turned_to_the_probe_shortens_the_gap() -> None:
    bump = 1e-4
    row = np.array([0.052, 0.0, 0.005, -1.0, 0.0, 0.0, 0.05, 1.0, 4.0, 0.0, bump])
    valley, top = pin.SE3.Identity(), pin.SE3(pin.utils.rotate("z", -math.pi / 8.0), np.zeros(3))
    assert read(row, valley) == pytest.approx(0.002, abs=1e-16)
    assert read(row, top) == pytest.approx(0.002 - bump, abs=1e-16)


def test_a_probe_that_looks_past_the_ring_reads_no_number() -> None:
    row = np.array([0.052, 0.0, 0.005, 0.0, 1.0, 0.0, 0.05, 1.0, 4.0, 0.0, 1e-4])
    assert math.isnan(read(row, pin.SE3.Identity()))


def test_tangent_derivative_is_that_of_finite_differences(
    random_case: Callable[[], tuple[FloatArray, pin.SE3]],
    central_difference: Callable[[Callable[[FloatArray], float], int], FloatArray],
) -> None:
    for _ in range(CASES):
        row, pose = random_case()
        jacobian = np.empty((1, 6))
        kernel.ring_gap(row[None], 0, np.empty((1, 1)), pose.rotation.copy(), pose.translation.copy(), jacobian)
        expected = central_difference(lambda step: read(row, pose * pin.exp6(step)), 6)  # noqa: B023  used at once
        np.testing.assert_allclose(jacobian[0], expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


def test_parameter_derivatives_are_those_of_finite_differences(
    random_case: Callable[[], tuple[FloatArray, pin.SE3]],
    central_difference: Callable[[Callable[[FloatArray], float], int], FloatArray],
) -> None:
    for _ in range(CASES):
        row, pose = random_case()
        jacobian, prepared = np.empty((1, row.size)), np.empty((1, 1))
        kernel.prepare_ring(0, prepared)
        kernel.ring_parameters(row[None], 0, prepared, pose.rotation.copy(), pose.translation.copy(), jacobian)
        differentiable = np.ones(row.size)
        differentiable[list(WHOLE_NUMBERS)] = 0.0
        expected = central_difference(lambda step: read(row + step * differentiable, pose), row.size)  # noqa: B023  used at once
        np.testing.assert_allclose(jacobian[0], expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


def test_multiples_of_an_angle_are_those_of_cosine_and_sine() -> None:
    for angle in np.linspace(-math.pi, math.pi, 41):
        for k in (0, 1, 2, 3, 35, 36, 37, 108, 240):
            found = kernel.turned_times(math.cos(angle), math.sin(angle), k)
            expected = (math.cos(k * angle), math.sin(k * angle))
            np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-15 * (1 + 4 * k))
