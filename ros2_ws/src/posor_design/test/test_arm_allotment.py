# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Allotment: the endpoint meets its requirement through the exact chain, with the least effort; refusals."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from posor.chain.arm_file import ArmFile, load_arm_file
from posor.chain.beams_file import load_beams
from posor.chain.kinematic_chain import Chain
from posor.errors import DesignError
from posor.uncertainty.budget_poses import model_covariances
from posor.uncertainty.common_errors import CommonErrors
from posor_design.arm_allotment import Allotment, EndpointWeights, allot, beams_with
from posor_design.arm_output import joint_requirements, urdf_with_gaps
from posor_design.design_command import main
from posor_design.endpoint_budget import configurations, endpoint_budget
from posor_design.requirement import load_requirement
from posor_lab.arm_study.endpoint_monte_carlo import monte_carlo

ARM_FILE = Path(__file__).resolve().parents[2] / "posor_bringup" / "arms" / "five_axis" / "arm.yaml"
REQUIRED = np.array([15e-6] * 3 + [8e-6] * 3)


@cache
def arm() -> ArmFile:
    return load_arm_file(ARM_FILE)


@cache
def allotment() -> Allotment:
    return allot(arm(), REQUIRED, list(configurations(list(arm().calibrations)).values()))


def chain_and_covariances(own: Allotment) -> tuple[Chain, dict[str, np.ndarray]]:
    """Return the chain with the allotted beams and the shared terms, and the allotted covariances of the joints."""
    sigmas = {(group.part, group.what): sigma for group, sigma in zip(own.groups, own.allotted, strict=True)}

    def variances(part: str) -> np.ndarray:
        return np.square([sigmas[part, "translations"]] * 3 + [sigmas[part, "angles"]] * 3)

    assert arm().beams is not None
    beams = load_beams(arm().beams)  # type: ignore[arg-type]
    allotted = beams_with(beams, {beam.joint: variances(beam.joint) for beam in beams.beams})
    chain = Chain(arm().chain().urdf, arm().endpoint_frame, own.errors.beams_with(allotted))
    return chain, {joint.name: np.diag(variances(joint.name)) for joint in chain.joints}


def test_the_endpoint_meets_the_requirement_through_the_exact_chain() -> None:
    chain, covariances = chain_and_covariances(allotment())
    for posture, stated in zip(allotment().postures, allotment().endpoint, strict=True):
        spread = endpoint_budget(chain, posture, covariances).spread
        found = np.concatenate([spread.displacement, spread.orientation])
        np.testing.assert_allclose(found, stated, rtol=1e-3)
        assert np.all(found <= 1.001 * REQUIRED)
    drawn = monte_carlo(chain, allotment().postures[0], covariances, 1000, 7)
    np.testing.assert_allclose(drawn.displacement, allotment().endpoint[0, :3], rtol=0.1)


def test_errors_of_the_calibrating_laboratory_leave_less_for_the_parts() -> None:
    """Of 21 um along X, 20 um are those of temperature and scale of all beams; the joints' terms are below 3 %."""
    required, errors = np.array([21e-6, 90e-6, 90e-6, 90e-6, 90e-6, 90e-6]), CommonErrors(1e-6, 0.45)
    free, own = (allot(arm(), required, allotment().postures, each) for each in (CommonErrors(), errors))
    assert np.sum(own.present / own.allotted) > 1.1 * np.sum(free.present / free.allotted)
    chain, covariances = chain_and_covariances(own)
    for posture, stated in zip(own.postures, own.endpoint, strict=True):
        spread = endpoint_budget(chain, posture, covariances).spread
        np.testing.assert_allclose([*spread.displacement, *spread.orientation], stated, rtol=3e-2)
        assert np.all(stated <= 1.001 * required)


def test_some_axis_uses_the_whole_requirement_and_shares_add_up() -> None:
    assert np.max(allotment().endpoint / REQUIRED) == pytest.approx(1.0, abs=1e-3)
    assert 0.9 < np.sum(allotment().shares) <= 1.0 + 1e-9


def test_no_other_allotment_within_the_requirement_has_less_effort(rng: np.random.Generator) -> None:
    own = allotment()
    weights = EndpointWeights(arm(), own.postures)
    least = np.sum(own.present / own.allotted)
    for _ in range(300):
        other = own.allotted * np.exp(0.2 * rng.normal(size=len(own.allotted)))
        low = np.max(weights.endpoint(other) / REQUIRED)  # scaled until an axis uses the whole requirement
        other /= low
        if np.all(weights.endpoint(other) <= REQUIRED * (1.0 + 1e-9)):
            assert np.sum(own.present / other) >= least * (1.0 - 1e-6)


def test_the_present_uncertainty_of_a_part_is_that_of_its_worst_axis() -> None:
    own, calibrations = allotment(), {name: arm().calibration(name) for name in arm().calibrations}
    present = {(group.part, group.what): sigma for group, sigma in zip(own.groups, own.present, strict=True)}
    models = [model_covariances(calibrations, arm().chain(), posture) for posture in own.postures]
    for name in calibrations:
        sigmas = np.max([np.sqrt(np.diagonal(model.own()[name])) for model in models], axis=0)
        assert present[name, "translations"] == pytest.approx(np.max(sigmas[:3]))
        assert present[name, "angles"] == pytest.approx(np.max(sigmas[3:]))


def test_the_present_endpoint_is_that_of_its_budget_axis_by_axis() -> None:
    calibrations = {name: arm().calibration(name) for name in arm().calibrations}
    for posture, before in zip(allotment().postures, allotment().before, strict=True):
        model = model_covariances(calibrations, arm().chain(), posture)
        spread = endpoint_budget(arm().chain(), posture, model.own(), model.shared).spread
        np.testing.assert_allclose(before, [*spread.displacement, *spread.orientation], rtol=1e-9)
        assert before[5] > 1.2 * before[3]  # theta of a POSOR is less certain than alpha


def test_longer_levers_get_smaller_angles() -> None:
    angles = [
        sigma for group, sigma in zip(allotment().groups, allotment().allotted, strict=True) if group.what == "angles"
    ]
    joints = dict(zip(arm().calibrations, angles[: len(arm().calibrations)], strict=True))
    assert joints["shoulder"] < joints["elbow"] < joints["wrist_yaw"]


def test_a_requirement_beyond_reach_is_refused_with_the_nearest() -> None:
    postures = allotment().postures
    with pytest.raises(DesignError) as refusal:
        allot(arm(), REQUIRED / 200.0, postures)
    assert re.search(r"is beyond reach .*: [\d.]+ (um|urad) if all parts were 10 times as good", str(refusal.value))
    nearest = {name: float(value) * 1e-6 for name, value in re.findall(r"--(\w+) ([\d.e-]+) u", refusal.value.expected)}
    required = np.array([nearest["displacement"]] * 3 + [nearest["orientation"]] * 3)
    assert np.all(allot(arm(), required, postures).endpoint <= 1.001 * required)
    with pytest.raises(DesignError):
        allot(arm(), 0.95 * required, postures)


def test_requirements_of_joints_have_the_plates_of_the_urdf() -> None:
    requirements = joint_requirements(arm(), allotment())
    assert requirements["shoulder"].outside_diameter.number == pytest.approx(8.0 * 0.0254)
    assert requirements["wrist_yaw"].outside_diameter.number == pytest.approx(4.0 * 0.0254)


def test_gaps_of_the_urdf_are_replaced() -> None:
    chain = Chain(urdf_with_gaps(arm().chain().urdf, {"elbow": 2.5e-4}), arm().endpoint_frame)
    assert chain.nominal_joint("elbow", 0.0).translation[2] == pytest.approx(2.5e-4)
    assert chain.nominal_joint("shoulder", 0.0).translation[2] == pytest.approx(7.35e-4)


def test_the_command_writes_a_requirement_for_each_joint(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["arm", str(ARM_FILE), "--displacement", "15 um", "--orientation", "8 urad"]
    assert main([*arguments, "--output", str(tmp_path / "out")]) == 0
    assert "shoulder" in capsys.readouterr().out
    for joint in arm().calibrations:
        assert load_requirement(tmp_path / "out" / joint / "requirement.yaml").name == joint
    assert not load_beams(tmp_path / "out" / "beams.yaml").shared
    terms = ["--length-scale", "1e-7", "--temperature", "10 mK", "--output", str(tmp_path / "terms")]
    assert main([*arguments, *terms]) == 0
    shared = load_beams(tmp_path / "terms" / "beams.yaml").shared
    assert [term.uncertainty.number for term in shared.values()] == [1e-7, 0.01]
    assert main([*arguments, "--output", str(tmp_path / "out")]) == 1
    assert "allotment.json exists already" in capsys.readouterr().err
