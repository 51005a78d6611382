# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Scan numbers against stamps: late scans, clock steps, scattered stamps, restarts; and exposures within a scan.

The truth is the motion that the scans are simulated with, as geometry.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from posor import Calibration, Estimates, Fault, Posor, Scans, State, load_calibration, simulate
from posor.estimation.clocks import FAILED_LINES, FITTED_SCANS, LATE_RUN, NEW_RATE_RUN, RESTART_RUN, SETTLING_SCANS
from posor.estimation.time_errors import LONGEST_OFFSET_S
from scipy.stats import chi2

Array = NDArray[Any]

ARMS = Path(__file__).resolve().parents[3] / "posor_bringup" / "arms"
JOINTS = {"bumpy ring": "five_axis/calibrations/elbow.yaml", "light ring": "six_axis/calibrations/shoulder.yaml"}
PERIOD_S, COUNT, AT = 5e-3, 400, 200  # period, scans, scan at which the fault begins
RATE, FAST, START, FIRST_NS = 0.7, 2.4, 0.1, 10**18  # [rad/s], [rad/s], [rad], [ns]
INDEX = np.arange(COUNT)
JUMP = 450e-6  # of the gap [m]


@cache
def calibration_of(kind: str) -> Calibration:
    return load_calibration(ARMS / JOINTS[kind])


def poses(times: Array, rate: float = RATE) -> Array:
    """Return the true poses at times [s], shape (n, 7)."""
    theta = START + rate * times
    out = np.zeros((len(times), 7))
    out[:, 0], out[:, 1], out[:, 2] = 4e-6 * np.cos(theta), 4e-6 * np.sin(theta), 0.735e-3
    out[:, 5], out[:, 6] = np.sin(0.5 * theta), np.cos(0.5 * theta)
    return out


@cache
def simulated(kind: str, rate: float = RATE) -> Scans:
    """Return scans of a joint that turns."""
    return simulate(calibration_of(kind), poses(INDEX * PERIOD_S, rate), seed=1)


def estimate(kind: str, times: Array, numbers: Array, scans: Scans) -> Estimates:
    """Estimate scans that arrive in this order; a reference counts theta at the first."""
    fields = {"stamps_ns": FIRST_NS + np.round(times * 1e9).astype(np.int64), "numbers": numbers.astype(np.uint64)}
    posor = Posor(calibration_of(kind), false_alarm=1e-9)
    posor.confirm_theta(START, 1e-4)
    return posor.estimate_all(scans.with_fields(fields))


def usable(estimates: Estimates) -> Array:
    return np.isin(estimates.states, (State.OK, State.DEGRADED))


def errors(estimates: Estimates, true: Array) -> Array:
    """Return small errors of the usable poses: translation [m] and theta [rad], shape (n, 4)."""
    which = usable(estimates)
    turned = 2.0 * (np.arctan2(true[which, 5], true[which, 6]))
    theta = np.angle(np.exp(1j * (estimates.thetas[which] - turned)))
    return np.column_stack([estimates.translations[which] - true[which, :3], theta])


def count_wrong(estimates: Estimates, true: Array) -> int:
    """Return how many usable poses are off by more than 5 standard uncertainties."""
    sigmas = estimates.standard_uncertainties[usable(estimates)][:, [0, 1, 2, 5]]
    return int((np.abs(errors(estimates, true)) > 5.0 * sigmas).any(axis=1).sum())


def exchange(first: int, second: int) -> Array:
    """Return the order in which scan ``first`` arrives behind ``second``."""
    return np.insert(np.delete(INDEX, first), second, first)


WRONG_BUMP = ("twelve late by 100", "clock stands for 40 scans", "number stands")
"""Cases in which a bumpy ring loses its count in motion, and scans on the wrong bump are LOST as well."""
# Order of arrival, shift of the stamps [s], numbers, and scans lost of a light ring, apart from a count that is lost
CASES: dict[str, tuple[Array, Array, Array, int]] = {
    "in order": (INDEX, 0.0 * INDEX, INDEX, 0),
    "one late by one": (exchange(AT, AT + 1), 0.0 * INDEX, INDEX, 1),
    "one late by 150": (exchange(AT, AT + 150), 0.0 * INDEX, INDEX, 1),
    "one stamp off": (INDEX, np.where(INDEX == AT, 0.3, 0.0), INDEX, 1),
    **{
        f"clock steps by {step:g} s": (INDEX, np.where(INDEX >= AT, step, 0.0), INDEX, LATE_RUN - 1)
        for step in (-37.0, -1.5, -0.9, -0.5, -0.05, -0.045, -0.02, 0.02, 0.3, 37.0)
    },
    "twelve late by 100": (np.r_[:AT, AT + 12 : AT + 100, AT : AT + 12, AT + 100 : COUNT], 0.0 * INDEX, INDEX, 2),
    "clock stands for 40 scans": (INDEX, np.maximum(-40.0 * PERIOD_S, np.minimum(0, AT - INDEX) * PERIOD_S), INDEX, 40),
    "every scan twice": (np.repeat(INDEX[: COUNT // 2], 2), 0.0 * INDEX, INDEX, COUNT // 2),
    "number stands": (INDEX, 0.0 * INDEX, np.minimum(INDEX, AT), LATE_RUN - 1),
    "numbers become zero": (INDEX, 0.0 * INDEX, np.where(INDEX < AT, INDEX, 0), RESTART_RUN - 1),
    "numbers jump": (INDEX, 0.0 * INDEX, np.where(INDEX >= AT, INDEX + 5000, INDEX), LATE_RUN - 1),
    "numbers jump back": (INDEX, 0.0 * INDEX, np.where(INDEX >= AT, INDEX - 7, INDEX), LATE_RUN - 1),
    "driver restarts, stamps two ticks back": (
        INDEX,
        np.where(INDEX >= AT, -2.0 * PERIOD_S, 0.0),
        np.where(INDEX >= AT, INDEX - AT, INDEX),
        RESTART_RUN - 1,
    ),
    **{
        f"interval grows by {share:g}": (INDEX, np.maximum(0, share * PERIOD_S * (INDEX - AT)), INDEX, NEW_RATE_RUN)
        for share in (0.2, 1.0)
    },
    "interval shrinks by 0.2": (INDEX, np.minimum(0, 0.2 * PERIOD_S * (AT - INDEX)), INDEX, NEW_RATE_RUN),
}


@pytest.mark.parametrize("kind", JOINTS)
@pytest.mark.parametrize("name", CASES)
def test_clocks_that_contradict_each_other_cost_few_scans_and_give_no_wrong_pose(kind: str, name: str) -> None:
    order, shift, numbers, most = CASES[name]
    times = INDEX * PERIOD_S + shift
    estimates = estimate(kind, times[order], numbers[order], simulated(kind).select(order))
    assert count_wrong(estimates, poses(INDEX * PERIOD_S)[order]) == 0
    lost = int((estimates.states == State.LOST).sum())
    refused = int((estimates.faults & Fault.BAD_READING).astype(bool).sum())
    assert (refused if kind == "bumpy ring" and name in WRONG_BUMP else lost) <= most
    if kind == "light ring" or most <= 1:
        assert usable(estimates).sum() == COUNT - lost


@pytest.mark.parametrize("name", CASES)
def test_a_clock_fault_in_fast_motion_is_no_jump_of_the_pose(name: str) -> None:
    order, shift, numbers, most = CASES[name]
    times = INDEX * PERIOD_S + shift
    estimates = estimate("light ring", times[order], numbers[order], simulated("light ring", FAST).select(order))
    assert count_wrong(estimates, poses(INDEX * PERIOD_S, FAST)[order]) == 0
    assert usable(estimates).sum() >= COUNT - most


@pytest.mark.parametrize("name", ["one stamp off", "clock steps by 0.3 s", "clock steps by -0.5 s", "numbers jump"])
def test_a_stamp_that_contradicts_its_number_is_refused(name: str) -> None:
    order, shift, numbers, most = CASES[name]
    estimates = estimate("light ring", INDEX * PERIOD_S + shift, numbers, simulated("light ring").select(order))
    assert set(estimates.faults[AT : AT + most]) == {Fault.BAD_READING}
    assert "contradicts its number" in estimates.reason(AT)


def test_a_pause_in_which_the_clocks_drift_costs_no_scan() -> None:
    numbers = np.where(INDEX >= AT, INDEX + 720_000, INDEX)  # an hour
    times = PERIOD_S * (numbers + 5e-5 * (numbers - INDEX))
    estimates = estimate("light ring", times, numbers, simulated("light ring"))
    assert usable(estimates).all()
    assert not estimates.stamp_shifts.any()
    assert count_wrong(estimates, poses(INDEX * PERIOD_S)) == 0


@pytest.mark.parametrize("pause_s", [0.05, 3600.0])
def test_a_bumpy_ring_is_uncounted_after_a_pause_in_motion(pause_s: float) -> None:
    numbers = np.where(INDEX >= AT, INDEX + round(pause_s / PERIOD_S), INDEX)
    scans = simulated("bumpy ring").editable()
    scans.at_home[AT + 100 :] = 0
    estimates = estimate("bumpy ring", PERIOD_S * numbers, numbers, scans)
    assert set(estimates.states[:AT]) == {State.OK}
    assert set(estimates.states[AT:]) == {State.UNCOUNTED}


@pytest.mark.parametrize("bumps", [0.7, 1.4, 5.0, 12.0])
def test_a_bumpy_ring_that_turned_in_a_pause_is_not_latched_and_counted_again(bumps: float) -> None:
    """Its bumps are not alike, so sound readings contradict one another at a wrong one."""
    calibration = load_calibration(ARMS / "five_axis_checked/calibrations/elbow.yaml")
    posor = Posor(calibration, false_alarm=1e-9)
    numbers = np.where(INDEX >= AT, INDEX + round(bumps * float(posor.settings["bump_angle"]) / RATE / PERIOD_S), INDEX)
    true = poses(numbers * PERIOD_S)
    stamps_ns = FIRST_NS + np.round(numbers * PERIOD_S * 1e9).astype(np.int64)
    fields = {"stamps_ns": stamps_ns, "numbers": numbers.astype(np.uint64)}
    scans = simulate(calibration, true, seed=1).with_fields(fields)
    posor.confirm_theta(START, 1e-4)
    found = posor.estimate_all(scans.part(0, COUNT - 50))
    assert set(found.states[:AT]) == {State.OK}
    assert not usable(found)[AT:].any()
    assert not posor.has_latch
    for n in range(COUNT - 50, COUNT):
        posor.confirm_theta(START + RATE * float(numbers[n]) * PERIOD_S, 1e-4)
        last = posor.estimate(scans[n])
    assert last.state is State.OK
    assert last.native[5] == pytest.approx(START + RATE * float(numbers[-1]) * PERIOD_S, abs=1e-5)


@pytest.mark.parametrize("size", [2, 4])
@pytest.mark.parametrize("kind", JOINTS)
def test_bursts_from_the_first_scan_on_cost_few_scans(kind: str, size: int) -> None:
    arrival = PERIOD_S * (INDEX - INDEX % size + size - 1) + 1e-5 * (INDEX % size)
    estimates = estimate(kind, arrival, INDEX, simulated(kind))
    after = estimates.select(slice(FAILED_LINES * size, None))
    assert not (after.faults & (Fault.BAD_READING | Fault.INNOVATION)).any()
    if kind == "light ring":  # the ring is uncounted, on another bump
        assert set(after.states) == {State.DEGRADED}
        assert count_wrong(after, poses(arrival)[FAILED_LINES * size :]) == 0


def test_a_home_mark_that_counts_anew_does_not_pass_a_jump_of_the_gaps() -> None:
    """The clock goes back at a home mark, so theta is counted anew at once."""
    _, shift, numbers, _ = CASES["driver restarts, stamps two ticks back"]
    jumped = poses(INDEX * PERIOD_S)
    jumped[AT:, 2] += JUMP
    calibration = calibration_of("bumpy ring")
    scans = simulated("bumpy ring").with_fields({"gap_voltages": simulate(calibration, jumped, seed=1).gap_voltages})
    posor = Posor(calibration, false_alarm=1e-9)
    posor.settings["home_theta"] = START + RATE * AT * PERIOD_S
    fields = {"stamps_ns": FIRST_NS + np.round((INDEX * PERIOD_S + shift) * 1e9).astype(np.int64)}
    at_home = (np.abs(INDEX - AT) < 8).astype(np.int64)
    posor.confirm_theta(START, 1e-4)
    found = posor.estimate_all(scans.with_fields({**fields, "numbers": numbers.astype(np.uint64), "at_home": at_home}))
    assert set(found.states[:AT]) == {State.OK}
    assert set(found.states[AT:]) == {State.LOST}
    assert found.faults[AT + RESTART_RUN - 1] & Fault.INNOVATION


@pytest.mark.parametrize("name", ["one late by one", "one stamp off", "driver restarts, stamps two ticks back"])
def test_a_jump_beside_a_clock_fault_is_seen(name: str) -> None:
    order, shift, numbers, _ = CASES[name]
    jumped = poses(INDEX * PERIOD_S)
    jumped[AT:, 2] += JUMP
    biased = simulate(calibration_of("light ring"), jumped, seed=1).gap_voltages
    scans = simulated("light ring").with_fields({"gap_voltages": biased})
    estimates = estimate("light ring", (INDEX * PERIOD_S + shift)[order], numbers[order], scans.select(order))
    assert count_wrong(estimates, poses(INDEX * PERIOD_S)[order]) == 0
    assert not usable(estimates)[AT + 2 :].any()
    assert estimates.faults[-1] & Fault.INNOVATION


@pytest.mark.parametrize(
    ("name", "step"), [("clock steps by -0.05 s", 0.05), ("driver restarts, stamps two ticks back", 2.0 * PERIOD_S)]
)
def test_stamps_that_were_set_may_be_wrong_by_the_step_until_it_is_acknowledged(name: str, step: float) -> None:
    _, shift, numbers, _ = CASES[name]
    posor = Posor(calibration_of("light ring"), false_alarm=1e-9)
    fields = {"stamps_ns": FIRST_NS + np.round((INDEX * PERIOD_S + shift) * 1e9).astype(np.int64)}
    scans = simulated("light ring").with_fields({**fields, "numbers": numbers.astype(np.uint64)})
    found = posor.estimate_all(scans.part(0, COUNT - 1))
    assert not found.stamp_shifts[AT - 1].any()
    assert found.stamp_shifts[-1, 5] >= RATE * step
    reloaded = Posor(calibration_of("light ring"), false_alarm=1e-9)
    reloaded.continue_from(posor, scans[COUNT - 2])  # a new calibration knows no more of the clock
    assert reloaded.estimate_all(scans.part(COUNT - 1, COUNT)).stamp_shifts[0, 5] >= RATE * step
    elsewhere = Posor(calibration_of("light ring"), false_alarm=1e-9)
    elsewhere.settings["home_theta"] += 1e-3  # another home mark: the pose is not taken
    elsewhere.continue_from(posor, scans[COUNT - 2])
    assert elsewhere.tracker["clocks"]["step"] == posor.tracker["clocks"]["step"]
    assert posor.acknowledge()
    assert not posor.acknowledge()
    assert not posor.estimate_all(scans.part(COUNT - 1, COUNT)).stamp_shifts.any()


def test_a_step_of_the_stamps_stays_when_a_latch_is_acknowledged() -> None:
    _, shift, numbers, _ = CASES["clock steps by -0.05 s"]
    jumped = poses(INDEX * PERIOD_S)
    jumped[COUNT - 50 :, 2] += JUMP
    fields = {"stamps_ns": FIRST_NS + np.round((INDEX * PERIOD_S + shift) * 1e9).astype(np.int64)}
    scans = simulate(calibration_of("light ring"), jumped, seed=1)
    scans = scans.with_fields({**fields, "numbers": numbers.astype(np.uint64)})
    posor = Posor(calibration_of("light ring"), false_alarm=1e-9)
    posor.estimate_all(scans.part(0, COUNT - 20))
    assert posor.latched & Fault.INNOVATION
    assert posor.acknowledge()
    assert posor.estimate_all(scans.part(COUNT - 20, COUNT - 10)).stamp_shifts[-1, 5] >= RATE * 0.05
    assert posor.acknowledge()
    assert not posor.has_latch


@pytest.mark.parametrize("kind", JOINTS)
@pytest.mark.parametrize("bumps", [0.1, 1.0])
@pytest.mark.parametrize("back", range(5, LATE_RUN))
def test_numbers_and_stamps_that_go_back_together_give_no_wrong_count(kind: str, back: int, bumps: float) -> None:
    """A driver that numbers scans by the clock of its host, which is set back while the ring turns by some bumps."""
    rate = bumps * float(Posor(calibration_of("bumpy ring")).settings["bump_angle"]) / (back * PERIOD_S)
    numbers = np.where(INDEX >= AT, INDEX - back, INDEX)
    estimates = estimate(kind, numbers * PERIOD_S, numbers + 1000, simulated(kind, rate))
    assert (usable(estimates) & (INDEX < AT)).sum() == AT
    assert count_wrong(estimates, poses(INDEX * PERIOD_S, rate)) == 0
    after = usable(estimates) & (INDEX >= AT + LATE_RUN)
    assert after.any() == (kind == "light ring")
    assert (estimates.stamp_shifts[after, 5] >= rate * back * PERIOD_S).all()


@pytest.mark.parametrize("back", range(1, LATE_RUN))
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_step_back_by_part_of_an_interval_more_than_numbers_repeat_is_in_the_bound(back: int, share: float) -> None:
    """A driver whose scans are at the ticks of its clock waits for the next tick once the clock is set back."""
    step = (back + share) * PERIOD_S
    times = INDEX * PERIOD_S + np.where(INDEX >= AT, share * PERIOD_S, 0.0)
    numbers = np.where(INDEX >= AT, INDEX - back, INDEX)
    true = poses(times)
    scans = simulate(calibration_of("light ring"), true, seed=1)
    estimates = estimate("light ring", numbers * PERIOD_S, numbers + 1000, scans)
    assert count_wrong(estimates, true) == 0
    after = usable(estimates) & (INDEX >= AT + LATE_RUN)
    assert after.sum() == COUNT - AT - LATE_RUN
    assert (estimates.stamp_shifts[after, 5] >= RATE * step).all()


@pytest.mark.parametrize(("first", "is_live"), [(AT + 1, False), (AT, True)])
def test_a_step_back_is_in_the_bound_where_repeated_scans_are_missing(first: int, *, is_live: bool) -> None:
    """The first repeated number shows it; where that scan is missing too, the ages of live scans do."""
    back = 9
    numbers, arrived = np.where(INDEX >= AT, INDEX - back, INDEX), np.delete(INDEX, np.arange(first, AT + back - 2))
    fields = {"stamps_ns": FIRST_NS + np.round(numbers * PERIOD_S * 1e9).astype(np.int64)}
    scans = simulated("light ring").with_fields({**fields, "numbers": (numbers + 1000).astype(np.uint64)})
    posor = Posor(calibration_of("light ring"), false_alarm=1e-9)
    posor.confirm_theta(START, 1e-4)
    for n in arrived.tolist():
        posor.tracker["clocks"]["age"] = 1e-3 + back * PERIOD_S * (n >= AT) if is_live else np.nan
        estimate = posor.estimate(scans[n])
        if n >= AT + back:
            assert estimate.state in (State.OK, State.DEGRADED)
            assert estimate.stamp_shift[5] >= RATE * back * PERIOD_S


@pytest.mark.parametrize("count", range(1, 6))
def test_the_last_scans_delivered_again_in_order_cost_only_themselves(count: int) -> None:
    again = np.arange(AT - count, AT)
    arrived = np.insert(INDEX, AT, again)
    scans = simulated("light ring")
    estimates = estimate("light ring", arrived * PERIOD_S, arrived + 1000, scans.select(arrived))
    assert np.flatnonzero(~usable(estimates)).tolist() == (AT + np.arange(count)).tolist()


def test_a_slow_ring_is_uncounted_where_numbers_go_back_and_most_repeated_scans_are_missing() -> None:
    """It turns by a bump while the clock repeats nine numbers, but by less than half a bump in the time of two."""
    calibration, back = calibration_of("bumpy ring"), 9
    assert calibration.motion is not None
    bump = float(Posor(calibration).settings["bump_angle"])
    rate = bump / (back * PERIOD_S)
    limit = calibration.motion.theta.model_copy(update={"value": 1.1 * rate})
    motion = calibration.motion.model_copy(update={"theta": limit})
    posor = Posor(calibration.model_copy(update={"motion": motion}), false_alarm=1e-9)
    posor.confirm_theta(START, 1e-4)
    numbers = np.where(INDEX >= AT, INDEX - back, INDEX)
    arrived = np.delete(INDEX, np.arange(AT, AT + back - 2))
    stamps_ns = FIRST_NS + np.round(numbers * PERIOD_S * 1e9).astype(np.int64)
    scans = simulated("bumpy ring", rate).with_fields({"stamps_ns": stamps_ns, "numbers": numbers.astype(np.uint64)})
    estimates = posor.estimate_all(scans.select(arrived))
    assert (usable(estimates) == (arrived < AT)).all()


@pytest.mark.parametrize("back", [12, 60, 180])
def test_numbers_and_stamps_that_go_back_far_are_a_step_where_the_scans_are_older_on_arrival(back: int) -> None:
    numbers, step = np.where(INDEX >= AT, INDEX - back, INDEX), back * PERIOD_S
    fields = {"stamps_ns": FIRST_NS + np.round(numbers * PERIOD_S * 1e9).astype(np.int64)}
    scans = simulated("light ring").with_fields({**fields, "numbers": (numbers + 1000).astype(np.uint64)})
    for is_live in (True, False):
        posor = Posor(calibration_of("light ring"), false_alarm=1e-9)
        for n in range(COUNT - back):
            posor.tracker["clocks"]["age"] = 1e-3 + step * (n >= AT) if is_live else np.nan
            estimate = posor.estimate(scans[n])
        assert estimate.state is State.OK
        assert (estimate.stamp_shift[5] >= RATE * step) == is_live


@pytest.mark.parametrize("late_s", [0.2, 0.95])
def test_a_reference_from_before_a_slip_does_not_confirm_it(late_s: float) -> None:
    scans = simulate(calibration_of("light ring"), poses(np.where(INDEX >= AT, 0.2, 0.0), 1.0), seed=1)
    stamps_ns = FIRST_NS + np.round(INDEX * PERIOD_S * 1e9).astype(np.int64)
    scans = scans.with_fields({"stamps_ns": stamps_ns, "numbers": INDEX.astype(np.uint64)})
    posor = Posor(calibration_of("light ring"), false_alarm=1e-9)
    posor.estimate_all(scans.part(0, AT + 10))
    assert posor.latched & Fault.INNOVATION
    for n in range(AT + 10, COUNT):
        posor.confirm_theta(START, 1e-3, int(stamps_ns[n]) - round(late_s * 1e9))
        assert posor.estimate(scans[n]).state is State.LOST
    posor.acknowledge()
    posor.estimate(scans[COUNT - 2])
    posor.confirm_theta(START, 1e-3, int(stamps_ns[COUNT - 1]) - round(late_s * 1e9))
    assert posor.estimate(scans[COUNT - 1]).faults & Fault.ACKNOWLEDGED


def test_a_clock_that_is_set_back_and_forth_is_no_scatter() -> None:
    """Else a later step within the scatter would pass."""
    is_back = INDEX // 25 % 4 == 3
    found = estimate("light ring", (INDEX - 2.65 * is_back) * PERIOD_S, INDEX, simulated("light ring"))
    steps = int(np.count_nonzero(np.diff(is_back)))
    assert np.count_nonzero(found.states == State.LOST) == steps * (LATE_RUN - 1)


@pytest.mark.parametrize("first", [SETTLING_SCANS, 8, FITTED_SCANS - 1])
def test_a_step_of_the_clock_within_the_first_scans_is_no_scatter(first: int) -> None:
    """Else poses before the step are at wrong times, and a later step within the scatter passes."""
    shift = np.where(first > INDEX, 4.15, 0.0) - np.where((INDEX >= AT) & (INDEX < AT + 25), 2.65, 0.0)
    found = estimate("light ring", (INDEX + shift) * PERIOD_S, INDEX, simulated("light ring"))
    assert (found.stamp_shifts[first + LATE_RUN : AT, 5] > 0.0).all()
    assert np.count_nonzero(found.states[AT : AT + 25] == State.LOST) == LATE_RUN - 1


def test_steps_of_the_stamps_add_up_to_their_largest_error() -> None:
    steps = 0.02 * (np.maximum(0, INDEX - AT) // 30)
    estimates = estimate("light ring", INDEX * PERIOD_S + steps, INDEX, simulated("light ring"))
    assert usable(estimates)[-1]
    assert estimates.stamp_shifts[-1, 5] >= RATE * steps[-1]


@pytest.mark.parametrize("name", ["interval grows by 0.2", "interval grows by 1", "interval shrinks by 0.2"])
def test_another_rate_is_no_scatter_of_the_stamps(name: str) -> None:
    _, shift, numbers, most = CASES[name]
    estimates = estimate("light ring", INDEX * PERIOD_S + shift, numbers, simulated("light ring"))
    assert set(estimates.states[AT + most + 4 :]) == {State.OK}  # the first three are within the tolerance


def test_two_steps_of_the_stamps_are_as_large_as_one_of_their_sum() -> None:
    shifts = []
    for steps in (0.1 * (INDEX >= 100) + 0.1 * (INDEX >= 250), 0.2 * (INDEX >= 250)):
        estimates = estimate("light ring", INDEX * PERIOD_S + steps, INDEX, simulated("light ring"))
        assert usable(estimates)[-1]
        shifts.append(estimates.stamp_shifts[-1])
    np.testing.assert_allclose(shifts[0], shifts[1], rtol=1e-3)


@pytest.mark.parametrize("kind", JOINTS)
@pytest.mark.parametrize("scatter", [0.06, 0.2])
def test_stamps_on_arrival_degrade_with_a_covariance_that_holds(kind: str, scatter: float) -> None:
    rng = np.random.default_rng(7)
    times = INDEX * PERIOD_S
    arrival = np.maximum.accumulate(times + scatter * PERIOD_S * rng.standard_normal(COUNT) + 1e-9 * INDEX)
    estimates = estimate(kind, arrival, INDEX, simulated(kind))
    assert usable(estimates).mean() >= 0.95
    turned = errors(estimates, poses(arrival))[50:, 3]  # the pose at the stamp, not at the exposure
    normalised = np.square(turned / estimates.standard_uncertainties[usable(estimates)][50:, 5])
    assert chi2.ppf(1e-4, len(turned)) * 0.7 <= normalised.sum() <= chi2.ppf(1.0 - 1e-4, len(turned)) * 1.3
    assert estimates.faults[-1] & Fault.TIME


def test_stamps_that_begin_to_scatter_give_no_wrong_pose() -> None:
    times = INDEX * PERIOD_S
    scattered = np.where(INDEX < AT, times, times + 0.2 * PERIOD_S * np.random.default_rng(3).standard_normal(COUNT))
    estimates = estimate("light ring", np.maximum.accumulate(scattered), INDEX, simulated("light ring"))
    assert count_wrong(estimates, poses(np.maximum.accumulate(scattered))) == 0
    assert usable(estimates).mean() >= 0.95


@pytest.mark.parametrize(
    "arrival",
    [
        PERIOD_S * (INDEX - INDEX % 3 + 2) + 1e-5 * (INDEX % 3),
        PERIOD_S * (INDEX - INDEX % 8 + 7) + 1e-5 * (INDEX % 8),
        PERIOD_S * (INDEX - INDEX % 2),
    ],
    ids=["bursts of 3", "bursts of 8", "steps of 10 ms"],
)
def test_stamps_that_begin_to_scatter_by_more_than_half_an_interval_cost_few_scans(arrival: Array) -> None:
    arrival = np.where(INDEX < AT, INDEX * PERIOD_S, arrival)
    estimates = estimate("light ring", arrival, INDEX, simulated("light ring"))
    assert count_wrong(estimates, poses(arrival)) == 0
    assert (estimates.states == State.LOST).sum() <= 20
    assert set(estimates.states[AT + 40 :]) == {State.DEGRADED}


def test_a_jump_by_stamps_that_scatter_from_the_first_scan_on_is_forgotten() -> None:
    times = INDEX * PERIOD_S
    arrival = np.maximum.accumulate(times + 0.5 * PERIOD_S * np.random.default_rng(5).standard_normal(COUNT))
    arrival[1] = arrival[0] + 1e-9
    estimates = estimate("light ring", arrival + 1e-9 * INDEX, INDEX, simulated("light ring"))
    assert estimates.faults[1] & Fault.INNOVATION
    assert set(estimates.states[FITTED_SCANS + 5 :]) == {State.DEGRADED}


def test_a_stated_uncertainty_of_the_stamps_enters_the_random_covariance() -> None:
    scans = simulated("light ring")
    times = INDEX * PERIOD_S
    stated = scans.with_fields({"stamp_uncertainties": np.full(COUNT, 1e-4)})
    plain, grown = (estimate("light ring", times, INDEX, each).covariances_random[-1] for each in (scans, stated))
    assert grown[5, 5] - plain[5, 5] == pytest.approx((1e-4 * RATE) ** 2, rel=0.05)


def multiplexed(kind: str, rate: float, offsets: Array) -> Scans:
    """Return scans whose channels are read at their own times, in the order gap, ring, currents."""
    scans = simulated(kind, rate)
    calibration = calibration_of(kind)
    names = ("gap_voltages", "ring_voltages", "diode_currents")
    flat = {name: getattr(scans, name).reshape(COUNT, -1).copy() for name in names}
    channels = [(name, column) for name in names for column in range(flat[name].shape[1])]
    for offset, (name, column) in zip(offsets, channels, strict=True):
        moved = simulate(calibration, poses(INDEX * PERIOD_S + offset, rate), seed=1)
        same = (moved.lit_sources == scans.lit_sources).all(axis=1)
        flat[name][same, column] = getattr(moved, name).reshape(COUNT, -1)[same, column]
    shapes = {name: getattr(scans, name).shape for name in names}
    return scans.with_fields({name: flat[name].reshape(shapes[name]) for name in names if flat[name].size})


@pytest.mark.parametrize(
    ("kind", "conversion_s", "rate", "stated"),
    [
        *product(JOINTS, [20e-6], [1.0], [True, False]),
        ("bumpy ring", 100e-6, FAST, True),  # of the thesis, 8.3.3; the readings are far from linear in time
    ],
)
def test_channels_read_one_after_another(kind: str, conversion_s: float, rate: float, stated: bool) -> None:  # noqa: FBT001
    times = INDEX * PERIOD_S
    plain = simulated(kind, rate)
    channels = sum(getattr(plain, name)[0].size for name in ("gap_voltages", "ring_voltages", "diode_currents"))
    offsets = conversion_s * (np.arange(channels) - 0.5 * (channels - 1))
    statement = {"exposure_offsets": np.tile(offsets if stated else np.full(channels, np.nan), (COUNT, 1))}
    statement |= {"exposure_spans": np.full(COUNT, np.ptp(offsets))}
    scans = multiplexed(kind, rate, offsets).with_fields(statement)
    true = poses(times, rate)
    read, ideal = (estimate(kind, times, INDEX, each) for each in (scans, plain))
    lit = plain.lit_sources  # where one changes within the scan, ``multiplexed`` leaves the readings as they are
    steady = (
        (INDEX >= 10) & (lit == np.roll(lit, 1, axis=0)).all(axis=1) & (lit == np.roll(lit, -1, axis=0)).all(axis=1)
    )
    if stated:
        off, expected = (np.sqrt(np.mean(np.square(errors(each, true)[steady]), axis=0)) for each in (read, ideal))
        np.testing.assert_allclose(off, expected, rtol=0.05)
        assert usable(read).sum() == usable(ideal).sum()
    else:
        inside = np.abs(errors(read, true)) <= 1.96 * read.standard_uncertainties[usable(read)][:, [0, 1, 2, 5]]
        assert inside.mean(axis=0).min() >= 0.93
        assert not (read.states == State.OK)[10:].any()


def with_offsets(count: int, value: float) -> Callable[[Scans], Scans]:
    return lambda scans: scans.with_fields({"exposure_offsets": np.full((COUNT, count), value)})


@pytest.mark.parametrize(
    "change",
    [
        with_offsets(3, 0.0),
        with_offsets(11, 2.0 * LONGEST_OFFSET_S),
        lambda scans: scans.with_fields({"stamp_uncertainties": np.full(COUNT, np.nan)}),
        lambda scans: scans.with_fields({"stamp_limits": np.full(COUNT, -1.0)}),
    ],
    ids=["count", "size", "uncertainty", "limit"],
)
def test_an_invalid_statement_on_time_is_refused(change: Callable[[Scans], Scans]) -> None:
    estimates = estimate("light ring", INDEX * PERIOD_S, INDEX, change(simulated("light ring")))
    assert set(estimates.faults) == {Fault.BAD_READING}
    assert "exposures" in estimates.reason(0)
