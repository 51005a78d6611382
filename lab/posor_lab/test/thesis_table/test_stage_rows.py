"""Rows of stages, machines and setups: reasons and plots."""

from __future__ import annotations

import pytest
from posor_lab.thesis_table import stage_rows

from .find_row import find_row


def test_the_rows_follow_from_the_gauge_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another input gives another number, which no longer agrees and has no reason."""
    monkeypatch.setattr(stage_rows, "GAUGE_ERROR", 0.5 * stage_rows.GAUGE_ERROR)
    with pytest.raises(
        ValueError, match=r"zero error of gauge blocks: printed '\.02', computed 0\.01; expected a reason"
    ):
        stage_rows.rows()


def test_the_maps_that_are_lost_are_named() -> None:
    assert "their coefficients are lost" in find_row(stage_rows.rows(), "8.3.3", "interpolation error").reason


def test_plots_have_the_numbers_of_the_calculators() -> None:
    straightness, zero = stage_rows.plots()
    assert "run 1,0,-0.000322" in straightness.csv
    assert "run 6,0.75,0.008968" in straightness.csv
    assert "probe 1,0.02,-350.4" in zero.csv
