# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Self-contained HTML pages of reports, rendered from ``report_page.html.j2``: title, verdict, sections with plots."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from jinja2 import Environment, FileSystemLoader
from markupsafe import Markup

from posor.reporting.number_columns import align_numbers

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from posor.reporting.plot import Plot

_MACROS = (
    Environment(loader=FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, lstrip_blocks=True)
    .get_template("report_page.html.j2")
    .make_module()
)


class Cell(NamedTuple):
    """A cell of a table with a CSS class: ``holds``, ``fails``, ``wrapped`` or ``number``."""

    text: str
    css_class: str = ""


@dataclass(frozen=True)
class Section:
    """A part of the page under its own heading: interactive plots, and below them text and tables."""

    heading: str
    body: Markup
    plots: Sequence[Plot] = ()


def bullet_list(items: Iterable[str]) -> Markup:
    """Return a list with bullets."""
    return _render("bullet_list", list(items))


def definition_list(terms: Mapping[str, str]) -> Markup:
    """Return terms and their definitions."""
    return _render("definition_list", terms)


def paragraph(text: str) -> Markup:
    """Return a paragraph."""
    return _render("paragraph", text)


def table(header: Iterable[str | Cell], rows: Iterable[Iterable[str | Cell]]) -> Markup:
    """Return a table; columns of numbers are flush right, with the decimal points below each other."""
    cells = [[cell if isinstance(cell, Cell) else Cell(cell) for cell in row] for row in rows]
    names = [name if isinstance(name, Cell) else Cell(name) for name in header]
    for n, column in enumerate(zip(*cells, strict=True)):
        if all(not cell.css_class for cell in column) and (numbers := align_numbers([cell.text for cell in column])):
            names[n] = names[n]._replace(css_class="number")
            for row, text in zip(cells, numbers, strict=True):
                row[n] = Cell(text, "number")
    return _render("table", names, cells)


def render_page(title: str, verdict: str, *, holds: bool, sections: Sequence[Section]) -> str:
    """Return a page that loads nothing from elsewhere.

    ``title``: heading; its first line is also the title of the window. ``verdict``: one sentence on the whole report.
    ``holds``: whether the verdict is good. ``sections``: parts of the page, in this order.
    """
    plots = [plot for section in sections for plot in section.plots]
    library, script = "", ""
    elements: dict[Plot, str] = {}
    if plots:
        from posor.reporting.plot import bokeh_script, embed_plots  # noqa: PLC0415  takes a second to load

        library = bokeh_script()
        script, elements = embed_plots(plots)
    return str(_render("page", title.splitlines(), verdict, holds, sections, library, script, elements)).lstrip()


def _render(macro: str, *arguments: object) -> Markup:
    return Markup(getattr(_MACROS, macro)(*arguments))  # noqa: S704  escaped by the template
