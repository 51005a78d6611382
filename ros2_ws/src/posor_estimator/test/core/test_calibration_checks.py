from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from posor_estimator.core.calibrate.checks import (
    check_alive,
    check_axis,
    check_enough,
    check_unit,
    misfit_sentences,
    outlier_sentences,
)
from posor_estimator.core.calibrate.fit import fit
from posor_estimator.errors import FitError, PosorError, TrackError

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_estimator.core.types import FloatArray

MOVED = np.linspace(0.0, 1e-3, 20)[:, None]


def refusal(check: Callable[[], object], kind: type[PosorError]) -> str:
    with pytest.raises(kind) as caught:
        check()
    return str(caught.value)


def test_too_few_stops_are_refused() -> None:
    check_enough(6, 6, "stops", "bag")
    assert refusal(lambda: check_enough(5, 6, "stops", "bag"), FitError) == "bag: 5 stops; expected at least 6."


def channels(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    return MOVED * [1000.0, -2000.0] + 1e-4 * rng.normal(size=(20, 2)), np.full((20, 2), 1e-4)


def test_channels_that_move_are_alive(rng: np.random.Generator) -> None:
    means, sigmas = channels(rng)
    check_alive(("gap_1", "gap_2"), means, sigmas, MOVED, "bag")
    check_alive(("gap_1", "gap_2"), means, np.full_like(sigmas, np.nan), MOVED, "bag")


def test_channel_that_shows_only_noise_is_stuck(rng: np.random.Generator) -> None:
    means, sigmas = channels(rng)
    means[:, 1] = 0.25 + 1e-4 * rng.normal(size=20)
    sentence = refusal(lambda: check_alive(("gap_1", "gap_2"), means, sigmas, MOVED, "bag"), FitError)
    assert sentence.startswith("bag: gap_2 stays at 0.25")
    assert sentence.endswith(
        "it is stuck or does not see the motion; expected a reading that changes by more than its noise."
    )


def test_channel_that_stands_from_some_stop_on_is_stuck(rng: np.random.Generator) -> None:
    means, sigmas = channels(rng)
    means[12:, 0] = means[12, 0]
    sentence = refusal(lambda: check_alive(("gap_1", "gap_2"), means, sigmas, MOVED, "bag"), FitError)
    assert sentence == (
        f"bag: gap_1 is stuck at {means[12, 0]:.6g} from stop 13 on while the reference moves; "
        "expected a reading that changes."
    )


def test_same_reading_at_the_same_place_is_not_stuck() -> None:
    moved = np.repeat(np.linspace(0.0, 1e-3, 5), 4)[:, None]
    check_alive(("gap_1",), 1000.0 * moved, np.full((20, 1), 1e-4), moved, "bag")


def converted(readings: FloatArray) -> FloatArray:
    return np.round(readings / 3e-4) * 3e-4


def test_same_reading_of_a_converter_where_the_motion_turns_round_is_not_stuck(rng: np.random.Generator) -> None:
    phase = np.linspace(0.0, 2.0 * np.pi, 400)
    moved = 1e-3 * np.column_stack([np.sin(phase), np.sin(2.0 * phase + 0.4)])
    volts = 1000.0 * moved @ [[1.0, 0.4], [0.5, 0.0]] + 1e-5 * rng.normal(size=(400, 2))
    readings = converted(volts + 0.15 * volts**2)
    assert np.convolve(np.diff(readings[:, 1]) == 0.0, np.ones(3)).max() > 2
    check_alive(("gap_1", "gap_2"), readings, np.zeros_like(readings), moved, "bag")
    readings[340:370, 0] = readings[340, 0]
    sentence = refusal(lambda: check_alive(("gap_1",), readings, np.zeros_like(readings), moved, "bag"), FitError)
    assert "gap_1 is stuck at" in sentence
    assert "from stop 341 on" in sentence


def test_slow_motion_through_a_converter_is_not_stuck() -> None:
    moved = np.linspace(0.0, 1e-3, 9000)[:, None]
    check_alive(("gap_1",), converted(1000.0 * moved), np.zeros((9000, 1)), moved, "bag")


def test_channel_without_numbers_is_refused() -> None:
    means = 1000.0 * MOVED
    means[3] = np.nan
    assert refusal(lambda: check_alive(("gap_1",), means, np.ones((20, 1)), MOVED, "bag"), FitError) == (
        "bag: gap_1 is not finite at stop 4."
    )


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (1.0 / 0.0254, "39.37 times as far as the present calibration says, as if it is in inches; "),
        (1000.0, "1000 times as far as the present calibration says, as if it is in millimetres; "),
        (
            25.4,
            "25.4 times as far as the present calibration says, as if it was converted from inches but was in milli",
        ),
        (
            1.0 / 25.4,
            "0.03937 times as far as the present calibration says, as if it is in inches taken for millimetres; ",
        ),
        (7.0, "7 times as far as the present calibration says; expected values in metres."),
    ],
)
def test_reference_in_another_unit_is_named(factor: float, said: str) -> None:
    measured = MOVED[:, 0].copy()
    measured[5] += 0.1  # an outlier hides nothing
    sentence = refusal(lambda: check_unit(measured, factor * MOVED[:, 0], "topic /reference", "metres"), TrackError)
    assert f"topic /reference: moves {said}" in sentence
    assert sentence.endswith("expected values in metres.")


def test_reference_of_the_right_unit_passes_whatever_its_zero() -> None:
    check_unit(1.3 * MOVED[:, 0], MOVED[:, 0] + 5.0, "topic", "metres")


def test_reference_of_the_other_sign_is_named() -> None:
    sentence = refusal(lambda: check_unit(MOVED[:, 0], -MOVED[:, 0], "topic", "metres"), TrackError)
    assert sentence == (
        "topic: falls where the readings rise, by 1 of their motion; expected the other sign, see the option direction."
    )


def test_swapped_axes_are_named(rng: np.random.Generator) -> None:
    reference = np.column_stack([1e-6 * rng.normal(size=20), MOVED[:, 0], np.zeros(20)])
    volts = np.exp(3000.0 * MOVED[:, 0])  # a rank correlation minds no curve
    check_axis(volts, reference, 1, ("x", "y", "z"), "topic")
    assert refusal(lambda: check_axis(volts, reference, 2, ("x", "y", "z"), "topic"), TrackError) == (
        "topic: axis y moves with the readings, axis z does not; the axes look swapped; expected the motion along z."
    )


def test_outliers_are_named_and_too_many_refused() -> None:
    names = [f"stop {n}" for n in range(40)]
    outliers = np.zeros(40, dtype=bool)
    assert outlier_sentences(outliers, names, "gap_1") == ()
    outliers[[3, 17]] = True
    assert outlier_sentences(outliers, names, "gap_1") == (
        "gap_1: left out stop 3, stop 17, which do not fit the others.",
    )
    outliers[20:24] = True
    assert refusal(lambda: outlier_sentences(outliers, names, "gap_1"), FitError) == (
        "gap_1: 6 of 40 readings do not fit, such as stop 3; expected at most 10 % outliers."
    )


@pytest.mark.parametrize(("times", "said"), [(1.0, False), (2.0, True)])
def test_residuals_beyond_the_stated_uncertainties_are_told(
    times: float, *, said: bool, rng: np.random.Generator
) -> None:
    readings = times * rng.normal(size=100)
    found = fit(lambda values: readings - values[0], np.zeros(1), ("mean",), ("m",), np.ones(1))
    assert bool(misfit_sentences(found, "the mean")) == said
