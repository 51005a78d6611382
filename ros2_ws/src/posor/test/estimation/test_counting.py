# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The bumpy ring: counting theta in bumps, the home mark, reversals, and what three probes cannot see."""

from __future__ import annotations

import math

import numpy as np
import pytest
from posor.calibration.designs import BUMPS, design
from posor.estimation.posor import Posor
from posor.estimation.scan_checks import MARKS
from posor.model.fault import Fault, State
from posor.model.scan import Scans
from posor.numerics.array_types import FloatArray
from posor.numerics.stamps import NS
from posor.sensors.bumpy_ring import BumpyRing
from posor_lab.harness.random_poses import TICK_NS, turning_scans

BUMP = 2.0 * math.pi / BUMPS


def test_uncounted_until_home_then_counted() -> None:
    posor = Posor(design("triad_bumpy_ring"))
    thetas = np.linspace(-3.5 * BUMP, 0.1 * BUMP, 200)
    scans = turning_scans(posor, thetas, marks=(*range(188, 188 + MARKS), 150))  # the one at 150 is spurious
    found = posor.estimate_all(scans)
    counted = 188 + MARKS - 1
    assert (found.states[:counted] == State.UNCOUNTED).all()
    assert (found.states[counted:] == State.OK).all()
    assert found.thetas[counted:] == pytest.approx(thetas[counted:], abs=1e-9)
    off = found.thetas[:counted] - thetas[:counted]
    assert off / BUMP == pytest.approx(np.round(off / BUMP), abs=0.01)  # known up to whole bumps


@pytest.mark.long
def test_reversals_and_many_turns_keep_the_count() -> None:
    posor = Posor(design("triad_bumpy_ring"))
    there = np.linspace(0.0, 6.7 * math.pi, 9000)
    thetas = np.concatenate([there, there[::-1], -there[:3000], -there[2999::-1]])
    found = posor.estimate_all(turning_scans(posor, thetas, home=(0,)))
    assert (found.states == State.OK).all()
    assert found.thetas == pytest.approx(thetas, abs=1e-9)


def test_lost_scans_put_the_count_in_doubt_until_home() -> None:
    posor = Posor(design("triad_bumpy_ring"))
    thetas = np.linspace(0.0, 0.8, 401)
    scans = turning_scans(posor, thetas, home=(0,))
    before = posor.estimate_all(scans.part(0, 100))
    assert (before.states == State.OK).all()
    estimate = posor.estimate(scans[200])
    assert estimate.state is State.UNCOUNTED
    assert estimate.faults & Fault.COUNT
    assert "count" in estimate.reason


@pytest.mark.parametrize("bumps", [1.0, 2.1, 3.0])
def test_a_count_by_home_marks_is_given_up_where_the_next_scans_are_missing(bumps: float) -> None:
    """The joint begins to turn at home, in a pause of 0.15 s."""
    posor = Posor(design("quad_bumpy_ring", motion=True))
    numbers = np.r_[:20, 170:200]
    scans = turning_scans(posor, np.where(numbers < 20, 0.0, bumps * BUMP), marks=range(20 - MARKS, 20))
    stamps_ns = (1 + numbers) * TICK_NS
    found = posor.estimate_all(scans.with_fields({"stamps_ns": stamps_ns, "numbers": numbers.astype(np.uint64)}))
    assert found.states[19] == State.OK
    assert (found.states[20:] == State.UNCOUNTED).all()


@pytest.mark.parametrize(
    ("rate", "lost", "moved", "state"),
    [
        (20, 1, BUMP, State.UNCOUNTED),
        (20, 3, BUMP, State.UNCOUNTED),
        (10, 0, BUMP, State.UNCOUNTED),
        (50, 3, 0.0, State.OK),
    ],
)
def test_a_count_is_given_up_where_the_stated_acceleration_may_turn_a_bump(
    rate: int, lost: int, moved: float, state: State
) -> None:
    """The joint rests, ``lost`` scans are missing, and then it rests a bump further on, or where it was."""
    posor = Posor(design("quad_bumpy_ring", motion=True))
    numbers = np.r_[:20, 20 + lost : 40]
    scans = turning_scans(posor, np.where(numbers < 20, 0.0, moved), marks=range(20))
    stamps_ns = (1 + numbers) * (NS // rate)
    found = posor.estimate_all(scans.with_fields({"stamps_ns": stamps_ns, "numbers": numbers.astype(np.uint64)}))
    assert (found.states[20:] == state).all()


def slipping(posor: Posor) -> tuple[Scans, FloatArray, int]:
    """Scans with a slip by two whole bumps after the first one, which no phase can show, and a mark on the way back."""
    thetas = np.concatenate([[0.0], np.linspace(2.0 * BUMP, -0.2 * BUMP, 400)])
    at_mark = int(np.argmin(np.abs(thetas[1:]))) + 1
    return turning_scans(posor, thetas, home=(0,), marks=tuple(range(at_mark - 3, at_mark + 4))), thetas, at_mark


def test_a_home_mark_that_disagrees_is_latched_and_never_counted() -> None:
    posor = Posor(design("triad_bumpy_ring"))
    scans, thetas, at_mark = slipping(posor)
    found = posor.estimate_all(scans)
    assert found.states[at_mark - 4] == State.OK
    assert found.thetas[at_mark - 4] - thetas[at_mark - 4] == pytest.approx(-2.0 * BUMP, abs=0.01 * BUMP)
    assert (found.states[at_mark - 3 :] == State.LOST).all()
    assert found.faults[at_mark - 3] == Fault.COUNT
    assert (found.faults[at_mark - 2 :] == Fault.COUNT | Fault.LATCHED).all()
    assert posor.acknowledge()
    again = posor.estimate_all(scans.part(at_mark - 3, at_mark + 4))
    assert (again.states[: MARKS - 1] == State.UNCOUNTED).all()
    assert (again.states[MARKS - 1 :] == State.OK).all()
    assert again.thetas[MARKS - 1 :] == pytest.approx(thetas[at_mark - 3 + MARKS - 1 : at_mark + 4], abs=1e-9)


def test_home_marks_before_a_scan_without_a_solution_do_not_count_the_next_one() -> None:
    """The next pose has no motion gate, so that one garbled scan could be counted and OK."""
    posor = Posor(design("quad_bumpy_ring", motion=True))
    scans = turning_scans(posor, np.linspace(0.0, 0.005, 30), marks=tuple(range(30)))
    volts = scans.ring_voltages.copy()
    volts[12] = [0.1, 4.5, -3.6, 4.5]
    found = posor.estimate_all(scans.with_fields({"ring_voltages": volts}))
    assert found.faults[12] == Fault.NOT_CONVERGED
    assert (found.states[13 : 12 + MARKS] == State.UNCOUNTED).all()
    assert (found.states[12 + MARKS :] == State.OK).all()


@pytest.mark.parametrize("marks", [(150,), (150, 151), (120, 150, 152)])
def test_spurious_home_marks_cost_their_own_scans_only(marks: tuple[int, ...]) -> None:
    posor = Posor(design("triad_bumpy_ring", motion=True))
    thetas = np.linspace(0.0, 0.5, 400)
    found = posor.estimate_all(turning_scans(posor, thetas, home=(0,), marks=marks))
    assert np.flatnonzero(found.states != State.OK).tolist() == list(marks)
    assert (found.faults[list(marks)] & Fault.COUNT).all()
    assert np.delete(found.thetas, marks) == pytest.approx(np.delete(thetas, marks), abs=1e-9)


def test_agreeing_marks_release_what_a_broken_mark_has_latched() -> None:
    posor = Posor(design("triad_bumpy_ring", motion=True))
    thetas = np.concatenate([np.linspace(0.0, 0.3, 200), np.linspace(0.3, 0.0, 200)])
    found = posor.estimate_all(turning_scans(posor, thetas, home=(0,), marks=(*range(100, 110), *range(390, 400))))
    assert (found.states[:100] == State.OK).all()
    assert (found.states[100 : 390 + MARKS - 1] == State.LOST).all()
    assert (found.states[390 + MARKS - 1 :] == State.OK).all()
    assert found.thetas[-5:] == pytest.approx(thetas[-5:], abs=1e-9)


def test_a_home_mark_that_sticks_does_not_count_the_next_bump() -> None:
    """It is seen too late at home for a count there, and further on until the joint rests at the next bump."""
    posor = Posor(design("triad_bumpy_ring", motion=True))
    there = np.concatenate([np.linspace(0.0, BUMP, 100), np.full(50, BUMP)])
    thetas = np.concatenate([there, there[::-1]])
    stuck, sound = range(51 - MARKS, 150), range(290, 300)
    found = posor.estimate_all(turning_scans(posor, thetas, marks=(*stuck, *sound)))
    assert (found.states[: 290 + MARKS - 1] == State.UNCOUNTED).all()
    assert (found.states[290 + MARKS - 1 :] == State.OK).all()
    assert found.thetas[-5:] == pytest.approx(thetas[-5:], abs=1e-9)


@pytest.mark.parametrize("marks_at_home", [MARKS - 1, 600])
def test_a_mark_that_is_seen_from_the_bump_before_home_up_to_home_is_not_spurious_there(marks_at_home: int) -> None:
    """Its switch closes early, so that the count is wrong until home; there it opens, or sticks all the way back."""
    posor = Posor(design("triad_bumpy_ring", motion=True))
    thetas = np.concatenate([np.linspace(-0.8 * BUMP, 0.4 * BUMP, 200), np.linspace(0.4 * BUMP, -0.8 * BUMP, 200)])
    home = int(np.searchsorted(thetas[:200], -0.5 * BUMP)) + 1
    found = posor.estimate_all(turning_scans(posor, thetas, marks=range(20, min(home + marks_at_home, 400))))
    assert found.states[home - 1] == State.OK  # until then a mark like any other
    assert (found.states[home:] == State.LOST).all()


def test_four_probes_see_alike_at_every_phase_three_are_blind_twice_a_bump() -> None:
    phases = np.linspace(0.0, 2.0 * math.pi, 361)
    seen = {}
    for probes in (3, 4):
        ring = Posor(design("triad_bumpy_ring", ring_probes=probes)).stack.sensors[1]
        assert isinstance(ring, BumpyRing)
        seen[probes] = ring.observability(phases)
    assert seen[4].min() > 0.6 * seen[4].max()
    assert seen[3].min() < 0.01 * seen[4].min()


def test_three_probes_are_carried_over_blind_phases_and_say_so() -> None:
    posor = Posor(design("triad_bumpy_ring", ring_probes=3, motion=True))
    ring = posor.stack.sensors[1]
    assert isinstance(ring, BumpyRing)
    thetas = np.linspace(0.0, 1.5 * BUMP, 1500)
    blind = ring.observability(thetas * BUMPS)
    scans = turning_scans(posor, thetas, home=(0,))
    found = posor.estimate_all(scans)
    weak = int(np.argmin(blind[5:])) + 5
    assert found.states[weak] == State.DEGRADED
    assert found.faults[weak] == Fault.ILL_CONDITIONED
    assert np.isin(found.states, [State.OK, State.DEGRADED]).all()
    spread = np.sqrt(found.covariances_random[:, 5, 5])
    assert (np.abs(found.thetas - thetas) < 3.0 * spread).all()
    alone = Posor(design("triad_bumpy_ring", ring_probes=3))
    unlimited = alone.estimate_all(scans)
    assert np.sqrt(unlimited.covariances_random[weak, 5, 5]) > 10.0 * spread[weak]  # nothing to carry it over
