from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
import pytest
from posor_estimator.model.reading_rows import RING
from posor_estimator.model.ring import MAX_HARMONICS, multiple_angle

from .row_builder import parameter_derivatives, read_row, tangent_derivative

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt
    from posor_estimator.numerics.array_types import FloatArray

CASES = 200
WHOLE_NUMBERS = (7, 8, 11, 14)  # the number of harmonics, and each k: not to be differentiated


def read(row: npt.ArrayLike, pose: pin.SE3) -> float:
    return read_row(RING, row, pose)


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
        jacobian = tangent_derivative(RING, row, pose)
        expected = central_difference(lambda step: read(row, pose * pin.exp6(step)), 6)  # noqa: B023  used at once
        np.testing.assert_allclose(jacobian, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


def test_parameter_derivatives_are_those_of_finite_differences(
    random_case: Callable[[], tuple[FloatArray, pin.SE3]],
    central_difference: Callable[[Callable[[FloatArray], float], int], FloatArray],
) -> None:
    for _ in range(CASES):
        row, pose = random_case()
        jacobian = parameter_derivatives(RING, row, pose)
        differentiable = np.ones(row.size)
        differentiable[list(WHOLE_NUMBERS)] = 0.0
        expected = central_difference(lambda step: read(row + step * differentiable, pose), row.size)  # noqa: B023  used at once
        np.testing.assert_allclose(jacobian, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


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
    expected = read([*fixed, *harmonics.ravel()], pose)
    for _ in range(20):
        rng.shuffle(harmonics)
        assert read([*fixed, *harmonics.ravel()], pose) == pytest.approx(expected, abs=1e-16)
    assert len(orders) <= MAX_HARMONICS
