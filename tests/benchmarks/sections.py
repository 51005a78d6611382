"""The parts of the benchmark; each gives its keys of the JSON file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tests.benchmarks.accounts import NothingReceived, figures
from tests.benchmarks.growth import FULL, line, series
from tests.benchmarks.layouts import LAYOUTS, PROFILE, SPIN_US, Load
from tests.benchmarks.made_arm import made_arm, record

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from posor_bringup.layouts import Layout
    from posor_estimator.core.arm import Arm

    from tests.benchmarks.accounts import Run
    from tests.benchmarks.layouts import Kind
    from tests.benchmarks.measuring import Bench

MEGA = 1_000_000
LONGEST_SPIN_US = 1000
PRIORITY = 50
"""SCHED_FIFO priority that is tried; where the system refuses it, the figures are those without."""
BAD_EVERY = 100
"""Of so many scans of the first joint one is bad, where faults are measured."""
LADDER = (500, 1000, 1500, 2000, 2500, 3000, 3500, 4000, 5000, 6000, 8000, 10_000)
"""Rates among which the highest that holds is looked for [Hz]."""
TRIES = 2
"""How often a rate is tried before it counts as one that does not hold: the machine may have stumbled."""


@dataclass(frozen=True)
class Plan:
    """What to measure.

    Attributes:
        joints: Of the main graph.
        rate: Of the main graph [Hz].
        layout: Of the main graph.
        seconds: Measured time of the main graph, and as much of its floor.
        rounds: How often the two take turns, so that what else the machine does hits both.
        point_s: Measured time of every other run.
        offline_s: Length of the bag that is reprocessed, recorded at 1 kHz.
        growth_joints: Numbers of joints, at ``growth_rate`` [Hz].
        growth_rates: Rates [Hz], with the joints of the main graph.

    """

    joints: int
    rate: int
    layout: Layout
    seconds: float
    rounds: int
    point_s: float
    offline_s: int
    growth_joints: Sequence[int]
    growth_rate: int
    growth_rates: Sequence[int]

    @property
    def name(self) -> str:
        """Of the main graph, as the keys have it."""
        return f"{self.joints}x{self.rate}"

    @property
    def period_us(self) -> int:
        """Between two ticks of the main graph [us], rounded up; what a driver may look at the clock for is bounded."""
        return min(-(-MEGA // self.rate), LONGEST_SPIN_US)


class Arms:
    """Makes arms as they are needed, and one bag for all of them."""

    def __init__(self, folder: Path, most_joints: int) -> None:
        self._folder = folder
        self.bag = folder / "scans"
        self._made: dict[int, Arm] = {}
        record(self[most_joints], self.bag)

    def __getitem__(self, joints: int) -> Arm:
        """Return the arm of so many joints."""
        if joints not in self._made:
            self._made[joints] = made_arm(self._folder / f"arm_{joints}", joints, self.bag)
        return self._made[joints]

    def with_faults(self, joints: int) -> Arm:
        """Return an arm whose scans are those, but for some of the first joint that lack a reading."""
        bag = self._folder / "faults"
        record(self[joints], bag, BAD_EVERY)
        return made_arm(self._folder / f"arm_{joints}_faults", joints, bag)


def highest_rate(lost: Callable[[int], float], share: float) -> int | None:
    """Return the highest rate of the ladder at which no more than a share is lost; None: at none.

    Args:
        lost: Returns the share that is lost at a rate [Hz]; asked for half of the ladder's remaining steps each time.
        share: What may be lost.

    """
    lowest, highest = -1, len(LADDER)
    while highest - lowest > 1:
        middle = (lowest + highest) // 2
        if lost(LADDER[middle]) > share:
            highest = middle
        else:
            lowest = middle
    return LADDER[lowest] if lowest >= 0 else None


def least_lost(lost: Callable[[int], float], rate: int, share: float, tried: dict[int, list[float]]) -> float:
    """Return the least share that was lost at a rate, which is tried until no more than a share is, or TRIES times.

    Args:
        lost: Measures it.
        rate: [Hz].
        share: What may be lost.
        tried: What was lost so far, by rate; written.

    """
    shares = tried.setdefault(rate, [])
    while not shares or (min(shares) > share and len(shares) < TRIES):
        shares.append(lost(rate))
    return min(shares)


class Sections:
    """Runs what a plan says, one part after the other."""

    def __init__(self, plan: Plan, bench: Bench, arms: Arms, say: Callable[[str], None]) -> None:
        self._plan = plan
        self._bench = bench
        self._arms = arms
        self._say = say
        self._measured: dict[tuple[Layout, int, int], dict[str, Any]] = {}

    def _run(self, kind: Kind, layout: Layout, joints: int, rate: int, seconds: float) -> Run:
        self._say(f"{kind}, {joints} joints at {rate} Hz, {LAYOUTS[layout]}: {seconds:g} s")
        return self._bench.run(Load(self._arms[joints], kind, layout, rate), seconds)

    def _figures(self, layout: Layout, joints: int, rate: int) -> dict[str, Any]:
        """Return the figures of a graph; where it is the main one and was measured already, those."""
        key = (layout, joints, rate)
        if key not in self._measured:
            self._measured[key] = figures([self._run("graph", *key, self._plan.point_s)])
        return self._measured[key]

    def graph(self) -> dict[str, Any]:
        """Measure the main graph and its floor in turns, then the machine alone."""
        plan = self._plan
        runs: dict[Kind, list[Run]] = {"graph": [], "floor": []}
        for _ in range(plan.rounds):
            for kind, done in runs.items():
                done.append(self._run(kind, plan.layout, plan.joints, plan.rate, plan.seconds / plan.rounds))
        graph, floor = figures(runs["graph"]), figures(runs["floor"])
        self._measured[plan.layout, plan.joints, plan.rate] = graph
        return {
            f"graph_{plan.name}": graph,
            f"floor_{plan.name}": floor,
            "alone": self._alone(),
            **{f"ratio_{share}": graph[f"{share}_us"] / floor[f"{share}_us"] for share in ("p50", "p99")},
        }

    def _alone(self) -> dict[str, Any]:
        """Measure how late the machine is for ticks of the main graph's rate when nothing is done."""
        plan = self._plan
        seconds = plan.seconds / plan.rounds
        ways = {"asleep": SPIN_US, "awake": plan.period_us}
        self._say(f"the machine alone, ticks at {plan.rate} Hz: {seconds:g} s, and as long without sleeping")
        return {way: self._bench.alone(plan.rate, spin_us, seconds) for way, spin_us in ways.items()}

    def layouts(self) -> dict[str, Any]:
        """Measure the main graph in every layout."""
        plan = self._plan
        return {"layouts": {layout: self._figures(layout, plan.joints, plan.rate) for layout in LAYOUTS}}

    def waiting(self) -> dict[str, Any]:
        """Measure the main graph by how its drivers wait: always asleep, awake shortly before a tick, never asleep."""
        plan, told = self._plan, {}
        ways = {f"spin_us {spin_us}": (spin_us, 0) for spin_us in (0, SPIN_US, plan.period_us)}
        ways[f"spin_us {SPIN_US}, priority {PRIORITY}"] = SPIN_US, PRIORITY
        for way, (spin_us, priority) in ways.items():
            self._say(f"graph, {plan.joints} joints at {plan.rate} Hz, {way}: {plan.point_s:g} s")
            load = Load(self._arms[plan.joints], "graph", plan.layout, plan.rate, spin_us, priority)
            told[way] = figures([self._bench.run(load, plan.point_s)])
        return {"waiting": told}

    def faults(self) -> dict[str, Any]:
        """Measure the main graph while one joint's scan lacks a reading now and then: what is said of it costs time."""
        plan = self._plan
        self._say(f"graph, one scan in {BAD_EVERY} of one joint bad: {plan.point_s:g} s")
        load = Load(self._arms.with_faults(plan.joints), "graph", plan.layout, plan.rate)
        return {"faults": figures([self._bench.run(load, plan.point_s)])}

    def growth(self) -> dict[str, Any]:
        """Measure the cost by joints and by rate."""
        plan = self._plan
        points = [self._point(joints, rate) for joints, rate in sorted(self._growth_points())]
        fits = {
            "joints": line(series(points, "joints", plan.growth_rate), "joints"),
            "rate": line(series(points, "rate", plan.joints), "rate"),
        }
        return {"growth": points, "growth_lines": {by: fit and fit.told() for by, fit in fits.items()}}

    def _growth_points(self) -> set[tuple[int, int]]:
        plan = self._plan
        by_joints = {(joints, plan.growth_rate) for joints in plan.growth_joints}
        return by_joints | {(plan.joints, rate) for rate in plan.growth_rates}

    def _point(self, joints: int, rate: int) -> dict[str, Any]:
        return {"joints": joints, "rate": rate, "layout": "composed", **self._figures("composed", joints, rate)}

    def highest(self) -> dict[str, Any]:
        """Look for the highest rate at which nothing is lost, and at which next to nothing is."""
        tried: dict[int, list[float]] = {}

        def highest(share: float) -> int | None:
            return highest_rate(lambda rate: least_lost(self._lost, rate, share, tried), share)

        return {
            "highest_rate_hz": highest(0.0),
            "highest_rate_nearly_hz": highest(FULL),
            "highest_rate_lost": {str(rate): min(tried[rate]) for rate in sorted(tried)},
        }

    def _lost(self, rate: int) -> float:
        """Return the share of a graph's ticks that are lost."""
        try:
            run = self._run("graph", self._plan.layout, self._plan.joints, rate, self._plan.point_s)
        except NothingReceived:
            return 1.0
        return run.lost / run.expected

    def profile(self) -> dict[str, Any]:
        """Take the main graph's time apart, all nodes in one process."""
        plan = self._plan
        self._say(f"profile, {plan.joints} joints at {plan.rate} Hz: {plan.point_s:g} s")
        self._bench.run(Load(self._arms[plan.joints], "graph", "composed", plan.rate, profiled=True), plan.point_s)
        return {"profile": json.loads((self._bench.folder / PROFILE).read_text(encoding="utf-8"))}
