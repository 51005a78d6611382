"""Rows of chapter 8: figures, verdicts, and that no computed number is typed."""

from __future__ import annotations

import pytest
from posor_validation.replay_1985.end_of_beam_results import EndOfBeamResults, EndOfBeamTest, read_end_of_beam
from posor_validation.thesis_budgets import motion_predictions
from posor_validation.thesis_table import end_of_beam_rows, motion_summary_rows, motion_test_rows, prediction_rows
from posor_validation.thesis_table.thesis_row import ThesisRow, Verdict

from .find_row import find_row

AGREES, DIFFERS, NOT_LEGIBLE = Verdict.AGREES, Verdict.DIFFERS, Verdict.NOT_LEGIBLE


@pytest.fixture(scope="module")
def rows() -> list[ThesisRow]:
    return motion_test_rows.rows()


@pytest.mark.parametrize(
    ("section", "quantity", "printed", "computed", "verdict"),
    [
        ("8.4", "theta, stage straightness", "189", 188.6, AGREES),
        ("8.4.1", "ZMO: theta, stage straightness", "68", 67.9, AGREES),
        ("8.4.2", "YMO: theta, stage straightness", "53", 52.8, AGREES),
        ("8.4.3", "YZMO: theta, stage straightness", "45", 45.3, AGREES),
        ("8.4.4", "TWIS: z, peak of a linearisation curve", ".0045", 0.00456, AGREES),
        ("8.4.5", "GEN: theta, stage straightness", "120", 107.5, DIFFERS),
        ("8.4.5", "GEN: z by stage straightness", ".004008", 0.00359, DIFFERS),
        ("8.4", "sigma_Z of the POSOR", "3914", 3862.5, AGREES),
        ("8.4", "sigma_Y of the POSOR, increasing", "2505", 2462.8, AGREES),
        ("8.4.2", "YMO: alpha, error", "25", 24.5, AGREES),
        ("8.4.2", "YMO: beta, error", "4", 4.26, AGREES),
        ("8.4.3", "YZMO: theta, error against the machining centre, standard deviation", "92", 71.4, DIFFERS),
        ("App. 8B", "TWIS: alpha, standard deviation", "", 54.6, NOT_LEGIBLE),
        ("App. 8B", "TWIS: z, root mean square", "", 0.00372, NOT_LEGIBLE),
        ("App. 8B", "TWIS: y, root mean square", "", 0.00443, NOT_LEGIBLE),
        ("App. 8B", "GEN: alpha, standard deviation", "176", 177.8, AGREES),
        ("8.4.5", "GEN: z, largest error", ".0155", 0.015467, AGREES),
        ("Table 8.1", "GEN: z of the POSOR", ".301217", 0.2984, AGREES),
        ("8.5", "average error at the end of the beam, probes, by the printed", ".000625", 0.0006251, AGREES),
        ("8.5", "average error at the end of the beam, diodes", ".008929", 0.004695, DIFFERS),
        ("9.1", "average error at the end of the beam, diodes", ".0047", 0.004695, AGREES),
        ("Table 8.2", "YMO: beta, predicted error", "", 12.8, NOT_LEGIBLE),
        ("Table 8.2", "GEN: y, predicted error", "", 0.0003104, NOT_LEGIBLE),
        ("Table 8.2", "TWIS: z, predicted error", "", 0.0003303, NOT_LEGIBLE),
        ("8.4.5", "GEN: z, terms of table 7.9", ".000200", 0.0001974, AGREES),
    ],
)
def test_figures(
    rows: list[ThesisRow], section: str, quantity: str, printed: str, computed: float, verdict: Verdict
) -> None:
    row = find_row(rows, section, quantity)
    assert row.printed_number == (float(printed) if printed else None)
    assert row.computed == pytest.approx(computed, rel=2e-3)
    assert row.verdict is verdict


def test_table_8_2_is_reported_missing(rows: list[ThesisRow]) -> None:
    missing = [row for row in rows if row.section == "Table 8.2"]
    assert len(missing) == 26
    assert all(row.verdict is NOT_LEGIBLE and "table 8.2 is not in the scan" in row.reason for row in missing)


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
