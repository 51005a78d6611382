"""Rows of structures: every number of chapters 1, 2 and 9.4 that can be computed, its verdict, and the plots."""

from __future__ import annotations

import csv
import io
from collections import Counter

import pytest
from posor_validation.thesis_table import structure_rows
from posor_validation.thesis_table.thesis_row import ThesisRow, Verdict

AGREES, DIFFERS = Verdict.AGREES, Verdict.DIFFERS


@pytest.fixture(scope="module")
def rows() -> list[ThesisRow]:
    return structure_rows.rows()


@pytest.mark.parametrize(
    ("section", "printed", "computed", "verdict"),
    [
        ("1.3", ".0065", 0.006545, AGREES),
        ("1.4", "5.6e-9", 5.556e-9, AGREES),
        ("1.4", "6.2e-10", 6.173e-10, AGREES),
        ("App. 1A", "26", 26.5, AGREES),
        ("App. 1A", "864", 863.35, AGREES),
        ("App. 1A", ".020", 0.02002, AGREES),
        ("App. 1A", "20", 20.53, DIFFERS),
        ("App. 1A", ".3", 0.189, DIFFERS),
        ("2.4", "862", 853.1, AGREES),
        ("2.4", ".0012", 0.0012, AGREES),
        ("2.4", ".0025", 0.0025, AGREES),
        ("9.4.1", "640", 640.0, AGREES),
        ("9.4.2", "5650", 5650.0, AGREES),
        ("9.4.2", "3200", 3200.0, AGREES),
        ("9.4.3", "12200", 12200.0, AGREES),
        ("9.4.3", "6300", 6300.0, AGREES),
        ("9.4.3", "5000", 5026.9, AGREES),
        ("9.4.4", "25575", 25575.0, AGREES),
        ("9.4.4", "10000", 10000.0, AGREES),
        ("9.4.4", "5000", 6618.0, DIFFERS),
    ],
)
def test_figures(rows: list[ThesisRow], section: str, printed: str, computed: float, verdict: Verdict) -> None:
    (row,) = (row for row in rows if (row.section, row.printed) == (section, printed))
    assert row.computed == pytest.approx(computed, rel=2e-3)
    assert row.verdict is verdict


def test_most_rows_agree(rows: list[ThesisRow]) -> None:
    assert Counter(row.verdict for row in rows) == {AGREES: 31, DIFFERS: 9, Verdict.NOT_LEGIBLE: 1}


def test_figure_1a1_falls_with_the_payload_to_the_ratio_of_the_row(rows: list[ThesisRow]) -> None:
    frequencies, ratio = structure_rows.plots()
    values = [float(row["stress over deflection [1]"]) for row in csv.DictReader(io.StringIO(ratio.csv))]
    assert values == sorted(values, reverse=True)
    (row,) = (row for row in rows if row.printed == ".3")
    assert values[-1] == pytest.approx(row.computed, rel=1e-6)
    assert len(list(csv.DictReader(io.StringIO(frequencies.csv)))) == 2 * len(values)
