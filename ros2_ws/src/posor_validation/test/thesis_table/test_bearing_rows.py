"""Rows and plot of ball bearings (6.2.3.3, App. 6B): figures, verdicts, and that they follow from the input."""

from __future__ import annotations

import csv

import pytest
from posor_validation.thesis_table import bearing_rows
from posor_validation.thesis_table.thesis_row import Verdict

from .find_row import find_row

AGREES, DIFFERS = Verdict.AGREES, Verdict.DIFFERS


@pytest.mark.parametrize(
    ("section", "quantity", "printed", "computed", "verdict"),
    [
        ("6.2.3.3", "load of a ball", "2.2", 2.2143, AGREES),
        ("6.2.3.3", "stress of the yoke bearing", "123", 122.71, AGREES),
        ("6.2.3.3", "stress, steel ball on races of Delrin", "12", 12.014, AGREES),
        ("6.2.3.3", "stress, ball and races of brass", "78", 78.393, AGREES),
        ("6.2.3.3", "stress of the Kaydon bearing", "154", 151.08, AGREES),
        ("App. 6B", "coefficient of the large half axis at 30 deg", "2.730", 2.7306, AGREES),
        ("App. 6B", "coefficient of the large half axis at 60 deg", "1.491", 1.4858, AGREES),
        ("App. 6B", "coefficient of the large half axis at 90 deg", "1.012", 1.0, AGREES),
        ("App. 6B", "greatest shear stress", ".3", 0.31305, AGREES),
    ],
)
def test_figures(section: str, quantity: str, printed: str, computed: float, verdict: Verdict) -> None:
    row = find_row(bearing_rows.rows(), section, quantity)
    assert row.printed == printed
    assert row.computed == pytest.approx(computed, rel=1e-3)
    assert row.verdict is verdict


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
