# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Hosts and networks that stall now and then lose and delay scans, but are no reason to doubt a joint or its clock."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from posor.calibration.designs import design
from posor.estimation.posor import Posor
from posor.messages.message_stream import RawScanStream
from posor.messages.raw_scan import ScanTemplate
from posor.model.fault import State
from posor.numerics.array_types import BoolArray, FloatArray, IntArray
from posor.numerics.stamps import NS
from posor_lab.harness.graph import scan_templates

RATE, COUNT = 500, 3000
REACH, FREQUENCY = 0.12, 1.0  # of the motion of theta [rad], [Hz]: up to 0.75 rad/s
SEEDS = 20
STEP_NS = 20_000  # from one scan of a queue to the next one
CALIBRATION = design("triad_light_ring", motion=True)
Stall = tuple[float, float]  # begin and end [s]
Arrivals = tuple[IntArray, FloatArray]  # scans that arrive, in order, and when [s]


@cache
def templates() -> list[ScanTemplate]:
    """Return the scans of a joint that swings."""
    thetas = REACH * np.sin(2.0 * np.pi * FREQUENCY * np.arange(COUNT) / RATE)
    return scan_templates(Posor(CALIBRATION), thetas, 3)


def within(times_s: FloatArray, stall: Stall) -> BoolArray:
    return (stall[0] <= times_s) & (times_s < stall[1])


def driver_stalls(arrivals: Arrivals, stall: Stall, _chance: np.random.Generator) -> Arrivals:
    """Leave out the ticks that a driver has missed."""
    scans, times_s = arrivals
    is_there = ~within(scans / RATE, stall)
    return scans[is_there], times_s[is_there]


def network_stalls(arrivals: Arrivals, stall: Stall, _chance: np.random.Generator) -> Arrivals:
    """Deliver all scans of the stall at its end."""
    scans, times_s = arrivals
    return scans, np.where(within(times_s, stall), stall[1], times_s)


def receiver_stalls(arrivals: Arrivals, stall: Stall, chance: np.random.Generator) -> Arrivals:
    """Deliver at the end what a short queue has kept: the first scans, the last ones, or some."""
    scans, times_s = network_stalls(arrivals, stall, chance)
    held = np.flatnonzero(times_s == stall[1])
    kept = min(int(chance.choice([1, 5, 10, 50])), len(held))
    ways = held[:kept], held[len(held) - kept :], chance.choice(held, kept, replace=False)
    lost = np.setdiff1d(held, ways[chance.integers(3)])
    return np.delete(scans, lost), np.delete(times_s, lost)


@pytest.mark.parametrize("stalls", [driver_stalls, network_stalls, receiver_stalls])
@pytest.mark.parametrize("seed", range(SEEDS))
def test_stalls_latch_no_joint_and_are_no_step_of_its_clock(
    seed: int, stalls: Callable[[Arrivals, Stall, np.random.Generator], Arrivals]
) -> None:
    chance, posor = np.random.default_rng(seed), Posor(CALIBRATION, false_alarm=1e-9)
    arrivals: Arrivals = np.arange(COUNT), np.arange(COUNT) / RATE + chance.exponential(3e-4, COUNT)
    begin_s = chance.uniform(0.1, 1.0)
    while (end_s := begin_s + chance.uniform(0.02, 0.45)) < COUNT / RATE - 1.2:  # ages are compared for a second
        arrivals = stalls(arrivals, (begin_s, end_s), chance)
        begin_s = end_s + chance.exponential(0.5)
    stream = RawScanStream(posor, templates()[0].at(NS, 1))
    stream.accept_ages(-0.5 * NS, 0.5 * NS)
    now_ns = 0
    for n, time_s in zip(*(each.tolist() for each in arrivals), strict=True):
        now_ns = max(NS + round(time_s * NS), now_ns + STEP_NS)
        assert stream.estimate_message(templates()[n].at(NS + n * NS // RATE, 1 + n), now_ns) is not None
        assert stream.status["state"] != State.LOST
    assert not posor.has_latch
