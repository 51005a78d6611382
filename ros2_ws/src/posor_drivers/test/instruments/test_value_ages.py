# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Devices whose values are older than their frames: the stated error of the stamps contains the ages."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from posor.calibration.design_parts import quantity_entry
from posor.numerics.array_types import FloatArray
from posor_drivers.instruments.device import Device, Frames
from posor_drivers.instruments.device_reader import DeviceReader
from posor_drivers.instruments.frame_store import CAPACITY, FrameStore
from posor_drivers.instruments.interpolation import MOST_WEIGHT
from posor_drivers.instruments.labjack_device import LabJackDevice, LabJackSettings
from posor_drivers.instruments.stream_device import StreamDevice, StreamSettings
from posor_drivers.instruments.value_ages import (
    CHECKED_FRAMES,
    ISOLATED_CHANGES,
    RECENT_FRAMES,
    RENEWED_FRAMES,
    ValueAges,
)
from posor_lab.device_servers.labjack_server import LabJackServer
from posor_lab.device_servers.stream_server import LEAD, StreamServer

from .device_states import running, wait_for, wait_for_frames

PERIOD_S = 1e-3
CYCLE_NS = 4_000_000_000
TICK_NS = 9_700_000  # ticks at each phase of the frames
OFFSET_NS = 400_000
MULTIPLEXED = {"exposures": {"interval": quantity_entry(2e-9 * OFFSET_NS, "s")}}


def ages_of(values: FloatArray, numbers: Any = None) -> tuple[ValueAges, FloatArray]:
    """Return the greatest age in each frame of channels and the two before, from the third frame on [s]."""
    values = np.reshape(values, (len(values), -1))
    channels = values.shape[1]
    store = FrameStore(channels, 1.0 / PERIOD_S)
    ages = ValueAges(store, channels)
    numbers = np.arange(len(values)) if numbers is None else np.asarray(numbers)
    found = []
    for n, number in enumerate(numbers.tolist()):
        store.write(Frames(numbers, values), np.array([n]), 0)
        found += [ages.age_s(number - 2, number, range(channels))] if n > 1 else []
    return ages, np.array(found)


def renewed_after(runs: Any) -> FloatArray:
    """Return values of frames that are repeated so many times in turn."""
    return np.repeat(np.arange(len(runs), dtype=np.float64), runs)


def test_a_value_is_as_old_as_the_first_of_equal_frames_and_a_period() -> None:
    runs = np.random.default_rng(1).integers(3, 9, 100)
    runs[50] = 2000  # a joint at rest, or a converter that pauses
    ages, found_s = ages_of(renewed_after(runs))
    each_s = PERIOD_S * np.concatenate([np.arange(1, run + 1) for run in runs])
    expected_s = np.max([each_s[:-2], each_s[1:-1], each_s[2:]], axis=0)
    np.testing.assert_allclose(found_s[runs[0] :], expected_s[runs[0] :])
    assert ages.longest_s[0] == pytest.approx(PERIOD_S * max(runs[-10:]))


def test_the_age_of_a_value_is_unknown_before_its_first_change() -> None:
    """The first frames of a connection may repeat a value that is older than it."""
    ages, found_s = ages_of(renewed_after([6, 4, 7]))
    first = 6  # of the first new value
    assert found_s[:first] == pytest.approx(CAPACITY * PERIOD_S)
    assert found_s[first:].max() == pytest.approx(7 * PERIOD_S)
    assert ages.longest_s[0] == pytest.approx(7 * PERIOD_S)


def test_the_age_of_a_value_is_unknown_where_the_first_call_is_about_its_first_change() -> None:
    store = FrameStore(1, 1.0 / PERIOD_S)
    store.write(Frames(np.arange(17), renewed_after([6, 4, 7])[:, None]), np.arange(17), 0)
    assert ValueAges(store, 1).age_s(5, 7, [0]) == pytest.approx(CAPACITY * PERIOD_S)


def test_a_channel_with_new_values_in_each_frame_may_repeat_them_later() -> None:
    values = np.concatenate([np.arange(RENEWED_FRAMES + 1.0), np.full(3000, 7.0)])
    ages, found_s = ages_of(values)
    assert not found_s[RENEWED_FRAMES - 2 :].any()
    assert ages.longest_s[0] == 0.0


@pytest.mark.parametrize("step", [0.3, 1.0, 2.5])
def test_the_noise_of_a_coarse_converter_shows_new_values_at_once(step: float) -> None:
    """Also where the value is in the middle between two steps, and does not move."""
    noise = np.random.default_rng(2).standard_normal(1000)
    _, found_s = ages_of(np.round(noise / step))
    assert found_s[0] > 0.0
    assert not found_s[-10:].any()


@pytest.mark.parametrize("periods", [1.25, 1.26, 1.3, 1.33, 1.6])
def test_a_converter_of_a_quarter_more_than_a_period_has_no_new_values_in_each_frame(periods: float) -> None:
    for phase in np.linspace(0.0, 0.8, 5):
        ages, found_s = ages_of(np.floor((np.arange(300.0) + phase) / periods))
        assert ages.longest_s[0] == pytest.approx(2.0 * PERIOD_S)
        assert found_s.min() > 0.0


def test_a_converter_of_less_than_a_quarter_more_than_a_period_is_not_seen() -> None:
    ages, _ = ages_of(np.floor(np.arange(500.0) / 1.2))
    assert ages.longest_s[0] == 0.0


@pytest.mark.parametrize("run", [2, 7, 60, 150])
def test_a_channel_that_becomes_slower_is_doubtful_again(run: int) -> None:
    """Also beside a channel at rest, whose frames are looked at for longer."""
    slower = renewed_after(np.full(ISOLATED_CHANGES + CHECKED_FRAMES // run + 3, run))
    values = np.concatenate([np.arange(100.0), 100.0 + slower])
    ages, found_s = ages_of(values)
    assert not found_s[RENEWED_FRAMES:100].any()
    assert [found_s[-1], ages.longest_s[0]] == pytest.approx([run * PERIOD_S] * 2)
    ages, _ = ages_of(np.column_stack([values, np.zeros(len(values))]))
    assert ages.longest_s[0] == pytest.approx(run * PERIOD_S)


@pytest.mark.parametrize("isolated", [ISOLATED_CHANGES - 1, 2 * ISOLATED_CHANGES])
def test_two_changes_in_a_row_end_the_count_of_isolated_ones(isolated: int) -> None:
    runs = np.tile([*np.full(isolated, 7), 1], CHECKED_FRAMES)  # the pair at each place among the frames of a check
    _, found_s = ages_of(np.concatenate([np.arange(100.0), 100.0 + renewed_after(runs)]))
    assert found_s[RENEWED_FRAMES:].any() == (isolated >= ISOLATED_CHANGES)


def test_values_beside_lost_frames_and_invalid_ones_are_not_new() -> None:
    _, found_s = ages_of(np.arange(100.0), numbers=2 * np.arange(100))
    np.testing.assert_allclose(found_s, 2.0 * PERIOD_S)
    _, found_s = ages_of(np.full(100, np.nan))
    assert found_s[-1] == pytest.approx(CAPACITY * PERIOD_S)


def positions(count: int, frames_to_stop: float = 0.0, phase: float = 0.0) -> FloatArray:
    """Return values of 11 channels of a converter without noise, in steps; they come to rest in the middle.

    The fastest is at 50 steps per frame after 100 frames, and until its even deceleration.
    """
    until = np.minimum(np.arange(count) - count // 2 + phase, 0.0)
    deceleration = 50.0 / frames_to_stop if frames_to_stop else 0.0
    along = np.where(until < -frames_to_stop, 50.0 * (until + 0.5 * frames_to_stop), -0.5 * deceleration * until**2)
    along += 0.25 * np.maximum(100.0 - np.arange(count), 0.0) ** 2
    values: FloatArray = np.round(along[:, None] * np.linspace(-0.5, 1.0, 11))
    return values


@pytest.mark.parametrize(("motion", "noise"), [(1.0, 0.0), (1.0, 3.0), (0.0, 30.0)])
def test_values_that_all_channels_repeat_in_a_pause_are_old(motion: float, noise: float) -> None:
    """Also at rest where the channels have noise, and beside invalid values."""
    random = np.random.default_rng(3)
    values = np.round(motion * positions(1200)[:600] + noise * random.standard_normal((600, 11)))
    values[310:325] = values[309]
    values[range(200, 211), range(11)] = values[300:340, 3] = np.nan
    each_s = np.zeros(len(values))
    each_s[310:325] = PERIOD_S * np.arange(2, 17)
    expected_s = np.max([each_s[:-2], each_s[1:-1], each_s[2:]], axis=0)
    ages, found_s = ages_of(values)
    np.testing.assert_allclose(found_s[150:], expected_s[150:])
    assert not ages.longest_s.any()
    ages, _ = ages_of(values[: 325 + RECENT_FRAMES])
    np.testing.assert_allclose(ages.longest_s, 16 * PERIOD_S)


def test_the_first_call_after_a_connection_finds_a_pause() -> None:
    values = np.round(30.0 * np.random.default_rng(5).standard_normal((100, 11)))
    values[70:85] = values[69]
    store = FrameStore(11, 1.0 / PERIOD_S)
    store.write(Frames(np.arange(100), values), np.arange(100), 0)
    assert ValueAges(store, 11).age_s(78, 80, range(11)) == pytest.approx(12 * PERIOD_S)


@pytest.mark.parametrize("frames_to_stop", [1.5, 2.0, 5.0, 20.0])
def test_a_bearing_that_comes_to_rest_is_no_pause(frames_to_stop: float) -> None:
    for phase in np.linspace(0.0, 0.9, 10):
        _, found_s = ages_of(positions(400, frames_to_stop, phase))
        assert not found_s[150:].any()


@pytest.mark.parametrize("noise", [0.7, 1.0, 2.0, 5.0])
def test_noise_is_no_pause(noise: float) -> None:
    values = np.round(noise * np.random.default_rng(4).standard_normal((3000, 3)))
    _, found_s = ages_of(values)
    assert np.count_nonzero(found_s[1000:]) <= 3  # one frame, looked at three times


def test_a_rest_after_a_stop_within_a_frame_is_a_pause_only_at_first() -> None:
    _, found_s = ages_of(positions(600))
    assert 0.0 < found_s[150:].max() < RECENT_FRAMES * PERIOD_S
    assert not found_s[-150:].any()


def test_one_channel_that_repeats_its_values_is_no_pause() -> None:
    """It may be at the limit of its range."""
    values = positions(400)
    values[200:, 1] = 1.0 + np.arange(200)
    for each in (values, values[:, 0]):
        _, found_s = ages_of(each)
        assert not found_s[150:].any()


def triangle(time_ns: int) -> float:
    """Return a value that changes by one per second, and turns back before the resolution of 32 bits counts."""
    return abs(time_ns % CYCLE_NS - CYCLE_NS // 2) * 1e-9


def renewing(interval_ns: int) -> Callable[[int], list[float]]:
    """Return values that a device renews at an interval."""
    return lambda time_ns: [triangle(time_ns - time_ns % interval_ns)] * 2


def multiplexed(interval_ns: int) -> Callable[[int], list[float]]:
    """Return the same of channels that are read at ``OFFSET_NS`` before the time of the frame, and after it."""
    values = renewing(interval_ns)
    return lambda time_ns: [values(time_ns - OFFSET_NS)[0], values(time_ns + OFFSET_NS)[1]]


def stream(port: int, **keys: Any) -> Device[Any]:
    content = {
        "kind": "stream",
        "transport": "tcp",
        "host": "127.0.0.1",
        "port": port,
        "rate": quantity_entry(1000, "Hz"),
        "format": f"{LEAD}2d",
        "fields": ["magic", "counter", "gap1", "gap2"],
        "channels": {"gap1": {"unit": "V"}, "gap2": {"unit": "V"}},
        **keys,
    }
    return StreamDevice("box", StreamSettings.model_validate(content))


def labjack(server: LabJackServer) -> Device[Any]:
    channels = {name: {"input": n} for n, name in enumerate(("gap1", "gap2"))}
    content = {"kind": "labjack", "host": "127.0.0.1", "port": server.port, "rate": quantity_entry(250, "Hz")}
    return LabJackDevice("box", LabJackSettings.model_validate(content | {"channels": channels}))


def read_ticks(reader: DeviceReader) -> FloatArray:
    """Return how old the values of 150 ticks are, and the limits of their stamps with and without ages, (n, 3) [s]."""
    wait_for_frames(reader)
    found: dict[int, tuple[float, float, float]] = {}

    def take() -> bool:
        at_ns = time.time_ns() // TICK_NS * TICK_NS - 100_000_000
        values, alone = reader.values_at(at_ns), reader.stamp_error_at(at_ns)
        error = reader.stamp_error_at(at_ns, [0, 1])
        if values is not None and error is not None and alone is not None:
            found[at_ns] = float(np.abs(triangle(at_ns) - values).max()), error.limit_s, alone.limit_s
        return len(found) >= 150

    wait_for(take, "values at ticks")
    return np.array(list(found.values()))


@pytest.mark.parametrize("interval_ns", [1_500_000, 7_000_000, 20_000_000])
def test_the_error_of_the_stamps_contains_the_ages_of_a_stream(interval_ns: int) -> None:
    with StreamServer(renewing(interval_ns)) as server, running(stream(server.port)) as reader:
        errors_s, limits_s, alone_s = read_ticks(reader).T
        sentence = reader.state.fault
    assert np.all(errors_s <= limits_s)
    assert np.any(errors_s > alone_s)
    assert np.median(limits_s - alone_s) < 2e-9 * (interval_ns + 1_000_000)
    assert sentence == (
        f"box: channel 'gap1' repeats its values for {-(-interval_ns // 1_000_000)} ms; "
        "expected new ones after 1 ms, in each frame; this time is part of the stamps' error."
    )


def test_the_error_of_the_stamps_contains_the_ages_of_a_multiplexed_stream() -> None:
    with StreamServer(multiplexed(61_000_000)) as server, running(stream(server.port, **MULTIPLEXED)) as reader:
        errors_s, limits_s, _ = read_ticks(reader).T
    assert np.all(errors_s <= limits_s)


@pytest.mark.parametrize(("tick", "oldest"), [(61.7, 20), (58.3, 20), (50.3, 12)])
def test_the_frames_of_all_channels_of_a_multiplexed_frame_count(tick: float, oldest: int) -> None:
    """New values come in frames 41 and 61; a channel uses two frames before the one of the tick, or two after it."""
    reader = DeviceReader(stream(1, **MULTIPLEXED))
    numbers = np.arange(100)
    values = np.repeat((numbers[:, None] + 19) // 20, 2, axis=1)
    reader._store(Frames(numbers, values.astype(float), 1_000_000 * numbers), 0)
    error, alone = (reader.stamp_error_at(round(tick * 1e6), columns) for columns in ([0, 1], []))
    assert error is not None
    assert alone is not None
    assert error.limit_s - alone.limit_s == pytest.approx(MOST_WEIGHT * oldest * PERIOD_S)


def test_the_ages_follow_the_clock_of_the_device() -> None:
    interval_ns = 101_404_500  # 100.5 frames
    with StreamServer(renewing(interval_ns), drift=0.009) as server, running(stream(server.port)) as reader:
        wait_for_frames(reader)

        def is_found() -> bool:
            reader.stamp_error_at(time.time_ns() - 100_000_000, [0])
            return "repeats its values for 102 ms" in reader.state.fault  # 101 frames

        wait_for(is_found, "the age of the last one of equal frames")


def test_the_error_of_the_stamps_contains_the_ages_of_registers_that_are_asked_for_too_often() -> None:
    with LabJackServer(renewing(20_000_000)) as server, running(labjack(server)) as reader:
        errors_s, limits_s, alone_s = read_ticks(reader).T
        assert "repeats its values for" in reader.state.fault
    assert np.all(errors_s <= limits_s + 1e-6)
    assert np.any(errors_s > alone_s)


@pytest.mark.parametrize("interval_ns", [1, 1_000_000])
def test_new_values_in_each_frame_add_nothing_to_the_error_of_the_stamps(interval_ns: int) -> None:
    with StreamServer(renewing(interval_ns)) as server, running(stream(server.port)) as reader:
        _, limits_s, alone_s = read_ticks(reader).T
        assert np.median(limits_s - alone_s) == 0.0
        assert not reader.state.fault
