"""Rows of section 9.3: figures, verdicts, and that they follow from accuracies, distances and added errors."""

from __future__ import annotations

import numpy as np
import pytest
from posor_validation.thesis_table import arm_rows
from posor_validation.thesis_table.thesis_row import ThesisRow, Verdict

from .find_row import find_row

AGREES, DIFFERS = Verdict.AGREES, Verdict.DIFFERS


@pytest.fixture(scope="module")
def rows() -> list[ThesisRow]:
    return arm_rows.rows()


@pytest.mark.parametrize(
    ("section", "quantity", "computed", "verdict"),
    [
        ("9.3.3", "fully extended: dx, 50 and 18 uin added", 61.6, AGREES),
        ("9.3.3", "fully extended: dy, 50 and 18 uin added", 180.0, AGREES),
        ("9.3.3", "fully extended: dz, 50 and 18 uin added", 210.8, AGREES),
        ("9.3.3", "fully extended: total, 50 and 18 uin added to the printed", 284.0, AGREES),
        ("9.3.3", "bent wrist: dx, 50 and 18 uin added", 88.5, AGREES),
        ("9.3.3", "bent wrist: dy, 50 and 18 uin added", 141.4, AGREES),
        ("9.3.3", "bent wrist: dz, 50 and 18 uin added", 197.3, AGREES),
        ("9.3.3", "bent wrist: total, 50 and 18 uin added to the printed", 258.3, AGREES),
        ("9.3.3", "fully extended: total, 50 and 18 uin added to the components of the exact", 281.4, AGREES),
        ("9.3.3", "bent wrist: total, 50 and 18 uin added to the components of the exact", 236.8, DIFFERS),
        ("9.3.1", "fully extended: displacement", 266.5, AGREES),
        ("9.3.1", "fully extended: dx", 5.72, DIFFERS),
        ("9.3.1", "bent wrist: displacement", 218.9, DIFFERS),
        ("9.3.1", "bent wrist: root sum square", 242.1, AGREES),
        ("9.3.2", "endpoint, deformation", 17.95, AGREES),
        ("9.3.1", "base swivel: large rotation by the formula", 0.833, DIFFERS),
        ("9.3.1", "wrist yaw, POSOR of 4 in: small rotations", 2.222, AGREES),
    ],
)
def test_figures(rows: list[ThesisRow], section: str, quantity: str, computed: float, verdict: Verdict) -> None:
    row = find_row(rows, section, quantity)
    assert row.computed == pytest.approx(computed, rel=2e-3)
    assert row.verdict is verdict


def test_the_print_of_the_extended_arm_follows_from_two_terms_along_other_axes() -> None:
    np.testing.assert_allclose(arm_rows.extended_as_printed(), [35.6, 171.9, 203.5], rtol=0.0, atol=0.05)


def test_the_budget_of_this_project_is_labelled_as_assumed(rows: list[ThesisRow]) -> None:
    own = [row for row in rows if "this project's sensor models" in row.quantity]
    assert len(own) == 8
    assert all("assumed" in row.quantity and "assumed" in row.reason for row in own)
    assert find_row(own, "9.3.3", "fully extended: displacement").computed > 284.0


def test_added_errors_act_across_the_beams(monkeypatch: pytest.MonkeyPatch) -> None:
    none = np.zeros(3)
    np.testing.assert_allclose(arm_rows.with_calibration_and_beams(none), [50.0, 53.14, 53.14], atol=0.01)
    monkeypatch.setattr(arm_rows, "CALIBRATION_ERROR", 0.0)
    np.testing.assert_allclose(arm_rows.with_calibration_and_beams(none), [0.0, 18.0, 18.0])


def test_plots_name_every_joint() -> None:
    extended, bent = arm_rows.plots()
    for name in ("base_swivel", "shoulder", "elbow", "wrist_roll", "wrist_yaw"):
        assert name in extended.csv
        assert name in bent.csv
