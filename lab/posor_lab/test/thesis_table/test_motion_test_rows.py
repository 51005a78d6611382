"""Rows of chapter 8: no computed number is typed; plots."""

from __future__ import annotations

import pytest
from posor_lab.replay_1985.printed_results import EndOfBeamResults, EndOfBeamTest, read_end_of_beam
from posor_lab.thesis_budgets import motion_predictions
from posor_lab.thesis_table import end_of_beam_rows, motion_summary_rows, motion_test_rows, prediction_rows
from posor_lab.thesis_table.thesis_row import ThesisRow, Verdict

from .find_row import find_row


def test_table_8_2_is_reported_missing() -> None:
    missing = [row for row in motion_test_rows.rows() if row.section == "Table 8.2"]
    assert len(missing) == 26
    assert all(row.verdict is Verdict.NOT_LEGIBLE and "table 8.2 is not in the scan" in row.reason for row in missing)


@pytest.mark.parametrize(
    ("name", "value", "section", "quantity", "factor"),
    [
        ("STAGE_STRAIGHTNESS", 0.0008, "8.4.4", "alpha, random", 1.0),
        ("READOUT", 0.0004, "8.2", "alpha, error of the machining centre", 2.0),
        ("BEARING_RUNOUT", 100e-6, "8.2", "alpha, runout of the twist stage", 2.0),
        ("DIODE_RANGE", 0.25, "8.4.4", "TWIS: z, terms of table 7.9", 2.0),
    ],
)
def test_predictions_follow_their_inputs(
    monkeypatch: pytest.MonkeyPatch, name: str, value: float, section: str, quantity: str, factor: float
) -> None:
    before = find_row(prediction_rows.prediction_rows(), section, quantity)
    monkeypatch.setattr(motion_predictions, name, value)
    # A changed number no longer agrees, so that its row may need a reason: the row itself is not built.
    monkeypatch.setattr(ThesisRow, "__post_init__", lambda _row: None)
    after = find_row(prediction_rows.prediction_rows(), section, quantity)
    assert after.computed == pytest.approx(factor * before.computed)


def test_sigma_z_and_y_follow_the_budgets(monkeypatch: pytest.MonkeyPatch) -> None:
    before = prediction_rows.prediction_rows()
    budget = motion_predictions.diode_budget
    monkeypatch.setattr(ThesisRow, "__post_init__", lambda _row: None)
    monkeypatch.setattr(motion_predictions, "diode_budget", lambda column: 2.0 * budget(column))
    after = prediction_rows.prediction_rows()
    quantity = "sigma_Z of the POSOR"
    assert find_row(after, "8.4", quantity).computed == pytest.approx(2.0 * find_row(before, "8.4", quantity).computed)


def test_figures_of_the_legible_tables_follow_the_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    def doubled(test: EndOfBeamTest) -> EndOfBeamResults:
        results = read_end_of_beam(test)
        return EndOfBeamResults(results.measured, results.measured + 2.0 * results.errors)

    before = end_of_beam_rows.printed_deviation("GEN", end_of_beam_rows.ALPHA)
    monkeypatch.setattr(end_of_beam_rows, "read_end_of_beam", doubled)
    assert end_of_beam_rows.printed_deviation("GEN", end_of_beam_rows.ALPHA) == pytest.approx(2.0 * before)


def test_averages_follow_the_errors_of_the_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    stated = motion_summary_rows.stated_error
    monkeypatch.setattr(ThesisRow, "__post_init__", lambda _row: None)
    monkeypatch.setattr(motion_summary_rows, "stated_error", lambda *cell: 2.0 * stated(*cell))
    average = find_row(
        motion_summary_rows.motion_summary_rows(), "8.5", "average error at the end of the beam, probes, by the p"
    )
    assert average.computed == pytest.approx(2.0 * 0.0006251, rel=1e-3)


def test_plots_show_every_motion_and_its_error() -> None:
    titles = [plot.title for plot in motion_test_rows.plots()]
    assert len(set(titles)) == len(titles) == 30
    for number in (15, 16, 17, 18, 19, 20):
        assert [title[:12] for title in titles if title.startswith(f"Figure 8.{number}")] == [
            f"Figure 8.{number}A",
            f"Figure 8.{number}B",
        ]
    (error,) = (plot for plot in motion_test_rows.plots() if plot.title.startswith("Figure 8.18B"))
    assert '"as printed, zero shifts (0, .2, .3) V",10,393' in error.csv
