# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""make scaling: figures of a cell follow from those of one arm; the whole program on a small arm."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from posor_lab.benchmark.scaling_command import main
from posor_lab.benchmark.scaling_measurement import read_topics
from posor_lab.benchmark.scaling_tables import OTHERS, kinds_of_topics, scaling_tables, wire_bytes

ROOT = Path(__file__).resolve().parents[4]
BAG = ROOT / "bags" / "five_axis"
PAGE = ROOT / "docs" / "how_to" / "scaling.md"


def topic(size: float, per_s: float) -> dict[str, float]:
    return {"bytes": size, "per_s": per_s}


def results() -> dict[str, Any]:
    topics = {
        f"/a/j{n}/{name}": topic(size, 500.0) for n in range(2) for name, size in (("raw", 276), ("transform", 2740))
    }
    topics |= {f"/a/endpoint/{name}": topic(100, 500.0) for name in ("pose", "state")}
    topics |= {"/diagnostics": topic(1000, 1.0), "/rosout": topic(200, 2.0)}
    arm = {"name": "a", "topics": topics, "ticks_per_s": 500.0, "tick_s": 200e-6, "tick_s_received": 100e-6}
    cell = {"arms": 12, "joints": 2, "rate": 1000, "cores": 8, "share": 0.5, "speed": 2.0, "price": 0.1}
    runs = {"1": {"wall_s": 20.0, "cpu_s": 18.0}, "2": {"wall_s": 10.0, "cpu_s": 18.0}}
    cluster = {"bag_bytes": 5e8, "bag_seconds": 1000, "result_bytes": 1e9, "runs": runs}
    return {"cell": cell, "arm": arm | {"participants": 1, "endpoints": 100}, "cluster": cluster}


def test_bytes_on_ethernet_contain_all_headers() -> None:
    assert wire_bytes(84) == 84 + (8 + 20 + 12 + 24) + 20 + 38
    assert wire_bytes(1480 - 64) == 1480 + 58
    assert wire_bytes(1480 - 63) == 1481 + 2 * 58


def test_kinds_of_topics_have_the_stated_rate_though_the_host_missed_ticks() -> None:
    kinds = kinds_of_topics(results()["arm"], 1000.0)
    assert kinds["raw"] == {"topics": 2.0, "bytes": 276, "per_s": 2000.0, "wire_per_s": 2000.0 * wire_bytes(276)}
    assert kinds["endpoint/pose"]["per_s"] == 1000.0
    assert (kinds[OTHERS]["topics"], kinds[OTHERS]["per_s"]) == (2.0, 3.0)


@pytest.mark.parametrize(
    ("table", "row", "column", "cell"),
    [
        ("processor", 0, 2, "0.10"),
        ("processor", 1, 3, "20"),
        ("processor", 1, 4, "1"),
        ("bandwidth", 0, 2, "24,000"),
        ("bandwidth", 0, 3, f"{100 * 24_000 * (100 + 64 + 58) / 125e6:.1f}"),
        ("discovery", 0, 1, "132"),
        ("discovery", 0, 2, "13,200"),
        ("discovery", 2, 2, "1,200"),
        ("clock", 0, 1, "2,000.0"),
        ("cluster", 1, 1, "50.0"),
        ("cluster", 1, 2, "100"),
        ("cluster", 1, 3, "10.0"),
        ("years", 0, 1, "43"),
        ("years", 1, 1, f"{12 * 0.5e6 * 365.25 * 86400 / 1e12:.0f}"),
        ("years", 2, 1, "2.00"),
        ("years", 3, 1, "1.00"),
    ],
)
def test_figures_of_the_cell(table: str, row: int, column: int, cell: str) -> None:
    assert scaling_tables(results())[table].rows[row][column] == cell


def test_the_page_has_a_place_for_each_table() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert all(text.count(f"<!-- {name} -->\n") == 1 for name in ("host", *scaling_tables(results())))


def test_topics_of_a_bag_within_a_time() -> None:
    (path,) = BAG.glob("*.mcap")
    found = read_topics(path, 0, 2**63 - 1)
    raw = [each for name, each in found.items() if name.endswith("/raw")]
    assert len(raw) == 5
    assert all(150 < each["bytes"] < 400 for each in raw)
    assert read_topics(path, 0, 1) == {}


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_small_run_writes_all_figures(tmp_path: Path) -> None:
    page, output = tmp_path / "page.md", tmp_path / "scaling.json"
    page.write_text("<!-- cluster -->\n<!-- end -->\n", encoding="utf-8")
    small = ["--joints", "2", "--rate", "200", "--seconds", "2", "--bag-seconds", "2", "--page", str(page)]
    assert main([*small, "--output", str(output)]) == 0
    content = json.loads(output.read_text(encoding="utf-8"))
    kinds = kinds_of_topics(content["arm"], 200.0)
    assert kinds["raw"]["per_s"] == pytest.approx(400.0)
    assert kinds["endpoint/pose"]["per_s"] == pytest.approx(200.0, rel=0.05)
    assert content["arm"]["endpoints"] > 20
    assert "core hours per TB" in page.read_text(encoding="utf-8")
