# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Motion of a scenario, and the nominal kinematics it needs: against the chain and finite differences."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posor.chain.arm_file import load_arm_file
from posor.errors import CalibrationError
from posor.numerics.array_types import FloatArray
from posor_drivers.simulator.motion_phases import smooth_step
from posor_drivers.simulator.nominal_arm import NominalArm
from posor_drivers.simulator.scenario import load_scenario
from posor_lab.harness.case_tables import refusal

from ..three_joint_arm import JOINTS, scenario, write_arm


def angles(folder: Path, content: dict[str, Any]) -> tuple[NominalArm, FloatArray]:
    arm = load_arm_file(write_arm(folder, content))
    nominal = NominalArm(arm.chain())
    assert arm.scenario is not None
    return nominal, load_scenario(arm.scenario).commanded_angles(nominal, "the scenario")


def test_motion_is_periodic_and_starts_at_home(tmp_path: Path) -> None:
    _, found = angles(tmp_path, scenario({"rate.value": 1000}))
    assert np.array_equal(found[0], np.zeros(3))
    # The way from the last tick to the first is as smooth as any other: a second of approach ends there.
    assert np.max(np.abs(found[0] - found[-1])) < 1e-7


def test_motion_is_smooth_across_all_phases(tmp_path: Path) -> None:
    second = {}
    for rate in (500, 1000):
        _, found = angles(tmp_path, scenario({"rate.value": rate}))
        round_and_round = np.vstack([found, found[:2]])
        second[rate] = np.max(np.abs(np.diff(round_and_round, n=2, axis=0)), axis=0)
    # Twice the rate, a quarter of the second difference: with a jump of the velocity it would be half.
    assert np.all(second[500] / second[1000] > 3.5)


@pytest.mark.parametrize(("rest_s", "times"), [(0.4, (1.4, 2.4, 3.6)), (0.6, (1.6, 2.6, 3.6))])
def test_rest_stands_still_and_spline_passes_its_waypoints(
    tmp_path: Path, rest_s: float, times: tuple[float, ...]
) -> None:
    """Without ``at``, which is left out with the longer rest, the waypoints are evenly spaced."""
    content = scenario()
    if rest_s > 0.4:
        del content["motion"][1]["at"]
        content["motion"][1]["duration"]["value"], content["motion"][0]["duration"]["value"] = 3.0, rest_s
    _, found = angles(tmp_path, content)
    assert np.array_equal(found[:40], np.zeros((40, 3)))
    for time, row in zip(times, content["motion"][1]["through"]["value"], strict=True):
        assert np.allclose(found[round(100 * time)], row, rtol=0.0, atol=1e-12)


def test_dither_is_a_sum_of_windowed_sines(tmp_path: Path) -> None:
    _, found = angles(tmp_path, scenario())
    t = np.arange(90) / 100
    window = np.sin(np.pi * t / 0.9) ** 2
    base = window * (1e-3 * np.sin(2 * np.pi * 3 * t) + 5e-4 * np.sin(2 * np.pi * 7 * t))
    elbow = window * 1e-3 * np.sin(2 * np.pi * 5 * t)
    assert np.allclose(found[360:450], np.column_stack([base, np.zeros(90), elbow]), rtol=0.0, atol=1e-12)


def test_circle_is_followed_once_in_its_plane_from_the_point_nearest_to_the_posture(tmp_path: Path) -> None:
    nominal, found = angles(tmp_path, scenario())
    points = nominal.endpoint(found[580:671]).translations - np.array([0.95, 0.05, 0.69])
    assert np.allclose(np.linalg.norm(points, axis=1), 0.03, rtol=0.0, atol=1e-9)
    assert np.allclose(points @ np.array([0.0, 0.6, 0.8]), 0.0, atol=1e-9)
    turned = np.unwrap(np.arctan2(points @ np.cross([0.0, 0.6, 0.8], points[0]) / 0.03, points @ points[0] / 0.03))
    assert np.allclose(turned, 2.0 * np.pi * smooth_step(np.arange(91) / 90), rtol=0.0, atol=1e-6)
    posture = nominal.endpoint(np.array([[0.0, -0.5, 0.9]])).translations[0]
    away = np.linalg.norm(nominal.endpoint(found[580:671]).translations - posture, axis=1)
    assert np.argmin(away) in (0, 90)


def test_circle_about_the_posture_can_start_anywhere(tmp_path: Path) -> None:
    nominal, _ = angles(tmp_path, scenario())
    centre = nominal.endpoint(np.array([[0.0, -0.5, 0.9]])).translations[0]
    _, found = angles(tmp_path, scenario({"motion.3.centre.value": centre.tolist()}))
    points = nominal.endpoint(found[580:671]).translations - centre
    assert np.allclose(np.linalg.norm(points, axis=1), 0.03, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"motion.3.centre.value": [3.0, 0.05, 0.69]}, "the circle of 0.03 m about (3, 0.05, 0.69) m"),
        ({"motion.3.radius.value": 0.4}, "the circle of 0.4 m about (0.95, 0.05, 0.69) m"),
    ],
)
def test_circle_out_of_reach_is_refused_with_phase_and_keys(tmp_path: Path, changes: dict[str, Any], what: str) -> None:
    error = refusal(CalibrationError, angles, tmp_path, scenario(changes))
    assert error.where == "the scenario, key motion[3] (circle), keys centre, radius, posture"
    assert error.what == f"the arm cannot follow {what} from its posture"


def test_nominal_kinematics_of_many_angles_is_that_of_the_chain(tmp_path: Path) -> None:
    chain = load_arm_file(write_arm(tmp_path)).chain()
    many = np.random.default_rng(1).uniform(-2.0, 2.0, size=(20, 3))
    found = NominalArm(chain).endpoint(many)
    for n, row in enumerate(many):
        expected = chain.nominal_endpoint(dict(zip(JOINTS, row, strict=True)))
        assert np.allclose(found[n].homogeneous, expected.homogeneous, rtol=0.0, atol=1e-14)


def test_jacobian_agrees_with_differences(tmp_path: Path) -> None:
    arm = NominalArm(load_arm_file(write_arm(tmp_path)).chain())
    here = np.random.default_rng(2).uniform(-1.0, 1.0, size=(5, 3))
    _, jacobian = arm.jacobian(here)
    for column in range(3):
        step = 1e-6 * np.eye(3)[column]
        difference = arm.endpoint(here + step).translations - arm.endpoint(here - step).translations
        assert np.allclose(jacobian[:, :, column], difference / 2e-6, rtol=0.0, atol=1e-9)
