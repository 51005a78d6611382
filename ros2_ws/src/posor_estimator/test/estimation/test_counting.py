"""The bumpy ring: counting theta in bumps, the home mark, reversals, and what three probes cannot see."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from posor_estimator.calibration.designs import BUMPS, design
from posor_estimator.estimation.forward import scans_at
from posor_estimator.estimation.posor import Posor
from posor_estimator.model.fault import Fault, State
from posor_estimator.model.native_coordinates import rotation_from_native
from posor_estimator.sensors.bumpy_ring import BumpyRing
from posor_estimator.testing.random_poses import TICK_NS

if TYPE_CHECKING:
    from posor_estimator.model.scan import Scans
    from posor_estimator.numerics.array_types import FloatArray

BUMP = 2.0 * math.pi / BUMPS


def turning(posor: Posor, thetas: FloatArray, home: tuple[int, ...] = ()) -> Scans:
    """Scans at 1 kHz of a target that turns; the home mark is seen in some of them."""
    rotations = np.array([rotation_from_native(1e-4, -2e-4, theta) for theta in thetas])
    translations = np.tile([2e-5, 1e-5, 0.7e-3], (len(thetas), 1))
    scans = scans_at(posor.stack, rotations, translations, np.arange(1, len(thetas) + 1, dtype=np.int64) * TICK_NS)
    scans.at_home[list(home)] = 1
    return scans


def test_uncounted_until_home_then_counted() -> None:
    posor = Posor(design("triad_bumpy_ring"))
    thetas = np.linspace(-3.5 * BUMP, 0.1 * BUMP, 200)
    scans = turning(posor, thetas, home=(190,))
    found = posor.estimate_all(scans)
    assert (found.states[:190] == State.UNCOUNTED).all()
    assert (found.states[190:] == State.OK).all()
    assert found.thetas[190:] == pytest.approx(thetas[190:], abs=1e-9)
    off = found.thetas[:190] - thetas[:190]
    assert off / BUMP == pytest.approx(np.round(off / BUMP), abs=0.01)  # known up to whole bumps


def test_reversals_and_many_turns_keep_the_count() -> None:
    posor = Posor(design("triad_bumpy_ring"))
    there = np.linspace(0.0, 6.7 * math.pi, 9000)
    thetas = np.concatenate([there, there[::-1], -there[:3000], -there[2999::-1]])
    found = posor.estimate_all(turning(posor, thetas, home=(0,)))
    assert (found.states == State.OK).all()
    assert found.thetas == pytest.approx(thetas, abs=1e-9)


def test_lost_scans_put_the_count_in_doubt_until_home() -> None:
    posor = Posor(design("triad_bumpy_ring"))
    thetas = np.linspace(0.0, 0.8, 401)
    scans = turning(posor, thetas, home=(0,))
    before = posor.estimate_all(scans.part(0, 100))
    assert (before.states == State.OK).all()
    estimate = posor.estimate(scans[200])
    assert estimate.state is State.UNCOUNTED
    assert estimate.faults & Fault.COUNT
    assert "count" in estimate.reason


def test_home_mark_finds_and_mends_a_wrong_count() -> None:
    posor = Posor(design("triad_bumpy_ring"))
    # Between the first two scans the target slips by two whole bumps, which no phase can show; then it turns back.
    thetas = np.concatenate([[0.0], np.linspace(2.0 * BUMP, -0.2 * BUMP, 400)])
    at_mark = int(np.argmin(np.abs(thetas[1:]))) + 1
    found = posor.estimate_all(turning(posor, thetas, home=(0, at_mark)))
    assert found.states[at_mark - 1] == State.OK
    assert found.thetas[at_mark - 1] - thetas[at_mark - 1] == pytest.approx(-2.0 * BUMP, abs=0.01 * BUMP)
    assert found.states[at_mark] == State.DEGRADED
    assert found.faults[at_mark] == Fault.COUNT
    assert (found.states[at_mark + 1 :] == State.OK).all()
    assert found.thetas[at_mark:] == pytest.approx(thetas[at_mark:], abs=1e-9)


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
    scans = turning(posor, thetas, home=(0,))
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
