"""Rows of measuring beams: why the frequencies of 6.2.2 and appendix 6A differ, and the plots."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter

import numpy as np
import pytest
from posor_lab.thesis_table import beam_rows
from posor_lab.thesis_table.thesis_row import Verdict


def test_most_rows_agree() -> None:
    assert Counter(row.verdict for row in beam_rows.rows()) == {Verdict.AGREES: 12, Verdict.DIFFERS: 9}


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
