"""Channels that stand, readings that do not belong to their stop, and references of another clock."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from posor_estimator.core.calibrate.channels import channel_name, check_channels
from posor_estimator.core.calibrate.clock import check_clock
from posor_estimator.core.calibrate.sound_readings import sound_parts
from posor_estimator.core.forward import empty_scans
from posor_estimator.errors import FitError, TrackError

if TYPE_CHECKING:
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import FloatArray

GAPS = ("gap_voltages",)


def scans_of(volts: FloatArray) -> Scans:
    stamps = np.arange(1, len(volts) + 1, dtype=np.int64) * 20_000_000
    return empty_scans(stamps).with_fields({"gap_voltages": volts})


def noise(count: int, rng: np.random.Generator) -> FloatArray:
    return np.asarray(3e-4 * np.round(3.0 * rng.normal(size=(count, 3))))


def test_channels_have_names() -> None:
    assert channel_name("gap_voltages", 1) == "gap voltage 2"
    assert channel_name("diode_currents", 6) == "current C of diode 2"


def test_a_channel_that_repeats_itself_beside_noise_is_stuck(rng: np.random.Generator) -> None:
    volts = noise(60, rng)
    check_channels(scans_of(volts), GAPS, "bag")
    volts[30:49, 1] = 0.3
    check_channels(scans_of(volts), GAPS, "bag")  # one scan less than it takes
    volts[30:50, 1] = 0.3
    with pytest.raises(FitError, match=r"^bag: gap voltage 2 is stuck at 0\.3 from scan 30 to scan 49, its neighbours"):
        check_channels(scans_of(volts), GAPS, "bag")


def test_a_converter_too_coarse_for_the_noise_is_not_stuck() -> None:
    check_channels(scans_of(np.full((60, 3), 0.3)), GAPS, "bag")


def test_gross_errors_and_missing_readings_are_left_out_and_named(rng: np.random.Generator) -> None:
    volts = noise(80, rng)
    volts[40:] += 0.5
    volts[7, 1] += 0.1
    volts[55, 1] = np.nan
    whole = scans_of(volts)
    parts, said = sound_parts([whole.part(0, 40), whole.part(40, 80)], np.zeros(2), GAPS, "bag")
    left = np.concatenate([part.gap_voltages for part in parts])
    assert np.argwhere(np.isnan(left)).tolist() == [[7, 1], [55, 1]]
    np.testing.assert_array_equal(left[~np.isnan(left)], volts[~np.isnan(left)])
    assert len(said) == 1
    assert said[0].startswith("bag: left out 2 of 80 readings of gap voltage 2, which do not belong to the stops")
    assert said[0].endswith("(scan 7, 55).")


def test_readings_may_follow_a_reference_that_moves_within_the_stop(rng: np.random.Generator) -> None:
    volts = noise(80, rng)
    volts[40:] += 0.5
    volts[36:40] += 0.1
    whole = scans_of(volts)
    parts = [whole.part(0, 40), whole.part(40, 80)]
    assert len(sound_parts(parts, np.zeros(2), GAPS, "bag")[1]) == 3
    assert sound_parts(parts, np.array([0.05, 0.0]), GAPS, "bag")[1] == ()


def test_too_many_readings_that_do_not_belong_are_refused(rng: np.random.Generator) -> None:
    volts = noise(80, rng)
    volts[9:18, 2] += 1.0
    sentence = (
        r"^bag: 9 of 80 readings of gap voltage 3 do not belong to the stops they were taken in, such as that of scan 9"
    )
    with pytest.raises(FitError, match=sentence):
        sound_parts([scans_of(volts)], np.zeros(1), GAPS, "bag")


@pytest.mark.parametrize(("lag", "word"), [(0.1, "later"), (-0.3, "earlier")])
def test_a_reference_of_another_clock_is_told_by_its_lag(lag: float, word: str, rng: np.random.Generator) -> None:
    stamps = np.arange(300, dtype=np.int64) * 20_000_000
    seconds: FloatArray = np.asarray(stamps * 1e-9, dtype=float)

    def motion(times: FloatArray) -> FloatArray:
        return np.asarray(1e-3 * np.sin(1.3 * times) + 1e-6 * rng.normal(size=300))

    check_clock(stamps, motion(seconds), 3.0 * motion(seconds) + 1.0, "topic")
    with pytest.raises(
        TrackError, match=rf"^topic: moves as the readings do about [\d.]+ s {word}; expected"
    ) as caught:
        check_clock(stamps, motion(seconds), motion(seconds - lag), "topic")
    assert float(str(caught.value).split()[7]) == pytest.approx(abs(lag), abs=0.02)
    check_clock(stamps, seconds, seconds - lag, "topic")  # an even motion does not tell
