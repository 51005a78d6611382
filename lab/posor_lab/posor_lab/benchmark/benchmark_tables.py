"""The figures of the benchmark as tables, for the terminal and for docs/background/performance.md."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich.table import Table

from posor_lab.benchmark.aims import evaluate_aims
from posor_lab.benchmark.benchmark_sections import FAULT_INTERVAL
from posor_lab.benchmark.graph_load import LAYOUTS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

WHOLE_NUMBERS_FROM = 1000.0
IDLE_LOAD = 0.5
"""Load average up to which the host counts as idle."""
GRAPH = "graph_"
"""Prefix of the key of the main graph."""
PERCENTILES = ("p50_us", "p99_us", "p999_us", "max_us")
PERCENTILE_HEADER = ("p50, us", "p99, us", "p99.9, us", "max, us")
EMPTY_LOOP_ROWS = {"asleep": "asleep until shortly before each tick, as drivers are", "awake": "never asleep"}
MILESTONE_ROWS = {
    "stamp_to_first_scan_us": "from the stamp to the first scan, p50",
    "first_to_last_scan_us": "from the first scan to the last, p50",
    "last_scan_to_pose_us": "from the last scan to the published pose, p50",
}
OFFLINE_ROWS = {
    "offline_scans_per_s": "`reprocess`: reads the bag in blocks, estimates poses and endpoints, writes a bag",
    "reading_messages_per_s": (
        "read only: a loop that reads and decodes each message with rosbags and does nothing else"
    ),
    "bulk_loop_scans_per_s": (
        "bulk: a loop that reads and decodes each message with rosbags into arrays, then estimates all poses "
        "and endpoints in one call per joint and one for the chain; writes nothing"
    ),
    "message_loop_scans_per_s": (
        "message by message: a loop that decodes each message with rclpy, calls the estimator for each scan and the "
        "chain for each stamp, and writes each result; results equal to those of `reprocess` bit for bit"
    ),
}
"""Offline processing, by the keys of the figures [scans/s of processor time]."""
SINGLE_FIGURES = {
    "ratio_p50": "p50, graph to pass-through graph",
    "ratio_p99": "p99, graph to pass-through graph",
    "highest_rate_hz": "highest rate without loss, Hz",
    "highest_rate_nearly_hz": "highest rate at which no more than 1 % of the ticks are lost, Hz",
    "highest_rate_separate_hz": (
        "one process for each node: highest of 125, 250, 500, 1000 Hz at which at most 0.1 % of the ticks are lost"
    ),
    "kernel_us": "estimator, many scans in one call, us per scan",
    "scan_us": "estimator, scan by scan, us per scan",
    "offline_memory_mb": "`reprocess`, memory, MB",
}


@dataclass(frozen=True)
class FigureTable:
    """A table; its first column is text, all others are figures."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]

    def to_rich(self) -> Table:
        """Return the table for the terminal."""
        table = Table(title=self.title, title_justify="left")
        for column, name in enumerate(self.header):
            table.add_column(name, justify="right" if column else "left")
        for row in self.rows:
            table.add_row(*row)
        return table

    def to_markdown(self) -> str:
        """Return the table for a page, without the title."""
        marks = ["---", *["---:"] * (len(self.header) - 1)]
        return "".join(f"| {' | '.join(row)} |\n" for row in (self.header, marks, *self.rows))


def host_lines(host: Mapping[str, Any]) -> list[str]:
    """Return sentences on the host."""
    system = f"Linux {host['kernel']}, Python {host['python']}, {host['rmw']}"
    kernels = "compiled" if host["compiled"] else "not compiled"
    lines = [f"{host['cores']} cores ({host['processor']}), {system}, kernels {kernels}."]
    if host["load"] > IDLE_LOAD:
        lines.append(f"The host was not idle: load average {host['load']:.2f}.")
    return lines


def result_tables(results: Mapping[str, Any]) -> dict[str, FigureTable]:
    """Return the tables of all measured sections by name."""
    tables = {}
    name = next((key.removeprefix(GRAPH) for key in results if key.startswith(GRAPH)), "")
    if name:
        tables["graph"] = _graph_table(name, results)
    makers: dict[str, Callable[[Any], FigureTable]] = {
        "empty_loop": _empty_loop_table,
        "layouts": lambda runs: _latency_table(
            "Nodes that share a process", [(LAYOUTS[layout], run) for layout, run in runs.items()]
        ),
        "waiting": lambda runs: _latency_table("How drivers wait for a tick", list(runs.items())),
        "growth": lambda points: _latency_table(
            "Growth: all nodes in one process",
            [(f"{point['joints']} x {point['rate']} Hz", point) for point in points],
        ),
        "profile": _profile_table,
    }
    tables |= {key: make(results[key]) for key, make in makers.items() if key in results}
    if "offline_scans_per_s" in results:
        tables["offline"] = _offline_table(results)
    single = [(text, _format_figure(results[key])) for key, text in SINGLE_FIGURES.items() if key in results]
    if single:
        tables["single"] = FigureTable("Single figures", ("", "figure"), single)
    aims = aims_table([results])
    if aims is not None:
        tables["aims"] = aims
    return tables


def aims_table(runs: Sequence[Mapping[str, Any]]) -> FigureTable | None:
    """Return the aims with the figures of each run; None: no aim was measured."""
    rows = []
    for aim, figures in evaluate_aims(runs):
        holding = sum(map(aim.holds, figures))
        verdict = {len(runs): "yes", 0: "no"}.get(holding, f"in {holding} of {len(runs)}")
        rows.append((aim.text, aim.wanted, *map(_format_figure, figures), verdict))
    names = ["measured"] if len(runs) == 1 else [f"run {number}" for number in range(1, len(runs) + 1)]
    return FigureTable("Aims", ("", "wanted", *names, "holds"), rows) if rows else None


def _format_figure(value: float | None) -> str:
    if value is None:
        return "none"
    return f"{value:,.0f}" if value >= WHOLE_NUMBERS_FROM else f"{value:.2f}"


def _format_percentiles(figures: Mapping[str, Any]) -> list[str]:
    return [f"{figures[key]:.0f}" for key in PERCENTILES]


def _latency_table(title: str, runs: Sequence[tuple[str, Mapping[str, Any]]]) -> FigureTable:
    rows = [
        (name, *_format_percentiles(run), _format_lost(run), f"{run['cpu_cores']:.2f}", f"{run['memory_mb']:.0f}")
        for name, run in runs
    ]
    return FigureTable(title, ("", *PERCENTILE_HEADER, "lost", "cores", "MB"), rows)


def _graph_table(name: str, results: Mapping[str, Any]) -> FigureTable:
    rows = [("graph", results[f"{GRAPH}{name}"])]
    if "faults" in results:
        rows.append((f"graph, one scan in {FAULT_INTERVAL} of one joint faulty", results["faults"]))
    rows.append(("pass-through: nothing computed", results[f"pass_through_{name}"]))
    return _latency_table(f"{name} Hz: from a scan's stamp to the endpoint's pose in another process", rows)


def _empty_loop_table(figures: Mapping[str, Mapping[str, Any]]) -> FigureTable:
    rows = []
    for way, text in EMPTY_LOOP_ROWS.items():
        loop = figures[way]
        missed = f"{loop['missed']} of {loop['expected']}"
        rows.append((text, *_format_percentiles(loop), missed, f"{loop['stolen_s']:.2f}"))
    header = ("late by", *PERCENTILE_HEADER, "ticks missed", "stolen, s")
    return FigureTable("Empty loop: a thread that waits for the same ticks and does nothing", header, rows)


def _profile_table(profile: Mapping[str, Any]) -> FigureTable:
    rows = [(name, f"{stage['calls']:.1f}", f"{stage['us']:.1f}") for name, stage in profile["stages"].items()]
    rows.append(("all stages", "", f"{sum(stage['us'] for stage in profile['stages'].values()):.1f}"))
    rows += [(text, "", f"{profile[key]['p50']:.1f}") for key, text in MILESTONE_ROWS.items()]
    return FigureTable("Time of the stages of a tick", ("", "calls per tick", "us per tick"), rows)


def _offline_table(results: Mapping[str, Any]) -> FigureTable:
    reprocess = results["offline_scans_per_s"]
    rows = [(text, f"{results[key]:,.0f}", f"{reprocess / results[key]:.1f}") for key, text in OFFLINE_ROWS.items()]
    return FigureTable("Offline processing", ("loop", "scans/s per core", "`reprocess` is faster by"), rows)


def _format_lost(run: Mapping[str, Any]) -> str:
    """Return the number of lost ticks with the causes that the nodes have counted."""
    causes = {"ticks missed": "ticks_missed", "incomplete": "incomplete", "refused": "refused"}
    causes |= {"not received": "not_received"}
    counted = ", ".join(f"{run[key]} {cause}" for cause, key in causes.items() if run[key])
    return f"{run['lost']} of {run['expected']}" + (f" ({counted})" if counted and run["lost"] else "")
