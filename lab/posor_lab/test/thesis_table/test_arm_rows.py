"""Rows of section 9.3 follow from accuracies, distances and added errors; plots."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor_lab.thesis_table import arm_rows

from .find_row import find_row

if TYPE_CHECKING:
    import pytest


def test_the_print_of_the_extended_arm_follows_from_two_terms_along_other_axes() -> None:
    np.testing.assert_allclose(arm_rows.extended_as_printed(), [35.6, 171.9, 203.5], rtol=0.0, atol=0.05)


def test_the_budget_of_this_project_is_labelled_as_assumed() -> None:
    own = [row for row in arm_rows.rows() if "this project's sensor models" in row.quantity]
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
