# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The figures of the benchmark as tables, for the terminal and for docs/background/performance.md.

``benchmark_tables.yaml`` has the texts and the aims.
"""

from __future__ import annotations

from functools import partial, reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from posor.reporting.report_table import ReportTable

from posor_lab.benchmark.benchmark_sections import FAULT_INTERVAL
from posor_lab.benchmark.graph_measurement import VIEW

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

WHOLE_NUMBERS_FROM = 1000.0
IDLE_LOAD = 0.5  # load average up to which the host counts as idle
GRAPH = "graph_"  # prefix of the key of the main graph
PERCENTILES = {"p50_us": "p50, us", "p99_us": "p99, us", "p999_us": "p99.9, us", "max_us": "max, us"}
CAUSES = {
    "ticks_missed": "ticks missed",
    "incomplete": "incomplete",
    "refused": "refused",
    "not_received": "not received",
}
TEXTS: Mapping[str, Any] = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))


def to_markdown(table: ReportTable) -> str:
    """Return a table for a page, without its title; its first column is text, all others are figures."""
    marks = ["---", *["---:"] * (len(table.header) - 1)]
    return "".join(f"| {' | '.join(row)} |\n" for row in (table.header, marks, *table.rows))


def host_lines(host: Mapping[str, Any]) -> list[str]:
    """Return sentences on the host."""
    system = f"Linux {host['kernel']}, Python {host['python']}, {host['rmw']}"
    lines = [f"{host['cores']} cores ({host['processor']}), {system}, kernels by {host['kernels']}."]
    if host["load"] > IDLE_LOAD:
        lines.append(f"The host was not idle: load average {host['load']:.2f}.")
    return lines


def result_tables(results: Mapping[str, Any]) -> dict[str, ReportTable]:
    """Return the tables of all measured sections by name."""
    name = next((key.removeprefix(GRAPH) for key in results if key.startswith(GRAPH)), "")
    single = [(text, _format_figure(results[key])) for key, text in TEXTS["single"].items() if key in results]
    tables: dict[str, ReportTable | None] = {}
    if name:
        tables["graph"] = _graph_table(name, results)
    for key, make in TABLES.items():
        if key in results:
            tables[key] = make(results[key])
    if "offline_scans_per_s" in results:
        tables["offline"] = _offline_table(results)
    if single:
        tables["single"] = ReportTable("Single figures", ("", "figure"), single)
    tables["aims"] = aims_table([results])
    return {key: table for key, table in tables.items() if table is not None}


def _graph_table(name: str, results: Mapping[str, Any]) -> ReportTable:
    runs = {"graph": results[f"{GRAPH}{name}"]}
    if "faults" in results:
        runs[f"graph, one scan in {FAULT_INTERVAL} of one joint faulty"] = results["faults"]
    runs["pass-through: nothing computed"] = results[f"pass_through_{name}"]
    return _latency_table(f"{name} Hz: from a scan's stamp to the endpoint's pose in another process", runs)


def aims_table(runs: Sequence[Mapping[str, Any]]) -> ReportTable | None:
    """Return the aims with the figures of each run; None: no aim was measured, by all runs and long enough."""
    rows = []
    for aim in TEXTS["aims"]:
        try:
            figures = [_aim_figure(aim, run) for run in runs]
        except KeyError:
            continue
        at_least = "at_least" in aim
        bound = aim["at_least" if at_least else "at_most"]
        holding = sum(figure >= bound if at_least else figure <= bound for figure in figures)
        verdict = {len(runs): "yes", 0: "no"}.get(holding, f"in {holding} of {len(runs)}")
        wanted = f"at {'least' if at_least else 'most'} {bound:,g}"
        rows.append((aim["text"], wanted, *map(_format_figure, figures), verdict))
    names = ["measured"] if len(runs) == 1 else [f"run {number}" for number in range(1, len(runs) + 1)]
    return ReportTable("Aims", ("", "wanted", *names, "holds"), rows) if rows else None


def _aim_figure(aim: Mapping[str, Any], run: Mapping[str, Any]) -> float:
    """Return the figure of an aim; KeyError: it was not measured long enough."""

    def value(name: str) -> float:
        found: Any = reduce(lambda part, key: part[key], name.split("."), run)
        return float(found)

    if any(value(name) < least for name, least in aim["needs"].items()):
        raise KeyError(aim["text"])
    return value(aim["figure"]) / (value(aim["over"]) if "over" in aim else 1.0)


def _format_figure(value: float | None) -> str:
    if value is None:
        return "none"
    return f"{value:,.0f}" if value >= WHOLE_NUMBERS_FROM else f"{value:.2f}"


def _format_percentiles(figures: Mapping[str, Any]) -> list[str]:
    return [f"{figures[key]:.0f}" for key in PERCENTILES]


def _latency_table(title: str, runs: Mapping[str, Mapping[str, Any]]) -> ReportTable:
    rows = [
        (name, *_format_percentiles(run), _format_lost(run), f"{run['cpu_cores']:.2f}", f"{run['memory_mb']:.0f}")
        for name, run in runs.items()
    ]
    return ReportTable(title, ("", *PERCENTILES.values(), "lost", "cores", "MB"), rows)


def _format_lost(run: Mapping[str, Any]) -> str:
    """Return the number of lost ticks with the causes that the nodes have counted."""
    counted = ", ".join(f"{run[key]} {cause}" for key, cause in CAUSES.items() if run[key])
    return f"{run['lost']} of {run['expected']}" + (f" ({counted})" if counted and run["lost"] else "")


def _empty_loop_table(loops: Mapping[str, Mapping[str, Any]]) -> ReportTable:
    rows = [
        (text, *_format_percentiles(loop), f"{loop['missed']} of {loop['expected']}", f"{loop['stolen_s']:.2f}")
        for text, loop in ((text, loops[way]) for way, text in TEXTS["empty_loop"].items())
    ]
    header = ("late by", *PERCENTILES.values(), "ticks missed", "stolen, s")
    return ReportTable("Empty loop: a thread that waits for the same ticks and does nothing", header, rows)


def _page_table(title: str, runs: Mapping[str, Mapping[str, Any]]) -> ReportTable:
    rows = []
    for text, run in ((text, runs[use]) for use, text in TEXTS["page"].items()):
        view = run["processes"].get(VIEW)
        used = ("", "") if view is None else (f"{100.0 * view['cpu_cores']:.1f}", f"{view['memory_mb']:.0f}")
        ratios = ("" if view is None else _format_ratio(run[key]) for key in ("published_p99_ratio", "p99_ratio"))
        rows.append((text, *_format_percentiles(run), *ratios, _format_lost(run), *used))
    ratio_names = ("p99 of publication, to that without", "p99 to that without")
    header = ("", *PERCENTILES.values(), *ratio_names, "lost", "view, % of a core", "view, MB")
    return ReportTable(title, header, rows)


def _format_ratio(ratio: Mapping[str, float | None]) -> str:
    """Return a median of pairs with its 95 % interval, if it has one."""
    interval = "" if ratio["low"] is None else f" ({ratio['low']:.2f} to {ratio['high']:.2f})"
    return f"{ratio['median']:.2f}{interval}"


def _profile_table(profile: Mapping[str, Any]) -> ReportTable:
    rows = [(name, f"{stage['calls']:.1f}", f"{stage['us']:.1f}") for name, stage in profile["stages"].items()]
    rows.append(("all stages", "", f"{sum(stage['us'] for stage in profile['stages'].values()):.1f}"))
    rows += [(text, "", f"{profile[key]['p50']:.1f}") for key, text in TEXTS["milestones"].items()]
    return ReportTable("Time of the stages of a tick", ("", "calls per tick", "us per tick"), rows)


def _offline_table(results: Mapping[str, Any]) -> ReportTable:
    speeds = [(text, results[key]) for key, text in TEXTS["offline"].items()]
    rows = [(text, f"{speed:,.0f}", f"{speeds[0][1] / speed:.1f}") for text, speed in speeds]
    return ReportTable("Offline processing", ("loop", "scans/s per core", "`reprocess` is faster by"), rows)


TABLES: Mapping[str, Callable[[Any], ReportTable]] = {  # tables of single sections of the results, by their keys
    "empty_loop": _empty_loop_table,
    "layouts": partial(_latency_table, "Nodes that share a process"),
    "tick": lambda costs: ReportTable(
        "Processor time of the nodes in a tick, scans published in a loop",
        ("", "least, us", "median, us", "up to the pose: least, us", "median, us"),
        [(TEXTS["tick"][kind], *map(_format_figure, cost.values())) for kind, cost in costs.items()],
    ),
    "start": lambda costs: ReportTable(
        "Start of a node, from exec to the line 'ready', medians",
        ("", "time, s", "processor time, s", "memory, MB", "private dirty memory, MB"),
        [(TEXTS["start"][name], *map(_format_figure, cost.values())) for name, cost in costs.items()],
    ),
    "page": partial(_page_table, "The main graph beside the live page"),
    "page_priority": partial(_page_table, "The same, graph and receiver with real-time priority"),
    "waiting": partial(_latency_table, "How drivers wait for a tick"),
    "growth": lambda points: _latency_table(
        "Growth: all nodes in one process", {f"{point['joints']} x {point['rate']} Hz": point for point in points}
    ),
    "profile": _profile_table,
}
