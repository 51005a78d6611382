# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks of readings and reference before a fit: what passes, and the sentence that refuses what does not."""

from __future__ import annotations

import re

import numpy as np
import pytest
from posor.errors import FitError, TrackError
from posor.estimation.forward import empty_scans
from posor.numerics.array_types import FloatArray
from posor_calibration.data_checks import (
    channel_name,
    check_axis,
    check_channels_move,
    check_channels_vary,
    check_clock,
    check_count,
    check_unit,
)
from posor_lab.harness.case_tables import refusal

MOVED = np.linspace(0.0, 1e-3, 20)[:, None]
NAMES = ("gap_1", "gap_2")
GAPS = ("gap_voltages",)


def test_too_few_dwells_are_refused() -> None:
    check_count(6, 6, "dwells", "bag")
    assert str(refusal(FitError, check_count, 5, 6, "dwells", "bag")) == "bag: 5 dwells; expected at least 6."


def test_channels_have_names() -> None:
    assert channel_name("gap_voltages", 1) == "gap voltage 2"
    assert channel_name("diode_currents", 6) == "current C of diode 2"


def check_volts(volts: FloatArray) -> None:
    stamps = np.arange(1, len(volts) + 1, dtype=np.int64) * 20_000_000
    check_channels_vary(empty_scans(stamps).with_fields({"gap_voltages": volts}), GAPS, "bag")


def test_a_channel_that_repeats_itself_beside_noise_is_stuck(rng: np.random.Generator) -> None:
    volts = np.asarray(3e-4 * np.round(3.0 * rng.normal(size=(60, 3))))
    check_volts(volts)
    volts[30:49, 1] = 0.3
    check_volts(volts)  # one scan too short
    volts[30:50, 1] = 0.3
    sentence = str(refusal(FitError, check_volts, volts))
    assert sentence.startswith("bag: gap voltage 2 is stuck at 0.3 from scan 30 to scan 49, while its neighbours vary")
    check_volts(np.full((60, 3), 0.3))  # a converter too coarse for the noise


def channels(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    return MOVED * [1000.0, -2000.0] + 1e-4 * rng.normal(size=(20, 2)), np.full((20, 2), 1e-4)


def test_channels_that_move_pass(rng: np.random.Generator) -> None:
    means, sigmas = channels(rng)
    check_channels_move(NAMES, means, sigmas, MOVED, "bag")
    check_channels_move(NAMES, means, np.full_like(sigmas, np.nan), MOVED, "bag")


@pytest.mark.parametrize(
    ("channel", "first", "reading", "sentence"),
    [
        (
            1,
            0,
            0.25,
            "gap_2 stays at 0.25 while the reference moves, it is stuck or does not see the motion; expected a r",
        ),
        (
            0,
            12,
            0.6,
            "gap_1 is stuck at 0.6 from dwell 13 on while the reference moves; expected a reading that changes.",
        ),
        (0, 3, np.nan, "gap_1 is not finite at dwell 4."),
    ],
)
def test_an_unusable_channel_is_refused(
    channel: int, first: int, reading: float, sentence: str, rng: np.random.Generator
) -> None:
    means, sigmas = channels(rng)
    means[first:, channel] = reading
    found = refusal(FitError, check_channels_move, NAMES, means, sigmas, MOVED, "bag")
    assert str(found).startswith(f"bag: {sentence}")


def test_the_same_reading_at_the_same_place_is_not_stuck() -> None:
    moved = np.repeat(np.linspace(0.0, 1e-3, 5), 4)[:, None]
    check_channels_move(("gap_1",), 1000.0 * moved, np.full((20, 1), 1e-4), moved, "bag")


def converted(readings: FloatArray) -> FloatArray:
    return np.round(readings / 3e-4) * 3e-4


def test_a_converter_that_repeats_where_the_motion_reverses_is_not_stuck(rng: np.random.Generator) -> None:
    phase = np.linspace(0.0, 2.0 * np.pi, 400)
    moved = 1e-3 * np.column_stack([np.sin(phase), np.sin(2.0 * phase + 0.4)])
    volts = 1000.0 * moved @ [[1.0, 0.4], [0.5, 0.0]] + 1e-5 * rng.normal(size=(400, 2))
    readings = converted(volts + 0.15 * volts**2)
    assert np.convolve(np.diff(readings[:, 1]) == 0.0, np.ones(3)).max() > 2
    check_channels_move(NAMES, readings, np.zeros_like(readings), moved, "bag")
    readings[340:370, 0] = readings[340, 0]
    exact = np.zeros_like(readings)
    error = refusal(FitError, check_channels_move, ("gap_1",), readings, exact, moved, "bag", "sample")
    assert re.search(r"gap_1 is stuck at .* from sample 341 on", str(error))


def test_slow_motion_through_a_converter_is_not_stuck() -> None:
    moved = np.linspace(0.0, 1e-3, 9000)[:, None]
    check_channels_move(("gap_1",), converted(1000.0 * moved), np.zeros((9000, 1)), moved, "bag")


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1.0 / 0.0254, "39.37 times as far as the present calibration says, as if it is in inches; "),
        (1000.0, "1000 times as far as the present calibration says, as if it is in millimetres; "),
        (25.4, "25.4 times as far as the present calibration says, as if it was converted from inches but was in mill"),
        (1 / 25.4, "0.03937 times as far as the present calibration says, as if it is in inches taken for millimetres"),
        (2.0, "2 times as far as the present calibration says, as if an interferometer with twice the passes was read"),
        (0.5, "0.5 times as far as the present calibration says, as if an interferometer with a single pass was read"),
        (7.0, "7 times as far as the present calibration says; expected values in metres."),
        (-1.0, "by 1 of their motion; expected the other sign, see the option direction."),
    ],
)
def test_a_reference_in_another_unit_or_of_the_other_sign_is_named(factor: float, words: str) -> None:
    measured = MOVED[:, 0].copy()
    measured[5] += 0.1  # the test is robust against an outlier
    sentence = str(refusal(TrackError, check_unit, measured, factor * MOVED[:, 0], "topic /reference", "metres"))
    start, end = ("moves", "values in metres") if factor > 0.0 else ("falls where the readings rise,", "direction")
    assert f"topic /reference: {start} {words}" in sentence
    assert sentence.endswith(f"{end}.")


def test_a_reference_of_the_right_unit_passes_whatever_its_zero() -> None:
    check_unit(1.3 * MOVED[:, 0], MOVED[:, 0] + 5.0, "topic", "metres")


def test_swapped_axes_are_named(rng: np.random.Generator) -> None:
    reference = np.column_stack([1e-6 * rng.normal(size=20), MOVED[:, 0], np.zeros(20)])
    volts = np.exp(3000.0 * MOVED[:, 0])  # a rank correlation ignores the curvature
    check_axis(volts, reference, 1, ("x", "y", "z"), "topic")
    assert str(refusal(TrackError, check_axis, volts, reference, 2, ("x", "y", "z"), "topic")) == (
        "topic: axis y moves with the readings, axis z does not; the axes look swapped; expected the motion along z."
    )


@pytest.mark.parametrize(("lag", "word"), [(0.1, "later"), (-0.3, "earlier")])
def test_a_reference_of_another_clock_is_named_with_its_lag(lag: float, word: str, rng: np.random.Generator) -> None:
    stamps = np.arange(300, dtype=np.int64) * 20_000_000
    seconds: FloatArray = np.asarray(stamps * 1e-9, dtype=float)

    def motion(times: FloatArray) -> FloatArray:
        return np.asarray(1e-3 * np.sin(1.3 * times) + 1e-6 * rng.normal(size=300))

    check_clock(stamps, motion(seconds), 3.0 * motion(seconds) + 1.0, "topic")
    late = motion(seconds - lag)
    with pytest.raises(TrackError, match=rf"^topic: moves as the readings do about [\d.]+ s {word}; expec") as caught:
        check_clock(stamps, motion(seconds), late, "topic")
    assert float(str(caught.value).split()[7]) == pytest.approx(abs(lag), abs=0.02)
    check_clock(stamps, seconds, seconds - lag, "topic")  # a uniform motion does not show a lag
