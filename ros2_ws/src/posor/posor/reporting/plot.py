# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Interactive plots of report pages: zoom, values under the pointer, download of the data. BokehJS is in the page."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np
from bokeh.document import Document
from bokeh.embed import components
from bokeh.models import ColumnDataSource, HoverTool, PrintfTickFormatter
from bokeh.plotting import figure
from bokeh.resources import Resources
from bokeh.themes import Theme

from posor.reporting.figure_style import GREY

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike

FRAME_HEIGHT = 250  # height of a plot without title, axis and legend [pixels]
LEGEND_WIDTH = 48  # letters of the two longest names of a legend with two columns
_STYLE = Theme(filename=str(Path(__file__).with_name("plot_theme.yaml")))


class Plot:
    """A plot and its data."""

    def __init__(
        self,
        title: str,
        x_label: str,
        y_label: str,
        *,
        x_of: Plot | None = None,
        categories: Sequence[str] = (),
        x_log: bool = False,
        y_log: bool = False,
    ) -> None:
        """Create an empty plot.

        ``x_label``: label of the x axis, with its unit. ``y_label``: label of the y axis, with its unit. ``x_of``: plot
        whose x range is this one's too: both zoom together. ``categories``: names along the y axis, from top to bottom;
        empty: y is a number. ``x_log``: whether the x axis is logarithmic. ``y_log``: whether the y axis is
        logarithmic.
        """
        self.title = title
        self.note = ""  # sentence beside the title, such as why a curve leaves its band
        self._header = (x_label, y_label)
        self._rows: list[dict[str, str]] = []
        ranges: dict[str, Any] = {"x_range": x_of.figure.x_range} if x_of else {}
        if categories:
            ranges["y_range"] = list(reversed(categories))
        # the Bokeh figure, for what this class has no method
        self.figure: figure = figure(
            x_axis_label=x_label,
            y_axis_label="" if categories else y_label,
            x_axis_type="log" if x_log else "linear",
            y_axis_type="log" if y_log else "auto" if categories else "linear",
            frame_height=max(FRAME_HEIGHT, 22 * len(categories)),
            sizing_mode="stretch_width",
            tools="pan,box_zoom,wheel_zoom,reset,save",
            active_drag="box_zoom",
            **ranges,
        )
        for axis, is_log in ((self.figure.xaxis[0], x_log), (self.figure.yaxis[0], y_log)):
            if is_log:
                axis.formatter = PrintfTickFormatter(format="%g")

    def curve(
        self,
        name: str,
        x: ArrayLike,
        y: ArrayLike | Sequence[str],
        colour: str,
        *,
        dash: str | None = "solid",
        marker: str | None = None,
        size: float = 6.0,
        filled: bool = True,
        extra: Mapping[str, Sequence[Any] | ArrayLike] | None = None,
    ) -> None:
        """Draw a series as a line, as points, or both.

        ``name``: name in legend and data. ``x``: values, (n,). ``y``: values or categories, (n,). ``dash``: dash
        pattern of the line; None: no line. ``marker``: marker of the points; None: no points. ``size``: size of the
        points [pixels]. ``filled``: whether the points are filled. ``extra``: further columns of the data by their
        labels with units, shown under the pointer, each (n,).
        """
        source = self._source(name, x, y, extra or {})
        drawn: list[Any] = []
        if dash is not None:
            drawn.append(
                self.figure.line(
                    "x", "y", source=source, name=name, legend_label=name, color=colour, line_dash=dash, line_width=1.5
                )
            )
        if marker is not None:
            fill = colour if filled else "white"
            drawn.append(
                self.figure.scatter(
                    "x",
                    "y",
                    source=source,
                    name=name,
                    legend_label=name,
                    marker=marker,
                    size=size,
                    line_color=colour,
                    line_width=1.4,
                    fill_color=fill,
                    alpha=0.85,
                )
            )
        self._show_values(drawn[-1], extra or {})

    def bars(self, name: str, lengths: ArrayLike, categories: Sequence[str], colour: str) -> None:
        """Draw a bar from 0 for each category."""
        source = self._source(name, lengths, categories, {})
        drawn = self.figure.hbar(
            y="y", right="x", left=0.0, height=0.7, source=source, name=name, legend_label=name, color=colour
        )
        self._show_values(drawn, {})

    def histogram(self, name: str, edges: ArrayLike, heights: ArrayLike, colour: str) -> None:
        """Draw a histogram; ``edges``: (n + 1,), ``heights``: (n,)."""
        low, high = np.asarray(edges)[:-1], np.asarray(edges)[1:]
        extra = {f"end of bin, {self._header[0]}": high}
        source = self._source(name, low, heights, extra)
        source.data["high"] = high
        drawn = self.figure.quad(
            left="x",
            right="high",
            bottom=0.0,
            top="y",
            source=source,
            name=name,
            legend_label=name,
            fill_color=colour,
            fill_alpha=0.55,
            line_color="white",
        )
        self._show_values(drawn, extra)

    def band(self, name: str, x: ArrayLike, low: ArrayLike, high: ArrayLike, colour: str) -> None:
        """Fill the area between two lines; its data belong to a curve (``extra``), all (n,)."""
        source = ColumnDataSource({"x": _floats(x), "low": _floats(low), "high": _floats(high)})
        self.figure.varea(
            "x", "low", "high", source=source, color=colour, alpha=0.3, legend_label=name, level="underlay"
        )

    def intervals(self, name: str, low: ArrayLike, high: ArrayLike, categories: Sequence[str], colour: str) -> None:
        """Draw a thick line from low to high for each category; its data belong to a curve, as those of ``band``."""
        x0, x1, names = _floats(low), _floats(high), list(categories)
        self.figure.segment(x0, names, x1, names, line_color=colour, line_width=4, legend_label=name)

    def mark(self, name: str, x: ArrayLike, y: ArrayLike, colour: str) -> None:
        """Draw a ring around points of a curve."""
        self.figure.scatter(_floats(x), _floats(y), size=12, line_color=colour, fill_color=None, legend_label=name)

    def strips(self, name: str, x: Sequence[float], half_width: float) -> None:
        """Shade vertical strips around values of x."""
        low, high = [value - half_width for value in x], [value + half_width for value in x]
        self.figure.vstrip(x0=low, x1=high, fill_color="#dddddd", line_color=None, legend_label=name, level="underlay")

    def vertical(self, name: str, x: float, colour: str = GREY, dash: str = "dashed") -> None:
        """Draw a vertical line over the whole plot."""
        self.figure.vspan(x=[x], line_color=colour, line_dash=dash, line_width=1.3, legend_label=name)

    def horizontal(self, name: str, y: float, colour: str = GREY, dash: str = "dashed") -> None:
        """Draw a horizontal line over the whole plot."""
        self.figure.hspan(y=[y], line_color=colour, line_dash=dash, line_width=1.3, legend_label=name)

    def zero(self) -> None:
        """Draw a thin line at y = 0, without an entry in the legend."""
        self.figure.hspan(y=[0.0], line_color="#999999", line_width=1.0)

    @property
    def file_name(self) -> str:
        """Name for the downloaded data."""
        return re.sub(r"\W+", "_", self.title).strip("_") + ".csv"

    @property
    def csv(self) -> str:
        """The data as CSV: a row for each point."""
        text = io.StringIO()
        columns = list(dict.fromkeys(key for row in self._rows for key in row))
        writer = csv.DictWriter(text, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(self._rows)
        return text.getvalue()

    @property
    def csv_link(self) -> str:
        """The data as the address of a link."""
        return "data:text/csv;charset=utf-8," + quote(self.csv, safe=",-+:;=[]()/")

    def finish(self) -> figure:
        """Return the figure with its legend below the plot, if there are several entries."""
        for legend in self.figure.legend:
            if len(legend.items) > 1:
                self.figure.add_layout(legend, "below")
                items: Any = legend.items
                longest = sorted(len(item.label.value) for item in items)[-2:]
                legend.ncols = 2 if sum(longest) <= LEGEND_WIDTH else 1
            else:
                legend.visible = False
        return self.figure

    def _source(
        self, name: str, x: ArrayLike, y: ArrayLike | Sequence[str], extra: Mapping[str, Sequence[Any] | ArrayLike]
    ) -> ColumnDataSource:
        """Return the data of a series and add it to the CSV."""
        columns: dict[str, Any] = {"x": _floats(x), "y": _floats(y), **{key: _floats(extra[key]) for key in extra}}
        labels = ("series", *self._header, *extra)
        cells = zip(*(map(_as_text, column) for column in columns.values()), strict=True)
        self._rows += [dict(zip(labels, (name, *row), strict=True)) for row in cells]
        return ColumnDataSource(columns)

    def _show_values(self, drawn: Any, extra: Mapping[str, object]) -> None:
        """Show the values of a series under the pointer, with their units."""
        labels = {"x": self._header[0], "y": self._header[1], **dict.fromkeys(extra)}
        columns = drawn.data_source.data
        numeric = [key for key in labels if isinstance(columns[key], np.ndarray)]
        values = [(label or key, f"@{{{key}}}" + ("{%.4g}" if key in numeric else "")) for key, label in labels.items()]
        self.figure.add_tools(
            HoverTool(
                renderers=[drawn],
                tooltips=[("", "$name"), *values],
                formatters={f"@{{{key}}}": "printf" for key in numeric},
                visible=False,
            )
        )


def bokeh_script() -> str:
    """Return the script elements of BokehJS, for the head of a page."""
    return str(Resources(mode="inline", components=["bokeh"]).render())


def embed_plots(plots: Sequence[Plot]) -> tuple[str, dict[Plot, str]]:
    """Return the script element that draws the plots, and the element of each plot, as HTML."""
    figures, document = [plot.finish() for plot in plots], Document()
    with document.models.freeze():  # else Bokeh visits all figures again for each that is added
        for figure in figures:
            document.add_root(figure)
    script, elements = components(figures, theme=_STYLE)
    return script, dict(zip(plots, elements, strict=True))


def _floats(values: Any) -> Any:
    """Return numbers as an array of single precision, which a page stores in half the space; other values as a list."""
    array = np.asarray(values)
    return array.astype(np.float32) if array.dtype.kind in "fiu" else list(values)


def _as_text(value: object) -> str:
    """Return a cell of the CSV; NaN, a missing value, is empty."""
    if isinstance(value, np.floating):
        return "" if np.isnan(value) else f"{value:.7g}"
    return str(value)
