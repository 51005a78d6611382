# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Aims and tables of docs/background/performance.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from posor.errors import ParameterError
from posor_lab.benchmark.benchmark_tables import TEXTS, aims_table, result_tables
from posor_lab.benchmark.performance_page import NAMES, PLACEHOLDER, fill_page

ROOT = Path(__file__).resolve().parents[4]
HOST = {"cores": 2, "processor": "P", "kernel": "6", "python": "3", "rmw": "r", "kernels": "library", "load": 0.1}
GRAPH = {
    **dict.fromkeys(("p50_us", "p99_us", "p999_us", "max_us", "published_p99_us"), 150.0),
    **dict.fromkeys(("lost", "ticks_missed", "incomplete", "refused", "not_received"), 0),
    "expected": 1000,
    "cpu_cores": 0.5,
    "memory_mb": 100.0,
}


def run_with(lost: int, p50_us: float, scans_per_s: float) -> dict[str, Any]:
    """Return the figures of a run that is long enough to be judged."""
    return {
        "graph_6x2000": {"expected": 120_100, "lost": lost, "p99_us": 900.0, "p50_us": p50_us},
        "pass_through_6x2000": {"p50_us": 100.0},
        "offline_scans": 3_600_000,
        "offline_scans_per_s": scans_per_s,
        "message_loop_scans_per_s": 1e4,
        "offline_memory_mb": 400.0,
    }


def test_aims_are_judged_by_all_runs() -> None:
    slow, fast = run_with(1, 151.0, 2e5), run_with(0, 150.0, 4e5)
    table = aims_table([fast, slow, fast])
    assert table is not None
    assert table.header == ("", "wanted", "run 1", "run 2", "run 3", "holds")
    assert table.rows == [
        ("six joints at 2 kHz: ticks lost", "at most 0", "0.00", "1.00", "0.00", "in 2 of 3"),
        ("p99, us", "at most 1,000", "900.00", "900.00", "900.00", "yes"),
        ("p50, graph to pass-through graph", "at most 1.5", "1.50", "1.51", "1.50", "in 2 of 3"),
        ("reprocess, scans/s per core", "at least 300,000", "400,000", "200,000", "400,000", "in 2 of 3"),
        (
            "reprocess to the loop message by message, whose results are the same",
            "at least 20",
            *("40.00", "20.00", "40.00", "yes"),
        ),
        ("reprocess, memory, MB", "at most 500", "400.00", "400.00", "400.00", "yes"),
    ]
    single = aims_table([slow])
    assert single is not None
    assert single.header == ("", "wanted", "measured", "holds")
    assert single.rows[0] == ("six joints at 2 kHz: ticks lost", "at most 0", "1.00", "no")


def test_short_runs_are_not_judged() -> None:
    short = {**run_with(0, 100.0, 6e5), "offline_scans": 120_000}
    short["graph_6x2000"]["expected"] = 12_000
    assert aims_table([short]) is None
    assert aims_table([{"graph_2x200": {}}]) is None


def test_the_graph_is_compared_with_itself_beside_the_live_page() -> None:
    runs = {use: {**GRAPH, "expected": 60_000, "processes": {"nodes": {}}} for use in TEXTS["page"]}
    for use, cores in (("at rest", 0.03), ("shown", 0.25)):
        runs[use]["processes"] = {"nodes": {}, "view": {"cpu_cores": cores, "memory_mb": 220.0}}
    ratios = {"absent": (1.0, 1.0, 1.0), "at rest": (1.02, None, None), "shown": (1.07, 0.98, 1.2)}
    for use, ratio in ratios.items():
        runs[use]["p99_ratio"] = dict(zip(("median", "low", "high"), ratio, strict=True))
        runs[use]["published_p99_ratio"] = {"median": 1.2, "low": None, "high": None}
    tables = result_tables({"page": runs})
    assert [(*row[5:7], *row[-2:]) for row in tables["page"].rows] == [
        ("", "", "", ""),
        ("1.20", "1.02", "3.0", "220"),
        ("1.20", "1.07 (0.98 to 1.20)", "25.0", "220"),
    ]
    assert [row[2:] for row in tables["aims"].rows] == [
        ("1.20", "no"),
        ("1.07", "yes"),
        ("0.25", "no"),
        ("0.03", "yes"),
    ]


def test_offline_table_compares_reprocess_with_each_loop() -> None:
    results = dict(zip(TEXTS["offline"], (400_000.0, 80_000.0, 50_000.0, 8_000.0), strict=True))
    rows = result_tables(results)["offline"].rows
    assert [row[1:] for row in rows] == [("400,000", "1.0"), ("80,000", "5.0"), ("50,000", "8.0"), ("8,000", "50.0")]
    assert [row[0].partition(":")[0] for row in rows] == ["`reprocess`", "read only", "bulk", "message by message"]


def test_page_gets_the_measured_tables_and_keeps_the_others() -> None:
    page = "Text.\n<!-- host -->\nold\n<!-- end -->\n<!-- graph -->\n<!-- end -->\n<!-- growth -->\nold\n<!-- end -->\n"
    results = {"host": HOST, "graph_6x2000": GRAPH, "pass_through_6x2000": GRAPH}
    filled = fill_page(page, [results])
    assert filled.startswith(
        "Text.\n<!-- host -->\n2 cores (P), Linux 6, Python 3, r, kernels by library.\n<!-- end -->\n"
    )
    assert "| graph | 150 | 150 | 150 | 150 | 0 of 1000 | 0.50 | 100 |\n" in filled
    assert filled.endswith("<!-- growth -->\nold\n<!-- end -->\n")
    assert fill_page(filled, [results]) == filled
    others = [{**results, "graph_6x2000": {**GRAPH, "p50_us": latency}} for latency in (1.0, 170.0, 160.0)]
    assert "| graph | 160 | 150 |" in fill_page(page, others)
    with pytest.raises(ParameterError, match="unknown placeholder '<!-- grpah -->'"):
        fill_page("<!-- grpah -->\n<!-- end -->\n", [results])


def test_page_has_every_table() -> None:
    names = PLACEHOLDER.findall((ROOT / "docs/background/performance.md").read_text(encoding="utf-8"))
    assert sorted(names) == sorted(NAMES)
