# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The sections of the benchmark; each returns its part of the JSON file."""

from __future__ import annotations

import json
from bisect import bisect
from dataclasses import asdict, dataclass
from functools import partial
from statistics import fmean
from time import process_time
from typing import TYPE_CHECKING, Any

from posor.bags.bag_reader import opened_bag
from posor.bags.block_reader import read_messages
from posor.estimation.posor import Posor
from posor.model.scan import Scans
from posor.ros_names import RAW_TOPIC
from posor_bringup.arm_programs import arm_programs
from posor_bringup.supervisor import ProgramCommand
from posor_msgs.msg import RawScan
from rclpy.serialization import deserialize_message

from posor_lab.benchmark import empty_node
from posor_lab.benchmark.generated_arm import generate_arm, record_scans
from posor_lab.benchmark.graph_load import KINDS, LAYOUTS, PROFILE, SPIN_US, GraphLoad, PageUse
from posor_lab.benchmark.growth_lines import OVERLOADED, fit_line, select_series
from posor_lab.benchmark.offline_benchmark import offline_figures
from posor_lab.benchmark.start_cost import start_cost
from posor_lab.benchmark.tick_cost import tick_cost
from posor_lab.benchmark.tick_statistics import NothingReceivedError, paired_p99_ratio, run_figures
from posor_lab.harness.message_conversion import scan_from_message

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from posor.chain.arm_file import ArmFile
    from posor_bringup.arm_programs import Layout

    from posor_lab.benchmark.graph_load import NodeKind
    from posor_lab.benchmark.graph_measurement import GraphMeasurement
    from posor_lab.benchmark.tick_statistics import MeasuredRun

ROUNDS = 5


def least_us(calls: int, work: Callable[[], object]) -> float:
    """Return the least processor time of ``work`` in several rounds, per call of the estimator [us]."""
    seconds = []
    for _ in range(ROUNDS):
        begin = process_time()
        work()
        seconds.append(process_time() - begin)
    return 1e6 * min(seconds) / calls


def estimator_figures(arm: ArmFile, bag: Path) -> dict[str, float]:
    """Return ``kernel_us`` (all scans in one call) and ``scan_us`` (scan by scan) [us], means over the joints."""
    many, single = [], []
    for joint in arm.calibrations:
        topic = f"/{arm.name}/{joint}/{RAW_TOPIC}"
        with opened_bag(bag) as reader:
            records = read_messages(reader, (topic,), str(bag))
            scans = [scan_from_message(deserialize_message(data, RawScan)) for _, _, data in records]
        posor, arrays = Posor(arm.calibration(joint)), Scans.of(scans)
        many.append(least_us(len(scans), partial(_estimate, posor, posor.estimate_all, [arrays])))
        single.append(least_us(len(scans), partial(_estimate, posor, posor.estimate, scans)))
    return {"kernel_us": fmean(many), "scan_us": fmean(single)}


def _estimate(posor: Posor, estimate: Callable[[Any], object], parts: Sequence[Any]) -> None:
    posor.reset()
    for part in parts:
        estimate(part)


SECTIONS = (
    *("start", "graph", "faults", "waiting", "page", "layouts", "tick", "growth"),
    *("highest", "separate", "profile", "kernel", "offline"),
)
"""Names of the sections; each is a method of ``BenchmarkSections``."""
MAX_SPIN_US = 1000
PRIORITY = 50  # SCHED_FIFO priority that is requested; where the system refuses it, the figures are those without
FAULT_INTERVAL = 100  # with faults, every hundredth scan of the first joint lacks a reading
RATE_LADDER = (500, 1000, 1500, 2000, 2500, 3000, 3500, 4000, 5000, 6000, 8000, 10_000)
"""Rates [Hz] for the search of the highest rate."""
SEPARATE_LADDER = (125, 250, 500, 1000)  # rates [Hz] for the search with one process for each node
SEPARATE_RATE = 500  # rate of one process for each node beside other layouts [Hz]
SEPARATE_LOST = 1e-3  # share of lost ticks that is allowed there
TRIES = 2  # a rate fails only if it fails this many times: the host may have paused once


@dataclass(frozen=True)
class BenchmarkPlan:
    """The graphs to measure, and for how long."""

    joints: int  # joints of the main graph
    rate: int  # rate of the main graph [Hz]
    layout: Layout  # layout of the main graph
    seconds: float  # measured time of the main graph, and of the pass-through graph
    rounds: int  # number of parts of this time; the two graphs alternate, so that changes of the host affect both
    starts: int  # number of starts of a node
    page_rounds: int  # number of times that the graph is measured with and without the live page
    point_s: float  # measured time of all other graphs
    offline_s: int  # length of the bag for offline processing
    growth_joints: Sequence[int]  # numbers of joints, at ``growth_rate`` [Hz]
    growth_rate: int  # rate for ``growth_joints`` [Hz]
    growth_rates: Sequence[int]  # rates [Hz], with the joints of the main graph

    @property
    def name(self) -> str:
        """Name of the main graph in the keys of the JSON file."""
        return f"{self.joints}x{self.rate}"

    @property
    def full_spin_us(self) -> int:
        """Period of the main graph [us], rounded up, as far as drivers accept it: with it, they never sleep."""
        return min(-(-1_000_000 // self.rate), MAX_SPIN_US)


class BenchmarkArms:
    """Generates arms on demand, and one bag that all of them play."""

    def __init__(self, folder: Path, max_joints: int) -> None:
        """Generate the largest arm and record the bag."""
        self.folder = folder
        self.bag = folder / "scans"
        self._arms: dict[int, ArmFile] = {}
        record_scans(self[max_joints], self.bag)

    def __getitem__(self, joints: int) -> ArmFile:
        if joints not in self._arms:
            self._arms[joints] = generate_arm(self.folder / f"arm_{joints}", joints, self.bag)
        return self._arms[joints]

    def with_faults(self, joints: int) -> ArmFile:
        """Return an arm that plays a bag in which scans of the first joint lack a reading."""
        bag = self.folder / "faults"
        record_scans(self[joints], bag, FAULT_INTERVAL)
        return generate_arm(self.folder / f"arm_{joints}_faults", joints, bag)


def find_highest_rate(
    lost_share: Callable[[int], float], allowed: float, ladder: Sequence[int] = RATE_LADDER
) -> int | None:
    """Return the highest rate of a ladder with at most the allowed share lost, by bisection; None: no rate."""
    held = bisect(ladder, x=False, key=lambda rate: lost_share(rate) > allowed)
    return ladder[held - 1] if held else None


def least_lost_share(
    measure: Callable[[int], float], rate: int, allowed: float, measured: dict[int, list[float]]
) -> float:
    """Return the least lost share of a rate [Hz], measured until it is allowed, at most ``TRIES`` times.

    ``measured`` holds all measured shares by rate and is extended.
    """
    shares = measured.setdefault(rate, [])
    while not shares or (min(shares) > allowed and len(shares) < TRIES):
        shares.append(measure(rate))
    return min(shares)


class BenchmarkSections:
    """Measures the sections of a plan."""

    def __init__(
        self, plan: BenchmarkPlan, measurement: GraphMeasurement, arms: BenchmarkArms, print_line: Callable[[str], None]
    ) -> None:
        self._plan, self._measurement, self._arms, self._print_line = plan, measurement, arms, print_line
        self._measured: dict[tuple[NodeKind, Layout, int, int], dict[str, Any]] = {}

    def _measure(self, kind: NodeKind, layout: Layout, joints: int, rate: int, seconds: float) -> MeasuredRun:
        self._print_line(f"{kind.replace('_', '-')}, {joints} joints at {rate} Hz, {LAYOUTS[layout]}: {seconds:g} s")
        return self._measurement.measure_graph(GraphLoad(self._arms[joints], kind, layout, rate), seconds)

    def _graph_figures(self, kind: NodeKind, layout: Layout, joints: int, rate: int) -> dict[str, Any]:
        """Return the figures of a graph; each graph is measured once."""
        key = (kind, layout, joints, rate)
        if key not in self._measured:
            self._measured[key] = run_figures([self._measure(*key, self._plan.point_s)])
        return self._measured[key]

    def start(self) -> dict[str, Any]:
        """Measure the start of a ``posor_node`` beside that of a node that does nothing."""
        self._print_line(f"start of a node: {self._plan.starts} times")
        nodes = arm_programs(self._arms[self._plan.joints], drivers=False)
        posor = next(node for node in nodes if node.executable == "posor_node")
        programs = {"posor_node": posor, "empty_node": ProgramCommand("empty", "", str(empty_node.__file__))}
        return {"start": {name: start_cost(each.command(), self._plan.starts) for name, each in programs.items()}}

    def graph(self) -> dict[str, Any]:
        """Measure the main graph and the pass-through graph alternately, then the empty loop."""
        plan = self._plan
        runs: dict[NodeKind, list[MeasuredRun]] = {"graph": [], "pass_through": []}
        for _ in range(plan.rounds):
            for kind, of_kind in runs.items():
                of_kind.append(self._measure(kind, plan.layout, plan.joints, plan.rate, plan.seconds / plan.rounds))
        graph, pass_through = (run_figures(of_kind) for of_kind in runs.values())
        for kind, figures in (("graph", graph), ("pass_through", pass_through)):
            self._measured[kind, plan.layout, plan.joints, plan.rate] = figures
        return {
            f"graph_{plan.name}": graph,
            f"pass_through_{plan.name}": pass_through,
            "empty_loop": self._empty_loop(plan.seconds / plan.rounds),
            **{f"ratio_{share}": graph[f"{share}_us"] / pass_through[f"{share}_us"] for share in ("p50", "p99")},
        }

    def _empty_loop(self, seconds: float) -> dict[str, Any]:
        rate = self._plan.rate
        self._print_line(f"empty loop, ticks at {rate} Hz: {seconds:g} s, and as long without sleeping")
        spins = {"asleep": SPIN_US, "awake": self._plan.full_spin_us}
        return {name: self._measurement.measure_empty_loop(rate, spin_us, seconds) for name, spin_us in spins.items()}

    def layouts(self) -> dict[str, Any]:
        """Measure the main graph and the pass-through graph in every layout; one process for each node is slower."""
        plan, figures = self._plan, dict[str, Any]()
        for layout in LAYOUTS:
            rate = min(plan.rate, SEPARATE_RATE) if layout == "separate" else plan.rate
            for kind in KINDS:
                row = f"{LAYOUTS[layout]}, {rate} Hz{', pass-through' if kind == 'pass_through' else ''}"
                figures[row] = self._graph_figures(kind, layout, plan.joints, rate)
        return {"layouts": figures}

    def tick(self) -> dict[str, Any]:
        """Measure the processor time of a tick without drivers."""
        self._print_line("processor time of a tick")
        arm = self._arms[self._plan.joints]
        costs = {kind: tick_cost(arm, self._arms.bag, kind) for kind in KINDS}
        with_state = tick_cost(arm, self._arms.bag, "graph", receives_state=True)
        after_gaps = tick_cost(arm, self._arms.bag, "graph", number_step=2)
        variants = {"with_state": with_state, "after_gaps": after_gaps}
        return {"tick": {"graph": costs["graph"], **variants, "pass_through": costs["pass_through"]}}

    def _variant_figures(self, text: str, arm: ArmFile, spin_us: int = SPIN_US, priority: int = 0) -> dict[str, Any]:
        """Return the figures of the main graph with another arm, or other waiting of the drivers."""
        load = GraphLoad(arm, "graph", self._plan.layout, self._plan.rate, spin_us, priority)
        return run_figures([self._measure_variant(text, load)])

    def _measure_variant(self, text: str, load: GraphLoad) -> MeasuredRun:
        plan = self._plan
        self._print_line(f"graph, {plan.joints} joints at {plan.rate} Hz, {text}: {plan.point_s:g} s")
        return self._measurement.measure_graph(load, plan.point_s)

    def waiting(self) -> dict[str, Any]:
        """Measure the main graph with drivers that always sleep, wake shortly before a tick, or never sleep."""
        ways = {f"spin_us {spin_us}": (spin_us, 0) for spin_us in (0, SPIN_US, self._plan.full_spin_us)}
        ways[f"spin_us {SPIN_US}, priority {PRIORITY}"] = SPIN_US, PRIORITY
        arm = self._arms[self._plan.joints]
        return {"waiting": {way: self._variant_figures(way, arm, *settings) for way, settings in ways.items()}}

    def faults(self) -> dict[str, Any]:
        """Measure the main graph while scans of one joint lack a reading: reporting faults takes time."""
        arm = self._arms.with_faults(self._plan.joints)
        return {"faults": self._variant_figures(f"one scan in {FAULT_INTERVAL} of one joint faulty", arm)}

    def page(self) -> dict[str, Any]:
        """Measure the main graph beside the live page, with normal scheduling and with that of a servo controller."""
        return {"page": self._page_figures(0), "page_priority": self._page_figures(PRIORITY)}

    def _page_figures(self, priority: int) -> dict[str, Any]:
        """Return the figures of the main graph without the page, with the page at rest, and with the page shown."""
        plan = self._plan
        runs: dict[PageUse, list[MeasuredRun]] = {"absent": [], "at rest": [], "shown": []}
        for _ in range(plan.page_rounds):  # in turn
            for use, of_use in runs.items():
                load = GraphLoad(self._arms[plan.joints], "graph", plan.layout, plan.rate, priority=priority, page=use)
                of_use.append(self._measure_variant(f"live page {use}, priority {priority}", load))
        figures = dict[str, Any]()
        for use, of_use in runs.items():
            pairs = list(zip(of_use, runs["absent"], strict=True))
            received = paired_p99_ratio((run.latencies_ns, other.latencies_ns) for run, other in pairs)
            published = paired_p99_ratio((run.published_ns, other.published_ns) for run, other in pairs)
            figures[use] = {**run_figures(of_use), "p99_ratio": received, "published_p99_ratio": published}
        return figures

    def growth(self) -> dict[str, Any]:
        """Measure the processor time by joints and by rate."""
        plan = self._plan
        sizes = {(joints, plan.growth_rate) for joints in plan.growth_joints}
        sizes |= {(plan.joints, rate) for rate in plan.growth_rates}
        points = [
            {"joints": size[0], "rate": size[1], **self._graph_figures("graph", "composed", *size)}
            for size in sorted(sizes)
        ]
        lines = {
            "joints": fit_line(select_series(points, "joints", plan.growth_rate), "joints"),
            "rate": fit_line(select_series(points, "rate", plan.joints), "rate"),
        }
        return {"growth": points, "growth_lines": {by: line and asdict(line) for by, line in lines.items()}}

    def highest(self) -> dict[str, Any]:
        """Search the highest rate without lost ticks, and with less than ``OVERLOADED`` lost."""
        measured: dict[int, list[float]] = {}
        return {
            "highest_rate_hz": self._highest_rate(self._plan.layout, 0.0, RATE_LADDER, measured),
            "highest_rate_nearly_hz": self._highest_rate(self._plan.layout, OVERLOADED, RATE_LADDER, measured),
            "highest_rate_lost": {str(rate): min(measured[rate]) for rate in sorted(measured)},
        }

    def separate(self) -> dict[str, Any]:
        """Search the highest rate with one process for each node and at most ``SEPARATE_LOST`` lost."""
        measured: dict[int, list[float]] = {}
        return {
            "highest_rate_separate_hz": self._highest_rate("separate", SEPARATE_LOST, SEPARATE_LADDER, measured),
            "highest_rate_separate_lost": {str(rate): min(measured[rate]) for rate in sorted(measured)},
        }

    def _highest_rate(
        self, layout: Layout, allowed: float, ladder: Sequence[int], measured: dict[int, list[float]]
    ) -> int | None:
        def lost_share(rate: int) -> float:
            return least_lost_share(lambda rate: self._lost_share(layout, rate), rate, allowed, measured)

        return find_highest_rate(lost_share, allowed, ladder)

    def _lost_share(self, layout: Layout, rate: int) -> float:
        """Return the share of lost ticks of the graph with the joints of the main graph."""
        try:
            run = self._measure("graph", layout, self._plan.joints, rate, self._plan.point_s)
        except NothingReceivedError:
            return 1.0
        return run.lost / run.expected

    def profile(self) -> dict[str, Any]:
        """Measure the time of each stage of a tick, all nodes in one process."""
        plan = self._plan
        self._print_line(f"profile, {plan.joints} joints at {plan.rate} Hz: {plan.point_s:g} s")
        load = GraphLoad(self._arms[plan.joints], "graph", "composed", plan.rate, profiled=True)
        self._measurement.measure_graph(load, plan.point_s)
        return {"profile": json.loads((self._measurement.folder / PROFILE).read_text(encoding="utf-8"))}

    def kernel(self) -> dict[str, Any]:
        """Measure the estimator alone."""
        return dict(estimator_figures(self._arms[self._plan.joints], self._arms.bag))

    def offline(self) -> dict[str, Any]:
        """Measure ``reprocess`` and the loops that it is compared with."""
        arms = self._arms
        return offline_figures(arms[self._plan.joints], arms.bag, arms.folder, self._plan.offline_s)
