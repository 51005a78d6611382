"""Rows of measuring beams: the frequencies of 6.2.2 and appendix 6A, why they differ, and the plots."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter

import numpy as np
import pytest
from posor_validation.thesis_table import beam_rows
from posor_validation.thesis_table.thesis_row import ThesisRow, Verdict

AGREES, DIFFERS = Verdict.AGREES, Verdict.DIFFERS


@pytest.fixture(scope="module")
def rows() -> list[ThesisRow]:
    return beam_rows.rows()


@pytest.mark.parametrize(
    ("section", "printed", "computed", "verdict"),
    [
        ("6.2.2", "318", 318.0, AGREES),
        ("6.2.2", "1994", 1990.0, AGREES),
        ("6.2.2", "5583", 5572.0, AGREES),
        ("6.2.2", "235", 232.0, AGREES),
        ("6.2.2", "1475", 1455.0, AGREES),
        ("6.2.2", "4131", 4074.0, AGREES),
        ("6.2.2", "817", 807.9, AGREES),
        ("6.2.2", "1156", 1151.9, AGREES),
        ("6.2.2", "886", 807.9, DIFFERS),
        ("App. 6A", "129.798310", 128.59, AGREES),
        ("App. 6A", "140.721214", 128.59, DIFFERS),
        ("App. 6A", "183.779175", 183.32, AGREES),
        ("App. 6A", "201.010994", 183.32, DIFFERS),
        ("App. 6A", "211.716768", 145.87, DIFFERS),
        ("App. 6A", "426.793661", 292.89, DIFFERS),
        ("6.3", "2", 2.544, DIFFERS),
    ],
)
def test_figures(rows: list[ThesisRow], section: str, printed: str, computed: float, verdict: Verdict) -> None:
    (row,) = (row for row in rows if (row.section, row.printed) == (section, printed))
    assert row.computed == pytest.approx(computed, rel=2e-3)
    assert row.verdict is verdict


def test_most_rows_agree(rows: list[ThesisRow]) -> None:
    assert Counter(row.verdict for row in rows) == {AGREES: 12, DIFFERS: 9}


def test_the_sideways_modes_follow_from_plates_without_rotary_inertia() -> None:
    flat = np.array(beam_rows.measuring_beam(plate_inertia=0.0).frequencies)
    np.testing.assert_allclose(flat[:2], [140.721214, 201.010994], rtol=0.01)


def test_the_modes_of_torsion_follow_from_half_the_inertia_of_the_plates() -> None:
    half = beam_rows.measuring_beam_torsion(beam_rows.PLATE.diameter_inertia)
    found = np.array([half.end_frequencies[0], half.start_frequencies[0]])
    np.testing.assert_allclose(found, [211.716768, 426.793661], rtol=0.04)
    assert found[1] / found[0] == pytest.approx(426.793661 / 211.716768, rel=1e-3)


def test_the_plots_show_the_modes_and_an_error_that_exceeds_the_correction_only_near_resonance() -> None:
    modes, *sags = beam_rows.plots()
    deflections = [float(row["deflection [1]"]) for row in csv.DictReader(io.StringIO(modes.csv))]
    assert max(map(abs, deflections)) == pytest.approx(1.0)
    assert len(sags) == 2
    for plot in sags:
        points = list(csv.DictReader(io.StringIO(plot.csv)))
        frequency = "frequency of the acceleration [Hz]"
        (amplitude,) = (key for key in points[0] if key.startswith("amplitude"))
        error = {float(row[frequency]): float(row[amplitude]) for row in points if row["series"] == "its error"}
        correction = float(points[0][amplitude])
        slow = next(value for at, value in error.items() if at > 10.0)
        assert slow / correction == pytest.approx((10.0 / 128.59) ** 2, rel=0.3)
        assert max(error, key=lambda at: error[at]) == pytest.approx(128.59, rel=0.03)
        assert math.isfinite(max(error.values()))
