"""Writes the report of a replay as one self-contained HTML page."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

from posor_bringup.comparison import Verdict
from posor_bringup.live_table import COLUMNS, LEGEND, cells

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from posor_bringup.comparison import Comparison
    from posor_bringup.motion import MotionTest

STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 78rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.4rem; line-height: 1.3; } h2 { font-size: 1.15rem; margin-top: 2.2rem; }
img { width: 100%; height: auto; background: #fff; border-radius: 4px; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.87rem; width: 100%; }
th, td { padding: 0.25rem 0.55rem; text-align: left; vertical-align: top; border-bottom: 1px solid #8884; }
th { border-bottom: 2px solid #8888; }
table.numbers td, table.numbers th { text-align: right; font-variant-numeric: tabular-nums; }
table.numbers td:last-child, table.numbers th:last-child { text-align: left; }
.verdict { padding: 0.5rem 0.9rem; border-left: 6px solid; border-radius: 3px; font-weight: 600; }
.holds { border-color: #0072B2; } .fails { border-color: #D55E00; }
td.holds { font-weight: 600; color: #0072B2; } td.fails { font-weight: 700; color: #D55E00; }
dt { font-weight: 600; } dd { margin: 0 0 0.6rem 1.2rem; overflow-wrap: anywhere; }
@media (prefers-color-scheme: dark) { td.holds { color: #56B4E9; } td.fails { color: #E69F00; } }
"""

_CLASSES: Mapping[Verdict, str] = {Verdict.HOLDS: "holds", Verdict.FAILS: "fails", Verdict.SHOWN: "shown"}


@dataclass(frozen=True)
class Report:
    """What the page tells.

    Attributes:
        title: Heading.
        test: The steps.
        comparison: The figures.
        picture: The curves (PNG).
        provenance: What was replayed with what: term and text.
        notes: What a reader has to know to judge the figures.

    """

    title: str
    test: MotionTest
    comparison: Comparison
    picture: bytes
    provenance: Mapping[str, str]
    notes: Sequence[str]


def page(report: Report) -> str:
    """Return the page; it refers to nothing outside itself."""
    holds = report.comparison.holds
    verdict = "The comparison holds." if holds else "The comparison does not hold."
    findings = [
        [
            f"<td>{escape(text)}</td>"
            for text in (item.what, item.computed, item.stated, item.limit, item.source, item.remark)
        ]
        + [f'<td class="{_CLASSES[item.verdict]}">{escape(item.verdict.value)}</td>']
        for item in report.comparison.findings
    ]
    first = report.test.steps[0]
    steps = [[f"<td>{escape(text)}</td>" for text in cells(step, first)] for step in report.test.steps]
    picture = base64.b64encode(report.picture).decode("ascii")
    terms = "".join(f"<dt>{escape(term)}</dt><dd>{escape(text)}</dd>" for term, text in report.provenance.items())
    notes = "".join(f"<li>{escape(note)}</li>" for note in report.notes)
    header = ("quantity", "replay", "thesis", "limit", "source", "remark", "verdict")
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(report.title.splitlines()[0])}</title>
<style>{STYLE}</style>
</head>
<body>
<h1>{escape(report.title).replace(chr(10), "<br>")}</h1>
<p class="verdict {"holds" if holds else "fails"}">{verdict}</p>
<img src="data:image/png;base64,{picture}" alt="Curves of the replayed test: angles, errors and endpoint by step">
<h2>Comparison</h2>
<div class="scroll">{_table(header, findings)}</div>
<h2>Steps</h2>
<p>{escape(LEGEND)}. All values were received over ROS.</p>
<div class="scroll">{_table(("step", *COLUMNS, "status"), steps, "numbers")}</div>
<h2>Notes</h2>
<ul>{notes}</ul>
<h2>Provenance</h2>
<dl>{terms}</dl>
</body>
</html>
"""


def _table(header: Iterable[str], rows: Iterable[Iterable[str]], kind: str = "") -> str:
    """Return a table; the cells of ``rows`` are HTML already."""
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = "\n".join(f"<tr>{''.join(row)}</tr>" for row in rows)
    return f'<table class="{kind}"><thead><tr>{head}</tr></thead><tbody>\n{body}\n</tbody></table>'
