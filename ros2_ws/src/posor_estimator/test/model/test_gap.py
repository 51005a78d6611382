from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
import pytest
from posor_estimator.model.gap import plane_normal
from posor_estimator.model.reading_rows import GAP

from .row_builder import parameter_derivatives, read_row, tangent_derivative

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt
    from posor_estimator.numerics.array_types import FloatArray

CASES = 200


def tilt_of(normal: FloatArray) -> tuple[float, float]:
    """Return the tilt about X and Y whose normal toward the probes is ``normal`` (unit)."""
    return math.atan2(normal[1], -normal[2]), -math.asin(normal[0])


def read(row: npt.ArrayLike, pose: pin.SE3) -> float:
    return read_row(GAP, row, pose)


@pytest.fixture
def random_case(
    rng: np.random.Generator, random_rotation: Callable[[], FloatArray]
) -> Callable[[], tuple[FloatArray, pin.SE3]]:
    """Return a maker of a row and a pose, anywhere in space; the axis meets the plane at 60 degrees or less."""

    def make() -> tuple[FloatArray, pin.SE3]:
        pose = pin.SE3(random_rotation(), rng.uniform(-0.1, 0.1, 3))
        tilt = rng.uniform(-1.2, 1.2, 2)
        turn = rng.uniform(-math.pi, math.pi)
        across = rng.normal(size=3)
        axis = -(pose.rotation @ np.array(plane_normal(tilt[0], tilt[1], turn))) + across / np.linalg.norm(across) * 0.8
        axis *= rng.uniform(0.5, 2.0) / np.linalg.norm(axis)
        return np.concatenate([rng.uniform(-0.1, 0.1, 3), axis, rng.uniform(-0.1, 0.1, 3), tilt, [turn]]), pose

    return make


def test_gaps_are_those_of_ray_tracing(golden_cases: list[dict[str, Any]]) -> None:
    for case in golden_cases:
        pose = pin.SE3(np.array(case["T_R_T"]["rotation"]), np.array(case["T_R_T"]["translation"]))
        plane = case["target_plane"]
        read_gaps = [
            read([*probe["tip"], *probe["axis"], *plane["point"], *tilt_of(np.array(plane["normal"])), 0.0], pose)
            for probe in case["probes"]
        ]
        traced = case["readings"]["gaps"]
        np.testing.assert_allclose(read_gaps, traced, rtol=0.0, atol=1e-12, err_msg=f"case {case['case']}")


def test_a_gap_is_the_distance_along_a_slanted_axis() -> None:
    slant = math.radians(60.0)
    row = np.array([0.01, 0.02, 0.0, math.sin(slant), 0.0, math.cos(slant), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert read(row, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.001]))) == pytest.approx(0.002, abs=1e-16)


def test_the_tilt_of_the_plane_turns_with_the_target() -> None:
    """A plane raised along Y of T by its tilt about X is raised along -X of R after a quarter turn about Z."""
    tilt = 0.01
    probe_at_minus_x = np.array([-0.05, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, tilt, 0.0, 0.0])
    quarter_turn = pin.SE3(pin.utils.rotate("z", math.pi / 2.0), np.array([0.0, 0.0, 0.001]))
    assert read(probe_at_minus_x, quarter_turn) == pytest.approx(0.001 + 0.05 * math.tan(tilt), abs=1e-15)
    by_parameter = probe_at_minus_x + math.pi / 2.0 * np.eye(12)[11]
    assert read(by_parameter, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.001]))) == pytest.approx(
        0.001 + 0.05 * math.tan(tilt), abs=1e-15
    )


def test_the_normal_is_a_unit_vector_toward_the_probes(rng: np.random.Generator) -> None:
    assert plane_normal(0.0, 0.0, 0.0) == (0.0, 0.0, -1.0)
    for tilt_x, tilt_y, turn in rng.uniform(-1.5, 1.5, (100, 3)):
        expected = (
            pin.utils.rotate("z", turn)
            @ pin.utils.rotate("x", tilt_x)
            @ pin.utils.rotate("y", tilt_y)
            @ np.array([0.0, 0.0, -1.0])
        )
        np.testing.assert_allclose(plane_normal(tilt_x, tilt_y, turn), expected, rtol=0.0, atol=1e-15)


def test_tangent_derivative_is_that_of_finite_differences(
    random_case: Callable[[], tuple[FloatArray, pin.SE3]],
    central_difference: Callable[[Callable[[FloatArray], float], int], FloatArray],
) -> None:
    for _ in range(CASES):
        row, pose = random_case()
        jacobian = tangent_derivative(GAP, row, pose)
        expected = central_difference(lambda step: read(row, pose * pin.exp6(step)), 6)  # noqa: B023  used at once
        np.testing.assert_allclose(jacobian, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


def test_parameter_derivatives_are_those_of_finite_differences(
    random_case: Callable[[], tuple[FloatArray, pin.SE3]],
    central_difference: Callable[[Callable[[FloatArray], float], int], FloatArray],
) -> None:
    for _ in range(CASES):
        row, pose = random_case()
        jacobian = parameter_derivatives(GAP, row, pose)
        expected = central_difference(lambda step: read(row + step, pose), row.size)  # noqa: B023  used at once
        np.testing.assert_allclose(jacobian, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())
