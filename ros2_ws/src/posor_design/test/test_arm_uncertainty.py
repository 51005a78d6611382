# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of an arm's endpoint: against the chain, by hand, and against the formulas of the guides."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.arm_file import load_arm_file
from posor.chain.joint_measurements import MeasuredJoint
from posor.uncertainty.budget_poses import model_covariances
from posor_design.arm_uncertainty import ArmUncertainty, EndpointUncertainty, calibration_freedoms, region_factor
from posor_design.endpoint_components import ALL_BEAMS, Component, Kind, total_covariance
from posor_lab.arm_study.shared_arm import write_shared_arm
from scipy.stats import chi2, f, t

ARMS = Path(__file__).resolve().parents[2] / "posor_bringup" / "arms"
ANGLES = {"five_axis": [0.4, -0.6, 0.9, 0.3, -0.5], "six_axis": [0.3, -0.5, 0.8, 0.2, 0.5, -1.0]}


@pytest.fixture(scope="module", params=["five_axis", "six_axis", "shared"])
def model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> ArmUncertainty:
    if request.param != "shared":
        return ArmUncertainty(load_arm_file(ARMS / request.param / "arm.yaml"))
    folder = tmp_path_factory.mktemp("shared")
    return ArmUncertainty(load_arm_file(write_shared_arm(load_arm_file(ARMS / "five_axis" / "arm.yaml"), folder)))


def at(model: ArmUncertainty) -> EndpointUncertainty:
    angles = next(each for each in ANGLES.values() if len(each) == len(model.joints))
    return model.at(np.array([angles]))[0]


def test_the_components_are_the_covariance_that_the_chain_publishes_and_the_temperature(model: ArmUncertainty) -> None:
    found = at(model)
    random, systematic, shared = model_covariances(model.calibrations, model.chain, found.angles)
    measured = {
        name: MeasuredJoint(
            model.chain.nominal_joint(name, found.angles[name]), random[name], systematic[name], shared[name]
        )
        for name in model.joints
    }
    published = model.chain.estimate(measured)
    own = [each for each in found.components if each.kind is not Kind.TEMPERATURE]
    np.testing.assert_allclose(total_covariance(own), published.covariance(), rtol=1e-9, atol=1e-22)
    np.testing.assert_allclose(found.T_base_endpoint.homogeneous, published.T_base_endpoint.homogeneous, atol=1e-12)
    assert {each.kind for each in own} >= {Kind.RANDOM, Kind.SYSTEMATIC, Kind.SAG}
    assert (Kind.SHARED in {each.kind for each in own}) == bool(model.chain.shared)


def test_shares_add_up_to_the_whole(model: ArmUncertainty) -> None:
    found = at(model)
    np.testing.assert_allclose(found.shares().sum(axis=0), 1.0, rtol=1e-12)
    assert found.position_shares().sum() == pytest.approx(1.0, rel=1e-12)
    squares = sum(np.diagonal(each.covariance) for each in found.components)
    np.testing.assert_allclose(np.square(found.standard), squares, rtol=1e-12)


def test_the_temperature_moves_all_beams_of_an_extended_arm_alike() -> None:
    arm = load_arm_file(ARMS / "five_axis" / "arm.yaml")
    stated, cold = ArmUncertainty(arm), ArmUncertainty(arm, deviation=0.5)
    along = sum(float(np.linalg.norm(beam.expansion)) for beam in stated.chain.beams if beam.name != "pedestal")
    straight = np.zeros((1, len(stated.joints)))
    by_temperature = {}
    for name, each in (("stated", stated), ("cold", cold)):
        (part,) = (c for c in each.at(straight)[0].components if c.kind is Kind.TEMPERATURE)
        assert part.source == ALL_BEAMS
        by_temperature[name] = math.sqrt(part.covariance[0, 0])
    assert by_temperature["stated"] == pytest.approx(along / math.sqrt(3.0), rel=1e-3)
    assert by_temperature["cold"] == pytest.approx(0.1 * by_temperature["stated"], rel=1e-9)


def test_errors_of_stamps_are_rectangular_within_their_bound() -> None:
    model = ArmUncertainty(load_arm_file(ARMS / "five_axis" / "arm.yaml"))
    (found,) = model.at(np.array([ANGLES["five_axis"]]), stamp_shifts=np.full((1, 6), 3e-6))
    (stamps,) = (each for each in found.components if each.kind is Kind.STAMPS)
    np.testing.assert_allclose(stamps.covariance, 3e-12 * np.eye(6))


def test_the_mean_of_scans_has_less_noise_and_the_same_calibration() -> None:
    model = ArmUncertainty(load_arm_file(ARMS / "five_axis" / "arm.yaml"))
    one, many = (model.at(np.array([ANGLES["five_axis"]]), scans=scans)[0] for scans in (1, 16))
    for before, after in zip(one.components, many.components, strict=True):
        factor = 16.0 if before.kind is Kind.RANDOM else 1.0
        np.testing.assert_allclose(before.covariance, factor * after.covariance, rtol=1e-12)


def test_coverage_factors_are_those_of_the_guides() -> None:
    """Welch-Satterthwaite (JCGM 100, G.2b): 9 degrees of freedom of one half of the variance are 36."""
    half = [Component("a", Kind.RANDOM, np.eye(6), 9.0), Component("b", Kind.SYSTEMATIC, np.eye(6))]
    found = EndpointUncertainty.of({}, pin.SE3.Identity(), half)
    np.testing.assert_allclose(found.freedoms, 36.0)
    np.testing.assert_allclose(found.factors, t.ppf(0.975, 36.0), rtol=1e-6)
    np.testing.assert_allclose(found.standard, math.sqrt(2.0))
    squared = 3.0 * 36.0 / 34.0 * f.ppf(0.95, 3, 34)
    np.testing.assert_allclose(np.square(found.ellipsoid), 2.0 * squared, rtol=1e-9)
    assert found.largest == pytest.approx(math.sqrt(2.0) * t.ppf(0.975, 36.0))
    assert region_factor(math.inf) == pytest.approx(math.sqrt(chi2.ppf(0.95, 3)))
    assert region_factor(1e9) == pytest.approx(region_factor(math.inf), rel=1e-6)
    assert region_factor(2.0) == math.inf


def test_the_fewest_freedoms_of_a_fit_are_those_of_the_calibration() -> None:
    arm = load_arm_file(ARMS / "five_axis" / "arm.yaml")
    calibration = arm.calibration("elbow")
    assert calibration_freedoms(calibration) == math.inf
    residuals = {"readings": 20, "parameters": 5, "spread": 1.0, "probability": 0.5, "outliers": 0}
    fits = [
        {
            "procedure": "by_hand", "method": "by hand", "date": "2026-01-01T00:00:00Z",
            "replaced": ["sensors[0].probes[0].tip"],
            "recording": {"name": "none", "sha256": ""}, "residuals": {"tip": {**residuals, "freedoms": freedoms}},
        }
        for freedoms in (15, 7, 0)
    ]  # fmt: skip
    kind = type(calibration)
    fitted = kind.model_validate({**calibration.model_dump(mode="json"), "fits": fits})
    assert calibration_freedoms(fitted) == 7.0
