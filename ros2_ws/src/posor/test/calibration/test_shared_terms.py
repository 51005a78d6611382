# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Shared terms of calibration files: what is refused, and what the terms do to the parameters and to the pose."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from posor.calibration.calibration_file import Calibration, parse_calibration
from posor.calibration.designs import design
from posor.calibration.document_text import document_text
from posor.calibration.parameter_covariance import shared_effects, stated_covariance
from posor.calibration.shared_terms import check_same_terms
from posor.errors import CalibrationError
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.native_coordinates import rotation_from_native
from posor.uncertainty.budget_poses import middle_pose, scan_at
from posor.uncertainty.first_order import error_budget
from posor_lab.harness.case_tables import cases, edited, refusal

TERMS = """\
shared:
  temperature:
    uncertainty: {value: 0.5, unit: K}
    relative:
      sensors[1].ring.mean_radius: {value: 2.3e-5, unit: 1/K}
    change:
      sensors[0].probes[0].temperature.reference: {value: 2.0, unit: '1'}
      sensors[0].probes[1].tip: {value: [0.0, 0.0, 1.0e-6], unit: m/K}
  scale:
    uncertainty: {value: 1.0e-4, unit: '1'}
    relative:
      sensors[0].probes[1].tip: {value: 1.0, unit: '1'}
      sensors[1].probes[0].tip: {value: [1.0, 2.0, 0.0], unit: '1'}
      sensors[0].probes[2].volts_to_gap[0]: {value: 1.0, unit: '1'}
"""
THETA = 0.003
STEP = 1e-3


def file_text(terms: str = TERMS) -> str:
    return document_text(design("quad_bumpy_ring").model_dump(mode="json"), "test") + terms


def calibration(terms: str = TERMS) -> Calibration:
    return parse_calibration(file_text(terms), "test")


def test_a_term_changes_the_quantities_that_it_names() -> None:
    own = calibration()
    effects, posor = shared_effects(own), Posor(own)
    names = posor.stack.parameter_names
    changed = {(names[p], k): effects[p, k] for p, k in zip(*np.nonzero(effects), strict=True)}
    y = 0.0381  # of the second gap probe
    expected = {
        ("GapProbes.temperature[0,1]", 0): 1.0,
        ("GapProbes.tips[1,2]", 0): 5e-7,
        ("GapProbes.tips[1,1]", 1): 1e-4 * y,
        ("GapProbes.volts_to_gap[2,0]", 1): 1e-4 * 0.735e-3,
        ("BumpyRing.mean_radius[]", 0): 0.5 * 2.3e-5 * own.sensors[1].ring.mean_radius.number,  # type: ignore[attr-defined]
    }
    tip = own.sensors[1].probes[0].tip.array  # type: ignore[attr-defined]
    expected |= {("BumpyRing.tips[0,0]", 1): 1e-4 * tip[0], ("BumpyRing.tips[0,1]", 1): 2e-4 * tip[1]}
    assert changed == {key: pytest.approx(value, rel=1e-12) for key, value in expected.items() if value}
    np.testing.assert_allclose(
        stated_covariance(own), stated_covariance(calibration("")) + effects @ effects.T, rtol=1e-12, atol=1e-30
    )
    np.testing.assert_allclose(posor.parameter_square_root @ posor.parameter_square_root.T, stated_covariance(own))


def test_the_pose_moves_as_the_parameters_do_and_its_covariance_contains_the_terms() -> None:
    """Against a second POSOR whose parameters are off by one standard uncertainty of a term."""
    with_terms, without = Posor(calibration()), Posor(calibration(""))
    rotation = rotation_from_native(1e-4, -2e-4, THETA)
    place, warm = (rotation[None], np.array([[2e-5, 1e-5, 0.7e-3]]), np.ones(1, dtype=np.int64)), np.full(1, 293.15)
    scans = scans_at(without.stack, *place, temperatures=warm)
    found, other = (each.estimate_each(scans, np.array([THETA])) for each in (with_terms, without))
    effects = found.shared_effects[0, :2]
    for k, effect in enumerate(effects):
        below, above = (
            with_terms.with_parameter_values(
                with_terms.stack.parameter_values + step * with_terms.shared_effects[:, k]
            ).estimate_each(scans, np.array([THETA]))
            for step in (-STEP, STEP)
        )
        turn = pin.log3(above.rotations[0] @ below.rotations[0].T)
        moved = np.concatenate([above.translations[0] - below.translations[0], turn]) / (2.0 * STEP)
        np.testing.assert_allclose(moved, effect, rtol=1e-4, atol=1e-5 * np.abs(effect).max())
    added = found.covariances_systematic[0] - other.covariances_systematic[0]
    np.testing.assert_allclose(added, effects.T @ effects, rtol=1e-6, atol=1e-9 * np.abs(added).max())
    assert not other.shared_effects.any()
    assert found.residuals[0] < other.residuals[0] + 1e-9


@pytest.mark.parametrize(**cases(__file__, "shared_mistakes.yaml"))
def test_a_mistake_in_a_term_is_named(old: str, new: str, line: int, sentence: str) -> None:
    error = refusal(CalibrationError, parse_calibration, file_text(edited(TERMS, old, new)), "rig.yaml")
    begin = file_text("").count("\n")
    assert str(error).startswith(f"rig.yaml, line {begin + line}, key shared")
    assert sentence in str(error)


def test_terms_need_version_3_and_are_at_most_eight() -> None:
    former = design("quad_bumpy_ring").model_copy(update={"version": 2, "environment": None}).model_dump(mode="json")
    error = refusal(CalibrationError, parse_calibration, document_text(former, "test") + TERMS, "rig.yaml")
    assert (error.what, error.expected) == ("shared in a file of version 2", "version 3")
    one = TERMS.split("  scale:")[1]
    many = TERMS + "".join(f"  scale_{n}:{one}" for n in range(7))
    error = refusal(CalibrationError, parse_calibration, file_text(many), "rig.yaml")
    assert (error.what, error.expected) == ("9 shared terms", "at most 8")


def test_one_term_has_one_uncertainty_in_all_files_of_an_arm() -> None:
    files = {"a.yaml": calibration().shared, "b.yaml": calibration().shared}
    check_same_terms(files)
    files["c.yaml"] = calibration(edited(TERMS, "value: 0.5, unit: K", "value: 0.6, unit: K")).shared
    error = refusal(CalibrationError, check_same_terms, files)
    assert (error.where, error.expected) == ("c.yaml", "0.5 K, as in a.yaml")
    assert error.what == "shared term 'temperature' has the standard uncertainty 0.6 K"


def test_a_budget_lists_each_term_once() -> None:
    posor = Posor(calibration())
    pose = middle_pose(posor)
    budget = error_budget(posor, scan_at(posor, pose), pose)
    terms = {part.name for part in budget.contributions if part.name.startswith("shared: ")}
    assert terms == {"shared: temperature", "shared: scale"}
    assert not budget.correlated
    np.testing.assert_allclose(budget.root_sum_square(), budget.sigmas, rtol=1e-9)
