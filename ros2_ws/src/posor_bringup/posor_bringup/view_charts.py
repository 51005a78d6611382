# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Charts of the live page as one picture (SVG): all have the same time axis in UTC.

Browsers show the picture as it is, so that neither the time zone of a browser nor its language changes the axis.
"""

from __future__ import annotations

import colorsys
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor_bringup.view_events import utc

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from posor.numerics.array_types import BoolArray, FloatArray

    from posor_bringup.view_history import Points

WIDTH, LEFT, RIGHT = 480, 44, 6  # of the picture and its margins
HEADING, STRIP, AXIS = 17, 12, 34  # heights of the heading of a chart, of the strip of states, of the time axis
FONT = "font-family:system-ui,sans-serif;font-size:11px"
HALO = "paint-order:stroke;stroke:#fff;stroke-width:3px"
INK, GRID, MARK = "#333333", "#dddddd", "#d62728"
TIME_STEPS_S = (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400)
TICKS = 6  # at most, of an axis of time; half as many of an axis of values
NO_GAP = 3.5  # widths of a point, up to which neighbours are joined by a line
FORMER = 0.3  # opacity of the points of former runs


NO_BAND = -1  # instead of a column


class Series(NamedTuple):
    """One curve."""

    label: str
    colour: str
    column: int  # of its quantity in the points
    two_sigma: int = NO_BAND  # column of the half-width of its band


class Chart(NamedTuple):
    """One chart."""

    title: str
    series: Sequence[Series]
    height: int  # without its heading
    limit: float | None = None  # largest value that is accepted, drawn as a line


class Axis(NamedTuple):
    """The axis of time."""

    begin_s: float  # UTC [s]
    end_s: float
    cursor_s: float | None = None  # position in a recording

    def x(self, time_s: FloatArray) -> FloatArray:
        """Return the place of times in the picture."""
        return LEFT + (WIDTH - LEFT - RIGHT) * (time_s - self.begin_s) / (self.end_s - self.begin_s)


def distinct_colours(count: int) -> list[str]:
    """Return colours of curves in one chart, each of another hue."""
    parts = (colorsys.hls_to_rgb(number / max(count, 3), 0.4, 0.75) for number in range(count))
    return ["#" + "".join(f"{round(255 * part):02x}" for part in each) for each in parts]


def draw_charts(
    points: Points, axis: Axis, charts: Sequence[Chart], states: int, colours: Mapping[int, str], run: int
) -> str:
    """Return the picture.

    Args:
        points: Of the window; quantities as the series name them.
        axis: Of time.
        charts: From top to bottom.
        states: Column of the severity of the state, whose largest values colour a strip.
        colours: Colour of each severity.
        run: The present run; the points of others are pale.

    """
    height = STRIP + sum(HEADING + chart.height for chart in charts) + AXIS
    parts = [f'<svg id="charts" viewBox="0 0 {WIDTH} {height}" style="width:calc(100% - 14px);{FONT}">']
    shown = (points.times_s >= axis.begin_s - points.width_s) & (points.times_s <= axis.end_s + points.width_s)
    points = points._replace(**{name: getattr(points, name)[shown] for name in ("times_s", "low", "high", "runs")})
    x = np.clip(axis.x(points.times_s), LEFT, WIDTH - RIGHT)
    parts += _strip(x, points, axis, states, colours)
    top = STRIP
    for chart in charts:
        parts += _chart(chart, top + HEADING, x, points, run)
        top += HEADING + chart.height
    parts += _time_axis(axis, height)
    starts = x[1:][np.diff(points.runs) > 0]
    parts += [_line(at, STRIP, at, height - AXIS, INK, "4 3") for at in starts]
    if axis.cursor_s is not None:
        at = float(axis.x(np.array(axis.cursor_s)))
        parts.append(_line(at, 0, at, height - AXIS, MARK, ""))
    return "".join([*parts, "</svg>"])


def _strip(x: FloatArray, points: Points, axis: Axis, states: int, colours: Mapping[int, str]) -> Iterator[str]:
    """Yield a coloured bar for each stretch of equal states."""
    yield f'<text x="{LEFT - 4}" y="{STRIP - 2}" text-anchor="end" fill="{INK}">state</text>'
    severities = points.high[:, states]
    half = 0.5 * points.width_s / (axis.end_s - axis.begin_s) * (WIDTH - LEFT - RIGHT)
    joined = np.diff(points.times_s) < NO_GAP * points.width_s
    for begin, end in _stretches(joined & (np.diff(severities) == 0.0), len(x)):
        if np.isfinite(severities[begin]):
            first, last = max(LEFT, x[begin] - half), min(WIDTH - RIGHT, x[end - 1] + half)
            if end < len(x) and joined[end - 1]:
                last = x[end] - half
            colour = colours[int(severities[begin])]
            yield f'<rect x="{first:.1f}" y="1" width="{last - first:.1f}" height="{STRIP - 3}" fill="{colour}"/>'


def _stretches(joined: BoolArray, count: int) -> Iterator[tuple[int, int]]:
    """Yield begin and end of each stretch of joined neighbours among some points."""
    yield from pairwise([0, *(np.flatnonzero(~joined) + 1).tolist(), count] if count else [])


def _chart(chart: Chart, top: int, x: FloatArray, points: Points, run: int) -> Iterator[str]:
    bands = [
        (points.low[:, each.column] - band, points.high[:, each.column] + band)
        for each in chart.series
        for band in [np.nan_to_num(points.high[:, each.two_sigma]) if each.two_sigma != NO_BAND else np.zeros(len(x))]
    ]
    ticks, low, high = _value_ticks([value for band in bands for value in band], chart.limit)

    def y(values: FloatArray) -> FloatArray:
        return top + chart.height * (high - values) / (high - low)

    labels = "&#160; ".join(f'<tspan fill="{each.colour}">{each.label}</tspan>' for each in chart.series)
    heading = [f'<text x="{LEFT}" y="{top - 5}" fill="{INK}" style="font-weight:600;{HALO}">{chart.title}</text>']
    if len(chart.series) > 1:
        heading.append(f'<text x="{WIDTH - RIGHT}" y="{top - 5}" text-anchor="end" style="{HALO}">{labels}</text>')
    for tick in ticks:
        at = float(y(np.array(tick)))
        yield _line(LEFT, at, WIDTH - RIGHT, at, GRID, "")
        yield f'<text class="value" x="{LEFT - 4}" y="{at + 4:.1f}" text-anchor="end" fill="{INK}">{tick:g}</text>'
    if chart.limit is not None:
        at = float(y(np.array(chart.limit)))
        yield _line(LEFT, at, WIDTH - RIGHT, at, MARK, "6 3")
    is_joined = (np.diff(points.times_s) < NO_GAP * points.width_s) & (np.diff(points.runs) == 0)
    for each, (lower, upper) in zip(chart.series, bands, strict=True):
        known = np.isfinite(lower) & np.isfinite(upper)
        joined = is_joined & known[:-1] & known[1:]
        for begin, end in _stretches(joined, len(x)):
            if not known[begin]:
                continue
            part = slice(begin, end)
            pale = f' opacity="{FORMER}"' if points.runs[begin] != run else ""
            if each.two_sigma != NO_BAND:
                outline = _outline(x[part], y(lower[part]), y(upper[part]))
                yield f'<path class="band" d="{outline}" fill="{each.colour}" fill-opacity="0.18"{pale}/>'
            outline = _outline(x[part], y(points.low[part, each.column]), y(points.high[part, each.column]))
            look = f'fill="{each.colour}" stroke="{each.colour}" fill-opacity="0.4" stroke-width="1.2"'
            yield f'<path class="curve" d="{outline}" {look} stroke-linejoin="round" stroke-linecap="round"{pale}/>'
    yield from heading


def _outline(x: FloatArray, low: FloatArray, high: FloatArray) -> str:
    """Return the path along the upper values and back along the lower ones."""
    corners = [*zip(x.tolist(), high.tolist(), strict=True), *zip(x[::-1].tolist(), low[::-1].tolist(), strict=True)]
    return "M" + "L".join(f"{across:.1f},{down:.1f}" for across, down in corners) + "Z"


def _value_ticks(values: Sequence[FloatArray], limit: float | None) -> tuple[list[float], float, float]:
    """Return the ticks and both ends of an axis of values."""
    known = np.concatenate([np.zeros(0) if limit is None else np.array([0.0, limit]), *values])
    known = known[np.isfinite(known)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    margin = 0.06 * (high - low) or max(abs(high), 1.0) * 0.5
    low, high = low - margin, high + margin
    rough = (high - low) / (TICKS // 2)
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * next(each for each in (1.0, 2.0, 5.0, 10.0) if each * power >= rough)
    ticks = np.arange(np.ceil(low / step), np.floor(high / step) + 1.0) * step
    return [float(f"{tick:.12g}") + 0.0 for tick in ticks], low, high


def _time_axis(axis: Axis, height: int) -> Iterator[str]:
    length = axis.end_s - axis.begin_s
    step = next((each for each in TIME_STEPS_S if length / each <= TICKS), TIME_STEPS_S[-1])
    first = int(np.ceil(axis.begin_s / step)) * step
    bottom = height - AXIS
    for time_s in range(first, int(axis.end_s) + 1, step):
        at = float(axis.x(np.array(float(time_s))))
        text = utc(time_s * 10**9, "%H:%M" if step % 60 == 0 else "%H:%M:%S")
        yield _line(at, STRIP, at, bottom, GRID, "")
        yield f'<text class="tick" x="{at:.1f}" y="{bottom + 16}" text-anchor="middle" fill="{INK}">{text}</text>'
    date = utc(int(axis.end_s * 1e9), "%Y-%m-%d UTC")
    yield f'<text id="date" x="{WIDTH - RIGHT}" y="{bottom + 29}" text-anchor="end" fill="{INK}">{date}</text>'


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, dashes: str) -> str:
    dash = f' stroke-dasharray="{dashes}"' if dashes else ""
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{colour}"{dash}/>'
