# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Writes the tables of benchmark runs into a page: ``performance_page.py PAGE BENCH_JSON...``.

The page is docs/background/performance.md. The table of a name stands between ``<!-- name -->`` and ``<!-- end -->``.
The aims have a column for each run; all other tables are those of the run with the median p50 latency.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor.errors import ParameterError
from posor.reporting.program_errors import reports_errors

from posor_lab.benchmark.benchmark_tables import GRAPH, aims_table, host_lines, result_tables, to_markdown

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

PLACEHOLDER = re.compile(r"<!-- (?P<name>\w+) -->\n.*?<!-- end -->", re.DOTALL)
NAMES = (
    *("host", "aims", "start", "graph", "empty_loop", "waiting", "page", "page_priority", "layouts", "tick"),
    *("profile", "growth", "offline", "single"),
)


def fill_page(page: str, runs: Sequence[Mapping[str, Any]]) -> str:
    """Return a page with the tables of some runs; tables that were not measured stay as they are.

    Raises ParameterError: the name of a placeholder is unknown.
    """
    results = median_run(runs)
    texts = {name: to_markdown(table) for name, table in result_tables(results).items()}
    texts["host"] = "\n".join(host_lines(results["host"])) + "\n"
    aims = aims_table(runs)
    if aims is not None:
        texts["aims"] = to_markdown(aims)
    return replace_tables(page, texts, NAMES)


def replace_tables(page: str, texts: Mapping[str, str], names: Sequence[str]) -> str:
    """Return a page with new tables, ``texts`` by name. Raises ParameterError: a placeholder is none of ``names``."""

    def replacement(placeholder: re.Match[str]) -> str:
        name = placeholder["name"]
        if name not in names:
            expected = f"one of {', '.join(names)}"
            raise ParameterError(f"unknown placeholder '<!-- {name} -->'", where="page", expected=expected)
        return f"<!-- {name} -->\n{texts[name]}<!-- end -->" if name in texts else placeholder[0]

    return PLACEHOLDER.sub(replacement, page)


def median_run(runs: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """Return the run with the median p50 latency of the main graph; of two runs the slower one."""

    def latency_us(run: Mapping[str, Any]) -> float:
        return float(next((run[key]["p50_us"] for key in run if key.startswith(GRAPH)), 0.0))

    return sorted(runs, key=latency_us)[len(runs) // 2]


@reports_errors
def main(arguments: Sequence[str]) -> int:
    """Write the tables of benchmark results into a page; the exit code is 0 if it was written."""
    if len(arguments) <= 1:
        raise ParameterError(f"{len(arguments)} arguments", where="performance_page", expected="PAGE BENCH_JSON...")
    page, *results = map(Path, arguments)
    runs = [json.loads(result.read_text(encoding="utf-8")) for result in results]
    page.write_text(fill_page(page.read_text(encoding="utf-8"), runs), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
