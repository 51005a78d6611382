"""Rows of structures of chapters 1, 2 and 9.4: verdicts and plots."""

from __future__ import annotations

import csv
import io
from collections import Counter

import pytest
from posor_lab.thesis_table import structure_rows
from posor_lab.thesis_table.thesis_row import Verdict


def test_most_rows_agree() -> None:
    assert Counter(row.verdict for row in structure_rows.rows()) == {
        Verdict.AGREES: 31,
        Verdict.DIFFERS: 9,
        Verdict.NOT_LEGIBLE: 1,
    }


def test_figure_1a1_falls_with_the_payload_to_the_ratio_of_the_row() -> None:
    frequencies, ratio = structure_rows.plots()
    values = [float(row["stress over deflection [1]"]) for row in csv.DictReader(io.StringIO(ratio.csv))]
    assert values == sorted(values, reverse=True)
    (row,) = (row for row in structure_rows.rows() if row.printed == ".3")
    assert values[-1] == pytest.approx(row.computed, rel=1e-6)
    assert len(list(csv.DictReader(io.StringIO(frequencies.csv)))) == 2 * len(values)
