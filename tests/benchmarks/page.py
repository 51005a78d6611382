"""Brings the figures of a page up to date: ``page.py BENCH_JSON PAGE`` (docs/performance.md).

Between ``<!-- name -->`` and ``<!-- end -->`` the page has the benchmark's table of that name, or the machine that it
ran on; nobody copies a figure by hand.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor_estimator.errors import ParameterError
from posor_estimator.ros.main import exit_code_of

from tests.benchmarks.tables import machine_lines, tables

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

PLACE = re.compile(r"<!-- (?P<name>\w+) -->\n.*?<!-- end -->", re.DOTALL)


def filled(page: str, results: Mapping[str, Any]) -> str:
    """Return a page with the figures of some results; what these do not have stays.

    Raises:
        ParameterError: No table has the name of a place.

    """
    texts = {name: table.markdown() for name, table in tables(results).items()}
    texts["machine"] = "\n".join(machine_lines(results["machine"])) + "\n"
    names = ("machine", "aims", "graph", "alone", "waiting", "layouts", "profile", "growth", "single")

    def text(place: re.Match[str]) -> str:
        name = place["name"]
        if name not in names:
            raise ParameterError(f"'<!-- {name} -->' is no place", where="page", expected=f"one of {', '.join(names)}")
        return f"<!-- {name} -->\n{texts[name]}<!-- end -->" if name in texts else place[0]

    return PLACE.sub(text, page)


def _fill(arguments: Sequence[str]) -> None:
    if len(arguments) != 2:
        raise ParameterError(f"{len(arguments)} arguments", where="page.py", expected="two: BENCH_JSON PAGE")
    results, page = map(Path, arguments)
    read = json.loads(results.read_text(encoding="utf-8"))
    page.write_text(filled(page.read_text(encoding="utf-8"), read), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(exit_code_of(lambda: _fill(sys.argv[1:])))
