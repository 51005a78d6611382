"""Brings the figures of a page up to date: ``page.py PAGE BENCH_JSON...`` (docs/performance.md).

Between ``<!-- name -->`` and ``<!-- end -->`` the page has the benchmark's table of that name, or the machine that it
ran on; nobody copies a figure by hand. Of several runs the aims have a column each; all other tables are of one, the
one whose graph has the median of the median latencies.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor_estimator.errors import ParameterError
from posor_estimator.ros.main import exit_code_of

from tests.benchmarks.tables import GRAPH, aims_of, machine_lines, tables

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

PLACE = re.compile(r"<!-- (?P<name>\w+) -->\n.*?<!-- end -->", re.DOTALL)


def filled(page: str, runs: Sequence[Mapping[str, Any]]) -> str:
    """Return a page with the figures of some runs; what these do not have stays.

    Raises:
        ParameterError: No table has the name of a place.

    """
    results = middle(runs)
    texts = {name: table.markdown() for name, table in tables(results).items()}
    texts["machine"] = "\n".join(machine_lines(results["machine"])) + "\n"
    aims = aims_of(runs)
    if aims is not None:
        texts["aims"] = aims.markdown()
    names = ("machine", "aims", "graph", "alone", "waiting", "layouts", "profile", "growth", "single")

    def text(place: re.Match[str]) -> str:
        name = place["name"]
        if name not in names:
            raise ParameterError(f"'<!-- {name} -->' is no place", where="page", expected=f"one of {', '.join(names)}")
        return f"<!-- {name} -->\n{texts[name]}<!-- end -->" if name in texts else place[0]

    return PLACE.sub(text, page)


def middle(runs: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """Return the run in the middle of some, by the graph's median latency; of two the slower one."""

    def latency(run: Mapping[str, Any]) -> float:
        return float(next((run[key]["p50_us"] for key in run if key.startswith(GRAPH)), 0.0))

    return sorted(runs, key=latency)[len(runs) // 2]


def _fill(arguments: Sequence[str]) -> None:
    if len(arguments) < 2:
        raise ParameterError(f"{len(arguments)} arguments", where="page.py", expected="PAGE BENCH_JSON...")
    page, *results = map(Path, arguments)
    runs = [json.loads(result.read_text(encoding="utf-8")) for result in results]
    page.write_text(filled(page.read_text(encoding="utf-8"), runs), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(exit_code_of(lambda: _fill(sys.argv[1:])))
