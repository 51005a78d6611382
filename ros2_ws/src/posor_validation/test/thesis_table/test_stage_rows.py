"""Rows of stages, machines and setups: figures, verdicts, reasons, and the plots."""

from __future__ import annotations

import pytest
from posor_validation.thesis_table import stage_rows
from posor_validation.thesis_table.thesis_row import ThesisRow, Verdict

from .find_row import find_row

AGREES, DIFFERS = Verdict.AGREES, Verdict.DIFFERS


@pytest.fixture(scope="module")
def rows() -> list[ThesisRow]:
    return stage_rows.rows()


@pytest.mark.parametrize(
    ("section", "quantity", "computed", "verdict"),
    [
        ("7.2", "thermal growth over 0.5 in", 0.3, AGREES),
        ("7.2", "thermal growth over 2 in", 1.2, AGREES),
        ("7.2", "thermal growth over 10 in", 6.0, AGREES),
        ("7.2", "interferometer, .9997300 to .9997350", 5.0, AGREES),
        ("7.2", "interferometer, .9997300 to .9997310", 1.0, AGREES),
        ("7.2", "stage: mean deviation", 0.0004078, AGREES),
        ("7.2", "stage: repeatability", 0.0004225, DIFFERS),
        ("7.2", "cosine error of .002", 2.0, DIFFERS),
        ("7.4", "angle between diode", 0.005477, AGREES),
        ("7.4", "cosine error of this angle", 9.375, AGREES),
        ("7.4", "orthogonality", 0.002828, AGREES),
        ("7.4.1", "growth of the laser block", 5.25, AGREES),
        ("7.4.2", "Abbe error", 50.0, AGREES),
        ("7.4.3", "Abbe error", 19.39, DIFFERS),
        ("8.3.1", "target plane, angle about X", 2.532, AGREES),
        ("8.3.1", "target plane, angle about Z", 3.14, AGREES),
        ("8.3.1", "zero error of gauge blocks", 0.02, AGREES),
        ("8.3.1", "probe 1: error over .7 V by .02 V", 350.4, AGREES),
        ("8.3.1", "probe 2: error over .7 V by .02 V", 264.9, AGREES),
        ("8.3.1", "probe 3: error over .7 V by .02 V", 175.8, AGREES),
        ("8.3.1", "probe 1: error over .7 V by .001 V", 17.3, DIFFERS),
        ("8.3.1", "probe 2: error over .7 V by .001 V", 12.9, DIFFERS),
        ("8.3.3", "interpolation error", 0.2505, AGREES),
        ("8.2", "beta, theta", 6.35, AGREES),
        ("8.2", "error over .3 in", 9.52e-5, AGREES),
        ("8.3.3", "multiplications", 429.0, AGREES),
        ("8.3.3", "time of these", 0.01287, AGREES),
        ("8.3.3", "time of 11 conversions", 0.0011, DIFFERS),
    ],
)
def test_figures(rows: list[ThesisRow], section: str, quantity: str, computed: float, verdict: Verdict) -> None:
    row = find_row(rows, section, quantity)
    assert row.computed == pytest.approx(computed, rel=3e-3)
    assert row.verdict is verdict


def test_the_rows_follow_from_the_gauge_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another input gives another number, which no longer agrees and has no reason."""
    monkeypatch.setattr(stage_rows, "GAUGE_ERROR", 0.5 * stage_rows.GAUGE_ERROR)
    with pytest.raises(
        ValueError, match=r"zero error of gauge blocks: printed '\.02', computed 0\.01; expected a reason"
    ):
        stage_rows.rows()


def test_the_maps_that_are_lost_are_named(rows: list[ThesisRow]) -> None:
    assert "their coefficients are lost" in find_row(rows, "8.3.3", "interpolation error").reason


def test_plots_have_the_numbers_of_the_calculators() -> None:
    straightness, zero = stage_rows.plots()
    assert "run 1,0,-0.000322" in straightness.csv
    assert "run 6,0.75,0.008968" in straightness.csv
    assert "probe 1,0.02,-350.4" in zero.csv
