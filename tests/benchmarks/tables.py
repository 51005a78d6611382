"""The figures as tables, for the terminal and for a page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich.table import Table

from tests.benchmarks.aims import judged
from tests.benchmarks.layouts import LAYOUTS
from tests.benchmarks.sections import BAD_EVERY

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

WHOLE = 1000.0
"""From here on digits after the point say nothing."""
QUIET = 0.5
"""Load average up to which a machine counts as idle."""
GRAPH = "graph_"
"""How the key of the main graph begins."""
LATENCY = ("", "p50, us", "p99, us", "p99.9, us", "max, us", "lost", "cores", "MB")
SINGLE = {
    "ratio_p50": "p50, graph to floor",
    "ratio_p99": "p99, graph to floor",
    "highest_rate_hz": "highest rate without loss, Hz",
    "highest_rate_nearly_hz": "highest rate at which no more than 1 % of the ticks are lost, Hz",
    "kernel_us": "estimator, many scans in one call, us a scan",
    "scan_us": "estimator, scan by scan, us a scan",
    "offline_scans_per_s": "reprocessing, scans/s per core",
    "plain_loop_scans_per_s": "plain message loop, scans/s",
    "reading_messages_per_s": "rosbags reading and decoding messages, and no more, messages/s",
    "offline_memory_mb": "reprocessing, memory, MB",
}
"""Single figures by their keys, and what to call them."""


@dataclass(frozen=True)
class Shown:
    """A table: title, header and rows; the first column is text, all others are figures."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]

    def rich(self) -> Table:
        """Return it for the terminal."""
        table = Table(title=self.title, title_justify="left")
        for column, name in enumerate(self.header):
            table.add_column(name, justify="right" if column else "left")
        for row in self.rows:
            table.add_row(*row)
        return table

    def markdown(self) -> str:
        """Return it for a page, without the title."""
        marks = ["---", *["---:"] * (len(self.header) - 1)]
        return "".join(f"| {' | '.join(row)} |\n" for row in (self.header, marks, *self.rows))


def machine_lines(machine: Mapping[str, Any]) -> list[str]:
    """Return on what was measured, in sentences."""
    system = f"Linux {machine['kernel']}, Python {machine['python']}, {machine['rmw']}"
    kernels = "compiled" if machine["compiled"] else "not compiled"
    lines = [f"{machine['cores']} cores ({machine['processor']}), {system}, kernels {kernels}."]
    if machine["load"] > QUIET:
        lines.append(f"The machine was not idle, load average {machine['load']:.2f}: it can do better than this.")
    return lines


def tables(results: Mapping[str, Any]) -> dict[str, Shown]:
    """Return tables of all that was measured, by the part of the benchmark that did it."""
    made = {}
    name = next((key.removeprefix(GRAPH) for key in results if key.startswith(GRAPH)), "")
    if name:
        rows = [("graph", results[f"graph_{name}"]), ("floor: nothing computed", results[f"floor_{name}"])]
        if "faults" in results:
            rows.insert(1, (f"graph, one scan in {BAD_EVERY} of one joint bad", results["faults"]))
        made["graph"] = _latencies(f"{name} Hz: from a scan's stamp to the endpoint's pose in another process", rows)
    if "alone" in results:
        made["alone"] = _alone(results["alone"])
    if "layouts" in results:
        rows = [(LAYOUTS[layout], row) for layout, row in results["layouts"].items()]
        made["layouts"] = _latencies("What shares a process", rows)
    if "waiting" in results:
        made["waiting"] = _latencies("How drivers wait for a tick", list(results["waiting"].items()))
    if "growth" in results:
        rows = [(f"{point['joints']} x {point['rate']} Hz", point) for point in results["growth"]]
        made["growth"] = _latencies("Growth: all nodes in one process", rows)
    if "profile" in results:
        made["profile"] = _profile(results["profile"])
    single = [(text, _figure(results[key])) for key, text in SINGLE.items() if key in results]
    if single:
        made["single"] = Shown("Single figures", ("", "figure"), single)
    aims = aims_of([results])
    if aims is not None:
        made["aims"] = aims
    return made


def aims_of(runs: Sequence[Mapping[str, Any]]) -> Shown | None:
    """Return what was aimed at and found in each of some runs; None: nothing of it was measured."""
    rows = []
    for aim, found in judged(runs):
        held = sum(map(aim.holds, found))
        verdict = {len(runs): "yes", 0: "no"}.get(held, f"in {held} of {len(runs)}")
        rows.append((aim.text, aim.wanted, *map(_figure, found), verdict))
    names = ["found"] if len(runs) == 1 else [f"run {number}" for number in range(1, len(runs) + 1)]
    return Shown("What was aimed at", ("", "wanted", *names, "holds"), rows) if rows else None


def _figure(value: float | None) -> str:
    if value is None:
        return "none"
    return f"{value:,.0f}" if value >= WHOLE else f"{value:.2f}"


def _latencies(title: str, runs: Sequence[tuple[str, Mapping[str, Any]]]) -> Shown:
    rows = [
        (
            name,
            *(f"{run[key]:.0f}" for key in ("p50_us", "p99_us", "p999_us", "max_us")),
            _lost(run),
            f"{run['cpu_cores']:.2f}",
            f"{run['memory_mb']:.0f}",
        )
        for name, run in runs
    ]
    return Shown(title, LATENCY, rows)


def _alone(alone: Mapping[str, Mapping[str, Any]]) -> Shown:
    named = {"asleep": "asleep until shortly before each tick, as drivers are", "awake": "never asleep"}
    rows = [
        (
            text,
            *(f"{alone[way][key]:.0f}" for key in ("p50_us", "p99_us", "p999_us", "max_us")),
            f"{alone[way]['missed']} of {alone[way]['expected']}",
            f"{alone[way]['stolen_s']:.2f}",
        )
        for way, text in named.items()
    ]
    header = ("late by", "p50, us", "p99, us", "p99.9, us", "max, us", "ticks missed", "stolen, s")
    return Shown("The machine alone: a thread that waits for the same ticks and does nothing", header, rows)


def _profile(profile: Mapping[str, Any]) -> Shown:
    rows = [(name, f"{stage['calls']:.1f}", f"{stage['us']:.1f}") for name, stage in profile["stages"].items()]
    rows.append(("all stages", "", f"{sum(stage['us'] for stage in profile['stages'].values()):.1f}"))
    milestones = {
        "stamp_to_first_scan_us": "from the stamp to the first scan at hand, p50",
        "first_to_last_scan_us": "from the first scan to the last, p50",
        "last_scan_to_pose_us": "from the last scan at hand to the pose sent, p50",
    }
    rows += [(text, "", f"{profile[key]['p50']:.1f}") for key, text in milestones.items()]
    return Shown("Where the time of a tick goes", ("", "calls a tick", "us a tick"), rows)


def _lost(run: Mapping[str, Any]) -> str:
    """Return how many ticks were lost, and what the nodes themselves say of why."""
    said = {"ticks missed": run["ticks_missed"], "incomplete": run["incomplete"], "refused": run["refused"]}
    said |= {"not received": run["not_received"]}
    why = ", ".join(f"{count} {name}" for name, count in said.items() if count)
    return f"{run['lost']} of {run['expected']}" + (f" ({why})" if why and run["lost"] else "")
