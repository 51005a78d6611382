from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
import pytest
from posor_estimator.model.reading_rows import SPOT_X, SPOT_Y, evaluate_rows, pair_spots
from posor_estimator.numerics.compiled import record_view

from .row_builder import make_rows, parameter_derivatives, read_row, tangent_derivative

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt
    from posor_estimator.numerics.array_types import FloatArray

CASES = 200
X, Y = 0, 1


def read(row: npt.ArrayLike, pose: pin.SE3, which: int) -> float:
    return read_row(SPOT_X + which, row, pose)


@pytest.fixture
def random_case(
    rng: np.random.Generator, random_rotation: Callable[[], FloatArray]
) -> Callable[[], tuple[FloatArray, pin.SE3]]:
    """Return a maker of a row and a pose, anywhere in space; the ray meets a skewed diode at 60 degrees or less."""

    def make() -> tuple[FloatArray, pin.SE3]:
        pose = pin.SE3(random_rotation(), rng.uniform(-0.1, 0.1, 3))
        diode = random_rotation()
        u, v = diode[:, 0], diode[:, 1] + rng.uniform(-0.5, 0.5) * diode[:, 0]
        across = rng.normal(size=3)
        ray = pose.rotation.T @ (-diode[:, 2] + across / np.linalg.norm(across) * 0.8)
        origins = rng.uniform(-0.1, 0.1, (2, 3))
        lengths = rng.uniform(0.5, 2.0, 3)
        turn = rng.uniform(-0.3, 0.3)
        return np.concatenate([origins[0], lengths[0] * u, lengths[1] * v, origins[1], lengths[2] * ray, [turn]]), pose

    return make


def test_spots_are_those_of_ray_tracing(golden_cases: list[dict[str, Any]]) -> None:
    for case in golden_cases:
        pose = pin.SE3(np.array(case["T_R_T"]["rotation"]), np.array(case["T_R_T"]["translation"]))
        spots = []
        for diode, source in zip(case["diodes"], case["sources"], strict=True):
            row = np.array([*diode["origin"], *diode["u"], *diode["v"], *source["origin"], *source["direction"], 0.0])
            spots.append([read(row, pose, X), read(row, pose, Y)])
        traced = case["readings"]["spots"]
        np.testing.assert_allclose(spots, traced, rtol=0.0, atol=1e-12, err_msg=f"case {case['case']}")


def test_a_spot_is_where_a_leaning_ray_meets_the_diode() -> None:
    """One millimetre above the diode a ray that leans by 0.1 along X and -0.2 along Y has moved by so much."""
    row = np.array([0.01, 0.02, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.012, 0.025, 0.0, 0.1, -0.2, -1.0, 0.0])
    pose = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.001]))
    assert read(row, pose, X) == pytest.approx(0.002 + 0.0001, abs=1e-16)
    assert read(row, pose, Y) == pytest.approx(0.005 - 0.0002, abs=1e-16)


def test_coordinates_are_along_the_diodes_own_axes_even_if_these_are_skew() -> None:
    u, v = np.array([1.0, 0.0, 0.0]), np.array([0.6, 0.8, 0.0])
    spot = 0.003 * u - 0.002 * v
    row = np.concatenate([np.zeros(3), u, v, spot, [0.0, 0.0, -1.0, 0.0]])
    pose = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.001]))
    assert read(row, pose, X) == pytest.approx(0.003, abs=1e-16)
    assert read(row, pose, Y) == pytest.approx(-0.002, abs=1e-16)


def test_the_length_of_the_direction_has_no_effect_and_those_of_the_axes_scale(
    random_case: Callable[[], tuple[FloatArray, pin.SE3]],
) -> None:
    for _ in range(20):
        row, pose = random_case()
        longer_ray, longer_u = row.copy(), row.copy()
        longer_ray[12:15] *= 3.0
        longer_u[3:6] *= 2.0
        for which in (X, Y):
            assert read(longer_ray, pose, which) == pytest.approx(read(row, pose, which), abs=1e-14)
        assert read(longer_u, pose, X) == pytest.approx(read(row, pose, X) / 2.0, abs=1e-14)
        assert read(longer_u, pose, Y) == pytest.approx(read(row, pose, Y), abs=1e-14)


def test_the_extra_turn_turns_the_direction_about_z_of_the_target(
    random_case: Callable[[], tuple[FloatArray, pin.SE3]],
) -> None:
    for _ in range(20):
        row, pose = random_case()
        turned = row.copy()
        turned[12:15] = pin.utils.rotate("z", row[15]) @ row[12:15]
        turned[15] = 0.0
        for which in (X, Y):
            assert read(turned, pose, which) == pytest.approx(read(row, pose, which), abs=1e-14)


@pytest.mark.parametrize("which", [X, Y])
def test_tangent_derivative_is_that_of_finite_differences(
    which: int,
    random_case: Callable[[], tuple[FloatArray, pin.SE3]],
    central_difference: Callable[[Callable[[FloatArray], float], int], FloatArray],
) -> None:
    for _ in range(CASES):
        row, pose = random_case()
        jacobian = tangent_derivative(SPOT_X + which, row, pose)
        expected = central_difference(lambda step: read(row, pose * pin.exp6(step), which), 6)  # noqa: B023  used at once
        np.testing.assert_allclose(jacobian, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("which", [X, Y])
def test_parameter_derivatives_are_those_of_finite_differences(
    which: int,
    random_case: Callable[[], tuple[FloatArray, pin.SE3]],
    central_difference: Callable[[Callable[[FloatArray], float], int], FloatArray],
) -> None:
    for _ in range(CASES):
        row, pose = random_case()
        jacobian = parameter_derivatives(SPOT_X + which, row, pose)
        expected = central_difference(lambda step: read(row + step, pose, which), row.size)  # noqa: B023  used at once
        np.testing.assert_allclose(jacobian, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


def test_a_pair_of_rows_reads_as_its_rows_do(random_case: Callable[[], tuple[FloatArray, pin.SE3]]) -> None:
    row, pose = random_case()
    rows = make_rows([SPOT_X, SPOT_Y], [row, row])
    alone = evaluate_rows(rows, pose.rotation, pose.translation)
    pair_spots(record_view(rows), 2)
    paired = evaluate_rows(rows, pose.rotation, pose.translation)
    for found, expected in zip(paired, alone, strict=True):
        np.testing.assert_array_equal(found, expected)
