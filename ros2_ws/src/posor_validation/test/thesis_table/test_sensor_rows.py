"""Rows of sensors and interferometers: figures, verdicts, reasons, and the plots."""

from __future__ import annotations

import pytest
from posor_validation.thesis_table import sensor_rows
from posor_validation.thesis_table.thesis_row import ThesisRow, Verdict

from .find_row import find_row

AGREES, DIFFERS = Verdict.AGREES, Verdict.DIFFERS


@pytest.fixture(scope="module")
def rows() -> list[ThesisRow]:
    return sensor_rows.rows()


@pytest.mark.parametrize(
    ("section", "quantity", "computed", "verdict"),
    [
        ("3.2.1", "bits of an interferometer", 19.93, AGREES),
        ("3.2.2", "alpha, beta: probes of 12 bits", 2.441, AGREES),
        ("3.2.2", "theta: bumps", 2.0, AGREES),
        ("3.2.2", "theta: the same in arcsec", 0.4125, DIFFERS),
        ("3.2.2", "theta: diodes", 10.0, AGREES),
        ("4.3", "diode: position noise", 4.96e-8, AGREES),
        ("4.3", "diode: resolution", 2.48, AGREES),
        ("4.4", "time of 400 samples", 10.0, AGREES),
        ("App. 4A", "index of air, 1 C", 0.94, AGREES),
        ("App. 4A", "index of air, .1 in", 0.909, AGREES),
        ("App. 4A", "index of air, 30 %", 0.2553, DIFFERS),
        ("7.2", "converter: bits", 13.91, AGREES),
        ("7.2", "converter: resolution on a diode", 40.6, AGREES),
        ("7.4.4", "sigma of the offset A", 0.001541, AGREES),
        ("7.4.4", "sigma of the offset B", 0.0000373, AGREES),
        ("7.4.5", "table 7.8, light source 1: alpha", -0.002713, AGREES),
        ("7.4.5", "table 7.8, light source 2: beta", -0.002025, DIFFERS),
        ("7.4.5", "table 7.8, light source 1: sigma of beta", 0.000524, DIFFERS),
        ("7.4.2", "table 7.7: mean deviation of the curves of order 9, diode 1Y", 136.7, AGREES),
        ("7.4.2", "table 7.7: low deviation of the curves of order 8, diode 1X", 106.0, DIFFERS),
        ("7.4.2", "table 7.7: high deviation of the curves of order 7, diode 2X", 356.0, AGREES),
        ("5.3.2", "distance at a diode", 13.89, AGREES),
        ("7.5.1", "gain of probe 1", 0.05379, AGREES),
        ("7.5.1", "gain of probe 3", 0.0589, DIFFERS),
        ("7.5.1", "Abbe error", 3.75, AGREES),
        ("7.5.2", "error of D21", 0.0179, AGREES),
        ("7.5.4", "random error of probe 3", 24.5, AGREES),
    ],
)
def test_figures(rows: list[ThesisRow], section: str, quantity: str, computed: float, verdict: Verdict) -> None:
    row = find_row(rows, section, quantity)
    assert row.computed == pytest.approx(computed, rel=3e-3)
    assert row.verdict is verdict


def test_the_humidity_of_the_appendix_states_its_condition(rows: list[ThesisRow]) -> None:
    """Cross-checked with the index itself: at the temperature of the reason, 30 % change it by 1 ppm."""
    reason = find_row(rows, "App. 4A", "index of air, 30 %").reason
    assert "by 1 ppm in air of 46 C only" in reason
    assert "at 20 C, 1 ppm needs 117 %, more than there can be" in reason


def test_plots_have_the_numbers_of_the_calculators() -> None:
    plots = {plot.title.split(":")[0]: plot for plot in sensor_rows.plots()}
    assert list(plots)[:4] == ["4.2.1", "4.2.2", "4.3", "4A"]
    assert "numerical aperture 0.5" in plots["4.2.1"].csv
    assert "2500 Hz,1,2.479" in plots["4.3"].csv
    assert "order 9,1,198" in plots["7.4.2, figure 7.18"].csv
    assert len(plots) == 7
