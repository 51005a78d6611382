# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of the thesis, redrawn from the files of rows.

A figure of a file is a call that returns plots, or a mapping with ``title``, ``x`` and ``y`` (labels) and as needed:

- ``unit`` and ``scale``: units of x and y; default: 1. ``log``: the logarithmic axes.
- ``tables`` and ``values``: as in a row.
- ``at``: numbers on the x axis, in ``unit``.
- ``curves``: ``name``, ``colour``, and as needed ``dash`` (``none``: points only), ``marker``, ``size``, ``tables``,
  ``values`` and ``at``; y is ``each``, a value at each ``$x``, or ``series``: values at the places ``where``.
- ``bars``: ``name``, ``colour``, ``categories`` and ``series``.
- ``vertical`` and ``horizontal``: lines, ``name`` and ``value``. ``zero``: a line at y = 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from posor.reporting import figure_style
from posor.reporting.plot import Plot

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_lab.thesis_table.row_file import RowFile

_FIGURE = ("unit", "scale", "log", "at", "curves", "bars", "vertical", "horizontal", "zero", "tables", "values")
_CURVE = ("each", "at", "where", "series", "dash", "marker", "size", "tables", "values")


def draw_figures(file: RowFile) -> list[Plot]:
    """Return the figures of a file. Raises PosorError: a figure is invalid, or one of its functions fails."""
    plots: list[Plot] = []
    for content in file.content.get("figures", []):
        file.enter("figures", content, "title")
        if "function" in content:
            plots += file.evaluate(content, {})
        else:
            file.check_keys(content, ("title", "x", "y"), _FIGURE)
            plots += [_draw(file, content, columns) for columns in file.combinations(content)]
    return plots


def _draw(file: RowFile, content: Mapping[str, Any], columns: Mapping[str, Any]) -> Plot:
    unit, scale = (file.amount(file.fill(content.get(key, "1"), columns)) for key in ("unit", "scale"))
    bars = content.get("bars", [])
    plot = Plot(
        file.fill(content["title"], columns),
        content["x"],
        file.fill(content["y"], columns),
        categories=file.evaluate(bars[0]["categories"], columns) if bars else (),
        x_log="x" in content.get("log", ()),
        y_log="y" in content.get("log", ()),
    )
    for entry in bars:
        file.check_keys(entry, ("name", "colour", "categories", "series"), ())
        lengths = np.array(file.evaluate(entry["series"], columns)) / unit
        plot.bars(entry["name"], lengths, file.evaluate(entry["categories"], columns), _colour(entry["colour"]))
    for entry in content.get("curves", []):
        file.check_keys(entry, ("name", "colour"), _CURVE)
        for own in file.combinations(entry, columns):
            style = {key: file.fill(entry[key], own) for key in ("colour", "dash", "marker", "size") if key in entry}
            if "series" in entry:
                x, y = (np.array(file.evaluate(entry[key], own)) for key in ("where", "series"))
            else:
                x = unit * np.array(file.evaluate(entry.get("at", content["at"]), own))
                y = np.array([file.evaluate(entry["each"], {**own, "x": each}) for each in x.tolist()])
            plot.curve(
                file.fill(entry["name"], own),
                x / unit,
                y / scale,
                _colour(style["colour"]),
                dash=None if style.get("dash") == "none" else style.get("dash", "solid"),
                marker=style.get("marker"),
                size=float(style.get("size", 6.0)),
            )
    for draw, amount in ((plot.vertical, unit), (plot.horizontal, scale)):
        for line in content.get(draw.__name__, []):
            draw(line["name"], file.evaluate(line["value"], columns) / amount)
    if "zero" in content:
        plot.zero()
    return plot


def _colour(name: str) -> str:
    colour: str = getattr(figure_style, name.upper().replace(" ", "_"))
    return colour
