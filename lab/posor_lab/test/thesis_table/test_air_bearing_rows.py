"""Rows and plots of aerostatic bearings (6.2.3.6, 7.3): trends."""

from __future__ import annotations

import csv
from itertools import pairwise

import pytest
from posor_lab.thesis_table import air_bearing_rows
from posor_lab.thesis_table.thesis_row import Verdict


def test_the_printed_trends_of_air_for_hold() -> None:
    trends = [row for row in air_bearing_rows.rows() if row.quantity.startswith("direction of the load")]
    assert [row.printed for row in trends] == ["-1", "1", "-1", "-1"]
    assert all(row.verdict is Verdict.AGREES for row in trends)


def test_a_load_that_rises_and_falls_has_no_direction() -> None:
    clearance = 0.002 * 0.0254
    bearings = [air_bearing_rows.air_bearing(clearance, aspect) for aspect in air_bearing_rows.ASPECTS]
    assert bearings[0].load < bearings[2].load > bearings[4].load
    assert air_bearing_rows.direction(bearings) == 0.0
    assert air_bearing_rows.direction(bearings[:3]) == 1.0


def test_figures_are_redrawn() -> None:
    titles = [plot.title for plot in air_bearing_rows.plots()]
    assert [title.split(":")[0] for title in titles[:5]] == [f"Figure 6.{number}" for number in range(12, 17)]
    assert len(set(titles)) == len(titles) == 6


def test_the_redrawn_load_rises_as_the_gap_closes() -> None:
    plot = next(plot for plot in air_bearing_rows.plots() if plot.title.startswith("Figure 6.15"))
    lines = list(csv.reader(plot.csv.splitlines()[1:]))
    for aspect in air_bearing_rows.ASPECTS:
        points = [(float(gap), float(load)) for name, gap, load in lines if name == f"L/D {aspect}"]
        assert len(points) == 20
        assert points[0] == pytest.approx((0.002, 0.0))
        assert all(near[0] < far[0] and near[1] > far[1] for far, near in pairwise(points))
