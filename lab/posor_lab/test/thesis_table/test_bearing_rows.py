"""Rows and plot of ball bearings (6.2.3.3, App. 6B) follow from the input."""

from __future__ import annotations

import csv

import pytest
from posor_lab.thesis_table import bearing_rows

from .find_row import find_row


def test_rows_follow_from_the_input_of_the_text(monkeypatch: pytest.MonkeyPatch) -> None:
    before = bearing_rows.rows()
    monkeypatch.setattr(bearing_rows, "BALL_LOAD", 8.0 * bearing_rows.BALL_LOAD)
    for quantity in ("stress of the yoke bearing", "stress, steel ball on races of Delrin", "stress, ball and races"):
        changed = find_row(bearing_rows.rows(), "6.2.3.3", quantity).computed
        assert changed == pytest.approx(2.0 * find_row(before, "6.2.3.3", quantity).computed, rel=1e-9)


def test_the_plot_shows_that_stress_rises_with_conformity() -> None:
    (plot,) = bearing_rows.plots()
    lines = list(csv.reader(plot.csv.splitlines()[1:]))
    for material in ("steel", "brass", "steel on Delrin"):
        stresses = [float(stress) for name, _, stress in lines if name == material]
        assert len(stresses) == 31
        assert stresses == sorted(stresses)
        assert len([name for name, _, _ in lines if name == f"{material}, printed"]) == 1
