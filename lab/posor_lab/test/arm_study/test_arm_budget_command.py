# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Budget of the five-axis arm against the printed figures of the thesis."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posor.chain.arm_file import load_arm_file
from posor.errors import DataFileError, ParameterError, PosorError
from posor_lab.arm_study.arm_budget_command import (
    ENDPOINT_FILE,
    FIGURES,
    JOINTS_FILE,
    NOISE,
    THESIS,
    WHOLE,
    arm_budget,
    main,
    read_endpoint,
    read_joints,
    thesis_covariance,
)
from posor_lab.harness.rig_files import share
from posor_lab.thesis_data import data_path, read_table
from scipy.constants import inch

ARMS = share() / "arms"
DRAWS = 1_500
CASES = (THESIS, NOISE, WHOLE)
CONFIGURATIONS = ("extended", "bent")
TURNS, SHIFTS = FIGURES[:3], FIGURES[3:6]
# Section 9.4: moment arms [in] of the joints, base to wrist, along X; the last link, along Y when the wrist is bent.
EXTENDED_IN = np.array([76.0, 76.0, 46.0, 26.0, 16.0])
LAST_IN = 16.0
PEDESTAL_IN = 6.0  # assumed


@pytest.fixture(scope="module")
def budgets() -> dict[str, dict[str, Any]]:
    return arm_budget(load_arm_file(ARMS / "five_axis" / "arm.yaml"), DRAWS)


@pytest.fixture(scope="module")
def turns() -> np.ndarray:
    """Accuracy of each joint about X, Y, Z of the base [urad], shape (5, 3), not rounded."""
    large_about = (2, 1, 1, 0, 2)
    rows = []
    for diameter, axis in zip(read_joints(data_path(JOINTS_FILE)).values(), large_about, strict=True):
        small, large = np.sqrt(np.diagonal(thesis_covariance(diameter)))[[3, 5]] * 1e6
        rows.append([large if about == axis else small for about in range(3)])
    return np.array(rows)


def rss(*terms: np.ndarray) -> float:
    return float(np.sqrt(sum(float(np.sum(np.square(term))) for term in terms)))


def test_joints_accuracies_are_the_printed_ones_to_their_last_digit() -> None:
    joints = read_joints(data_path(JOINTS_FILE)).items()
    columns = ("small_dof_accuracy_urad", "large_dof_accuracy_urad")
    for (name, diameter), row in zip(joints, read_table(data_path(JOINTS_FILE), columns), strict=True):
        computed = np.sqrt(np.diagonal(thesis_covariance(diameter)))[[3, 5]] * 1e6
        assert computed == pytest.approx([float(row[column]) for column in columns], abs=0.005), name


@pytest.mark.parametrize("configuration", CONFIGURATIONS)
def test_orientation_is_the_printed_one(budgets: dict[str, dict[str, Any]], configuration: str) -> None:
    printed = read_endpoint(data_path(ENDPOINT_FILE))[configuration]
    budget = [budgets[configuration][name] for name in TURNS]
    np.testing.assert_allclose(budget, [printed[name] for name in TURNS], rtol=0.0, atol=0.05)
    np.testing.assert_allclose(budget, [4.43, 4.20, 5.77], rtol=0.0, atol=0.005)


def test_extended_displacement_is_the_printed_one_within_two_percent(budgets: dict[str, dict[str, Any]]) -> None:
    printed = read_endpoint(data_path(ENDPOINT_FILE))["extended"]["displacement_uin"]
    assert budgets["extended"]["displacement_uin"] == pytest.approx(printed, rel=0.02)


def test_displacements_equal_sums_by_hand(budgets: dict[str, dict[str, Any]], turns: np.ndarray) -> None:
    """Turn times arm: dX = aY z - aZ y, dY = aZ x - aX z, dZ = aX y - aY x; 0.735 mm at each joint is left out."""
    for configuration in CONFIGURATIONS:
        bent = configuration == "bent"
        x = EXTENDED_IN - (LAST_IN if bent else 0.0)
        y = np.full(5, LAST_IN if bent else 0.0)
        z = np.array([PEDESTAL_IN, 0.0, 0.0, 0.0, 0.0])
        a_x, a_y, a_z = turns.T
        expected = [rss(a_y * z, a_z * y), rss(a_z * x, a_x * z), rss(a_x * y, a_y * x)]
        budget = [budgets[configuration][name] for name in SHIFTS]
        np.testing.assert_allclose(budget, expected, rtol=0.002, atol=0.3)


def test_printed_extended_components_follow_from_two_terms_counted_along_other_axes(turns: np.ndarray) -> None:
    """The elbow's turn about Z counted along Z instead of Y, and the yaw's small turn along X beside its own axis."""
    _, a_y, a_z = turns.T
    elbow, yaw = 2, 4
    others = np.arange(5) != elbow
    d_x = abs(a_y[yaw]) * LAST_IN
    d_y = rss((a_z * EXTENDED_IN)[others])
    d_z = rss(a_y * EXTENDED_IN, a_z[elbow] * EXTENDED_IN[elbow])
    printed = read_endpoint(data_path(ENDPOINT_FILE))["extended"]
    np.testing.assert_allclose([d_x, d_y, d_z], [printed[name] for name in SHIFTS], rtol=0.0, atol=0.51)
    assert rss(np.array([d_x, d_y, d_z])) == pytest.approx(printed["displacement_uin"], abs=0.5)


@pytest.mark.parametrize("configuration", CONFIGURATIONS)
@pytest.mark.parametrize("case", CASES)
def test_drawn_errors_agree_with_the_budget_within_five_percent(
    budgets: dict[str, dict[str, Any]], configuration: str, case: str
) -> None:
    budget = budgets[configuration][case]
    drawn = [budget["monte_carlo"][name] for name in FIGURES]
    np.testing.assert_allclose(drawn, [budget[name] for name in FIGURES], rtol=0.05)


@pytest.mark.parametrize("configuration", CONFIGURATIONS)
@pytest.mark.parametrize("case", CASES)
def test_contributions_are_ranked_and_add_up(budgets: dict[str, dict[str, Any]], configuration: str, case: str) -> None:
    budget = budgets[configuration][case]
    totals = [part["displacement_uin"] for part in budget["contributions"]]
    assert totals == sorted(totals, reverse=True)
    assert math.hypot(*totals) == pytest.approx(budget["displacement_uin"])
    assert len(totals) == (6 if case == WHOLE else 5)


def test_noise_is_of_the_size_of_the_thesis(budgets: dict[str, dict[str, Any]]) -> None:
    """The noise of all three probes makes a lean: sqrt(1.5) of section 9.3.1, and nearly so for theta."""
    for configuration in CONFIGURATIONS:
        ratio = budgets[configuration][NOISE]["displacement_uin"] / budgets[configuration]["displacement_uin"]
        assert 1.0 < ratio < math.sqrt(1.5)
        assert budgets[configuration][WHOLE]["displacement_uin"] > budgets[configuration][NOISE]["displacement_uin"]


def test_distances_of_the_posors_from_the_grip() -> None:
    chain = load_arm_file(ARMS / "five_axis" / "arm.yaml").chain()
    angles = dict.fromkeys((joint.name for joint in chain.joints), 0.0)
    end = chain.nominal_endpoint(angles).translation
    pose = chain.links[0].T_nominal
    distances = []
    for joint, link in zip(chain.joints, chain.links[1:], strict=True):
        pose = pose * chain.nominal_joint(joint.name, 0.0)
        distances.append(float(end[0] - pose.translation[0]) / 0.0254)
        pose = pose * link.T_nominal
    np.testing.assert_allclose(distances, EXTENDED_IN, rtol=0.0, atol=1e-9)


def test_arm_that_is_not_the_thesis_has_its_own_models_only() -> None:
    budget = arm_budget(load_arm_file(ARMS / "six_axis" / "arm.yaml"), 200)
    assert list(budget) == list(CONFIGURATIONS)
    for case in budget.values():
        assert THESIS not in case
        assert "printed" not in case
        assert case["displacement_uin"] == case[WHOLE]["displacement_uin"]


def test_a_copy_of_the_arm_of_the_thesis_may_differ_and_is_not_compared(tmp_path: Path) -> None:
    folder = shutil.copytree(ARMS / "five_axis", tmp_path / "five_axis")
    case = arm_budget(load_arm_file(folder / "arm.yaml"), 2)["extended"]
    assert "printed" not in case
    assert THESIS not in case
    assert case["displacement_uin"] == case[WHOLE]["displacement_uin"]


def test_program_prints_the_budget_and_writes_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The test rig's two light sources leave their diodes long before a right angle: it has no bent configuration."""
    output = tmp_path / "new" / "budget.json"
    assert main(["--arm", str(ARMS / "test_rig" / "arm.yaml"), "--output", str(output), "--draws", "100"]) == 0
    written = json.loads(output.read_text(encoding="utf-8"))
    assert list(written) == ["extended"]
    assert written["extended"]["displacement_uin"] > 0.0
    printed = capsys.readouterr().out
    assert f"{written['extended'][WHOLE]['displacement_uin']:.1f}" in printed


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--draws", "0"], "arm_budget: argument --draws: '0' is not a whole number in digits of at least 1; expected"),
        (["--arms", "x"], "arm_budget: unrecognized arguments: --arms x; expected options as"),
        (["--arm", "no/arm.yaml"], "arm 'no/arm.yaml': no such arm; expected the path of an arm file"),
    ],
)
def test_wrong_command_line_is_refused_with_a_sentence(
    arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) != 0
    complaint = capsys.readouterr().err
    assert complaint.startswith(sentence)
    assert complaint.count("\n") == 1


def test_table_without_the_bent_wrist_is_refused(tmp_path: Path) -> None:
    lines = data_path(ENDPOINT_FILE).read_text(encoding="utf-8").splitlines()
    table = tmp_path / "endpoint.csv"
    table.write_text("\n".join(line for line in lines if "bent" not in line), encoding="utf-8")
    with pytest.raises(DataFileError, match=r"endpoint\.csv: no row of section 9\.3\.1 for 'bent wrist'\."):
        read_endpoint(table)


def test_invalid_number_is_named(tmp_path: Path) -> None:
    text = data_path(JOINTS_FILE).read_text(encoding="utf-8").replace("elbow,6,", "elbow,six,")
    table = tmp_path / "joints.csv"
    table.write_text(text, encoding="utf-8")
    with pytest.raises(PosorError, match=r"elbow, column 'posor_od_in': 'six' is not a number; expected a number\."):
        read_joints(table)


def test_the_thesis_accuracies_are_those_of_section_931() -> None:
    """8 in: 1.67 and 0.95 urad; 4 in: 5.0 and 2.22 urad; no translations."""
    for diameter_in, large, small in ((8.0, 1.67, 0.95), (4.0, 5.0, 2.22)):
        covariance = thesis_covariance(diameter_in * inch)
        assert np.count_nonzero(covariance) == 3
        np.testing.assert_allclose(np.sqrt(np.diagonal(covariance))[3:] * 1e6, [small, small, large], atol=0.005)


@pytest.mark.parametrize("diameter", [0.0, 2.0 * inch, math.nan])
def test_a_diameter_without_room_for_a_ring_is_refused(diameter: float) -> None:
    with pytest.raises(ParameterError, match=r"outside diameter .* m; expected at least 0\.0762 m\."):
        thesis_covariance(diameter)
