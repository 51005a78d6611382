# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Clock of a device against the arrivals of its frames, simulated with a seed."""

from __future__ import annotations

import numpy as np
import pytest
from posor_drivers.instruments.clock_mapping import ClockMapping

START_NS = 1_800_000_000_000_000_000
DRIFT = 50e-6
FIRST = 4_000_000_000
SEEDS = 20
STEP_AT_S = 12.0


def errors_and_uncertainties(
    rate: int, seconds: float, delays_s: np.ndarray, *, ordered: bool, step_s: float = 0.0
) -> np.ndarray:
    """Return time, error of the newest stamp, its stated uncertainty and limit [s] of each tenth frame, (n, 4).

    ``step_s``: of the clock of this host, or pause of the device, at STEP_AT_S.
    """
    mapping, rows = ClockMapping(rate), []
    numbers = np.arange(int(seconds * rate))
    exposed = START_NS + np.rint(numbers * (1e9 / rate * (1.0 + DRIFT))).astype(np.int64)
    exposed[numbers > STEP_AT_S * rate] += round(1e9 * step_s)
    arrived = exposed + np.rint(1e9 * delays_s[: len(numbers)]).astype(np.int64)
    for n, arrived_ns in enumerate(np.maximum.accumulate(arrived) if ordered else arrived):
        mapping.add(FIRST + n, int(arrived_ns))
        if mapping.line is not None and n % 10 == 0:
            (stamp_ns,) = mapping.line.times_ns(np.array([FIRST + n]))
            error_s = (stamp_ns - int(exposed[n])) * 1e-9
            rows.append((n / rate, error_s, mapping.line.uncertainty_s, mapping.line.limit_s))
    return np.array(rows)


def exponential(seed: int, mean_s: float, count: int) -> np.ndarray:
    return np.random.default_rng(seed).exponential(mean_s, count)


@pytest.mark.parametrize(("order", "limit_s"), [("any", 20e-6), ("kept", 60e-6)])
def test_stamps_are_far_more_exact_than_arrivals(order: str, limit_s: float) -> None:
    """Delays of 2 ms; frames that wait for the ones before arrive later, so fewer of them show the least delay."""
    worst, inside = [], []
    for seed in range(SEEDS):
        rows = errors_and_uncertainties(1000, 8.0, exponential(seed, 2e-3, 8000), ordered=order == "kept")
        late = rows[rows[:, 0] > 5.0]
        worst.append(np.abs(late[:, 1]).max())
        inside.append(np.mean(np.abs(rows[:, 1]) <= 2.0 * rows[:, 2]))
    within = sum(error < 20e-6 for error in worst)
    print(
        f"simulated, {order} order, largest error after 5 s of {SEEDS} seeds: median {1e6 * np.median(worst):.1f} us, "
        f"at most {1e6 * max(worst):.1f} us; {within} of {SEEDS} seeds below 20 us"
    )
    assert max(worst) < limit_s
    assert np.median(worst) < 20e-6
    assert np.mean(inside) >= 0.95


def test_a_clock_without_delays_is_found_exactly() -> None:
    rows = errors_and_uncertainties(100, 3.0, np.zeros(300), ordered=True)
    assert np.abs(rows[:, 1]).max() < 2e-9
    assert rows[:, 2].max() < 2e-9


def test_a_long_pause_of_the_network_changes_nothing() -> None:
    delays_s = exponential(1, 1e-4, 4000)
    delays_s[2000:2200] += 0.2
    rows = errors_and_uncertainties(1000, 4.0, delays_s, ordered=True)
    assert np.abs(rows[:, 1]).max() < 20e-6


@pytest.mark.parametrize("step_s", [0.05, 0.005, 0.001, -0.005, -0.05])
def test_a_step_of_the_clock_is_in_the_uncertainty_until_the_line_fits_again(step_s: float) -> None:
    delays_s = exponential(1, 1e-4, 30_000)
    rows = errors_and_uncertainties(1000, 30.0, delays_s, ordered=False, step_s=step_s)
    times_s, (errors_s, sigmas_s, limits_s) = rows[:, 0], np.abs(rows[:, 1:].T)
    before, later = (times_s > 5.0) & (times_s < STEP_AT_S), times_s > STEP_AT_S + 16.0
    known = np.abs(times_s - STEP_AT_S - 0.1) > 0.1  # two intervals show it
    assert np.all(errors_s[known] <= limits_s[known] + 5e-6)
    assert np.all(errors_s[known] <= 3.0 * sigmas_s[known] + 5e-6)
    assert errors_s.max() > 0.9 * abs(step_s)
    assert max(sigmas_s[before].max(), sigmas_s[later].max()) < 20e-6


@pytest.mark.parametrize("rate", [100, 1000])
def test_the_first_mapping_states_its_errors(rate: int) -> None:
    beyond_limit, beyond_5_sigma = [], []
    for seed in range(SEEDS):
        rows = errors_and_uncertainties(rate, 1.6, exponential(seed, 2e-3, 2 * rate), ordered=True)
        beyond_limit.append(np.abs(rows[:, 1]) > rows[:, 3])
        beyond_5_sigma.append(np.abs(rows[:, 1]) > 5.0 * rows[:, 2])
    assert np.mean(np.concatenate(beyond_limit)) < 0.01
    assert not np.concatenate(beyond_5_sigma).any()


@pytest.mark.parametrize(("rate", "start_s"), [(1, 9.0), (4, 5.1), (100, 1.1)])
def test_a_slow_device_is_mapped_by_fewer_frames(rate: int, start_s: float) -> None:
    delays_s = exponential(1, 1e-3, 40 * rate)
    mapping, first_s = ClockMapping(rate), None
    for n in range(40 * rate):
        mapping.add(n, START_NS + round(1e9 * (n / rate + delays_s[n])))
        if mapping.line is not None:
            first_s = n / rate if first_s is None else first_s
            error_s = (int(mapping.line.times_ns(np.array([n]))[0]) - START_NS) * 1e-9 - n / rate
            assert abs(error_s) <= mapping.line.limit_s + 5e-4
    assert first_s is not None
    assert first_s <= start_s


def test_there_is_no_mapping_in_the_first_second() -> None:
    mapping = ClockMapping(100)
    for n in range(95):
        mapping.add(n, START_NS + n * 10_000_000)
        assert mapping.line is None
