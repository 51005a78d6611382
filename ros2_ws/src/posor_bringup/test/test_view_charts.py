# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np
import pytest
from posor.numerics.stamps import NS
from posor_bringup.view_charts import Axis, Chart, Series, draw_charts
from posor_bringup.view_history import POINTS, History
from posor_bringup.view_record import STATE_COLOURS, ArmRecord, Since

T0_S = 1_767_225_600.0
CHARTS = (
    Chart("deviation", (Series("x", "#d62728", 0, 1),), 60),
    Chart("chi-square", (Series("elbow", "#1f77b4", 2), Series("base", "#2ca02c", 2)), 60, 1.0),
)
STATE = 3
LETTER = 11.0  # height of a label


def filled(times_s: np.typing.ArrayLike) -> History:
    history = History(4, (30.0,))
    for number, time_s in enumerate(np.asarray(times_s)):
        history.add(time_s, np.array([float(number), 2.0, 0.5, 0.0]))
    return history


def drawn(history: History, axis: Axis) -> ET.Element:
    picture = draw_charts(history.points(0), axis, CHARTS, STATE, STATE_COLOURS, history.run)
    return ET.fromstring(picture)  # noqa: S314  drawn by this program


def test_history_keeps_every_peak_in_all_windows_and_is_bounded() -> None:
    history = History(1, (30.0, 3600.0))
    for number in range(40_000):
        history.add(T0_S + 0.1 * number, np.array([1000.0 if number == 30_000 else float(number % 7)]))
    short, hour = history.points(0), history.points(1)
    assert len(short.times_s) == len(hour.times_s) == POINTS + 1
    assert short.times_s[-1] - short.times_s[0] == pytest.approx(30.0)
    assert hour.times_s[-1] - hour.times_s[0] == pytest.approx(3600.0)
    assert hour.high.max() == 1000.0
    assert short.high.max() == 6.0
    assert hour.low.min() == 0.0


def test_history_begins_anew_where_the_time_goes_back_and_ignores_a_repeated_time() -> None:
    history = filled(T0_S + np.arange(10.0))
    assert history.add(T0_S + 9.0, np.zeros(4))
    assert history.points(0).high[-1, 0] == 9.0
    assert not history.add(T0_S, np.zeros(4))
    assert len(history.points(0).times_s) == 1


def test_unknown_values_do_not_hide_known_ones() -> None:
    history = History(1, (30.0,))
    for number, value in enumerate((np.nan, 3.0, np.nan)):
        history.add(T0_S + 0.05 + 0.01 * number, np.array([value]))
    points = history.points(0)
    assert (points.low[0, 0], points.high[0, 0]) == (3.0, 3.0)


def test_all_charts_have_one_axis_in_utc() -> None:
    picture = drawn(filled(T0_S + np.arange(30.0)), Axis(T0_S, T0_S + 30.0))
    ticks = [each.text for each in picture.iter("text") if each.get("class") == "tick"]
    assert ticks == ["00:00:00", "00:00:05", "00:00:10", "00:00:15", "00:00:20", "00:00:25", "00:00:30"][: len(ticks)]
    assert len(ticks) >= 6
    assert [each.text for each in picture.iter("text") if each.get("id") == "date"] == ["2026-01-01 UTC"]


def test_labels_of_ticks_are_clear_of_each_other() -> None:
    picture = drawn(filled(T0_S + np.arange(30.0)), Axis(T0_S, T0_S + 30.0))
    kinds = {
        kind: [float(each.get("y", 0.0)) for each in picture.iter("text") if each.get("class") == kind]
        for kind in ("value", "tick")
    }
    values = np.sort(kinds["value"])
    assert len(values) >= 4
    assert np.diff(values).min() > LETTER
    assert min(kinds["tick"]) - values[-1] >= LETTER


def test_curves_bands_and_limit() -> None:
    picture = drawn(filled(T0_S + 0.1 * np.arange(300)), Axis(T0_S, T0_S + 30.0))
    kinds = [each.get("class") for each in picture.iter("path")]
    assert kinds == ["band", "curve", "curve", "curve"]
    assert [each.get("stroke-dasharray") for each in picture.iter("line")].count("6 3") == 1  # the limit


def test_gaps_are_not_bridged_and_former_runs_are_pale_and_marked() -> None:
    history = filled(T0_S + 0.1 * np.arange(50))
    history.run += 1
    for number in range(50):
        history.add(T0_S + 20.0 + 0.1 * number, np.array([0.0, 2.0, 0.5, 0.0]))
    picture = drawn(history, Axis(T0_S, T0_S + 30.0, T0_S + 10.0))
    curves = [each for each in picture.iter("path") if each.get("class") == "curve" and each.get("fill") == "#d62728"]
    assert [each.get("opacity") is not None for each in curves] == [True, False]
    assert [each.get("stroke-dasharray") for each in picture.iter("line")].count("4 3") == 1  # begin of the run


def test_strip_shows_the_worst_state_of_each_part() -> None:
    history = History(4, (30.0,))
    for number in range(300):
        history.add(T0_S + 0.1 * number, np.array([0.0, 0.0, 0.0, 7.0 if number == 100 else 0.0]))
    colours = [each.get("fill") for each in drawn(history, Axis(T0_S, T0_S + 30.0)).iter("rect")]
    assert colours == [STATE_COLOURS[0], STATE_COLOURS[7], STATE_COLOURS[0]]


def test_charts_without_points_are_empty() -> None:
    picture = drawn(History(4, (30.0,)), Axis(T0_S, T0_S + 30.0))
    assert not list(picture.iter("path"))


def test_another_identity_is_another_run() -> None:
    record = ArmRecord(["elbow"], (30.0,))
    for second, identity in enumerate(("a" * 64, "", "a" * 64, "b" * 64)):
        record.add_state(second * NS, "OK", [], identity)
    (event,) = record.log.events()
    assert event.cause.text == "the arm has changed: identity aaaaaaaa became bbbbbbbb"
    assert record.history.run == 1


def test_time_since_which_the_endpoint_is_unusable_covers_all_states_without_a_pose() -> None:
    record = ArmRecord(["elbow"], (30.0,))
    for second, state in enumerate(("OK", "LOST", "STALE", "UNCOUNTED", "DEGRADED", "OK", "OK")):
        record.add_state(second, state, [], "")
    found = [record.since(second) for second in range(7)]
    assert found == [Since(begin, begin == 0) for begin in (0, 1, 1, 1, 4, 5, 5)]
