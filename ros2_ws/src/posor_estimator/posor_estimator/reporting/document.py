"""Writes a report as one self-contained HTML page: heading, verdict, picture, sections."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

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


@dataclass(frozen=True)
class Section:
    """A part of the page under a heading of its own; ``html`` is HTML already."""

    heading: str
    html: str


@dataclass(frozen=True)
class Picture:
    """A picture (PNG) and what to say where it cannot be shown."""

    png: bytes
    instead: str


def document(title: str, verdict: str, *, holds: bool, picture: Picture | None, sections: Sequence[Section]) -> str:
    """Return the page; it refers to nothing outside itself.

    Args:
        title: Heading; its first line is also the window's title.
        verdict: One sentence on the whole run.
        holds: Whether that is good news.
        picture: The curves; None where they stand in the sections.
        sections: What follows, in this order.

    """
    body = "\n".join(f"<h2>{escape(section.heading)}</h2>\n{section.html}" for section in sections)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title.splitlines()[0])}</title>
<style>{STYLE}</style>
</head>
<body>
<h1>{escape(title).replace(chr(10), "<br>")}</h1>
<p class="verdict {"holds" if holds else "fails"}">{escape(verdict)}</p>
{image(picture) if picture else ""}
{body}
</body>
</html>
"""


def image(picture: Picture) -> str:
    """Return a picture as HTML, its data in it."""
    data = base64.b64encode(picture.png).decode("ascii")
    return f'<img src="data:image/png;base64,{data}" alt="{escape(picture.instead)}">'


def notes_list(notes: Iterable[str]) -> str:
    """Return notes as a list."""
    return f"<ul>{''.join(f'<li>{escape(note)}</li>' for note in notes)}</ul>"


def terms_list(terms: Mapping[str, str]) -> str:
    """Return terms and what is said of them."""
    return f"<dl>{''.join(f'<dt>{escape(term)}</dt><dd>{escape(text)}</dd>' for term, text in terms.items())}</dl>"


def cells(texts: Iterable[str]) -> list[str]:
    """Return texts as cells of a table."""
    return [f"<td>{escape(text)}</td>" for text in texts]


def table(header: Iterable[str], rows: Iterable[Iterable[str]], kind: str = "") -> str:
    """Return a table; the cells of ``rows`` are HTML already. Of kind ``numbers``: columns flush right."""
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = "\n".join(f"<tr>{''.join(row)}</tr>" for row in rows)
    rules = f"<thead><tr>{head}</tr></thead><tbody>\n{body}\n</tbody>"
    return f'<div class="scroll"><table class="{kind}">{rules}</table></div>'
