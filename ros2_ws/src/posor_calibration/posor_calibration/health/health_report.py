# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Verdict, advice and page of an arm's health: control chart, and how each part has changed, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.reporting.figure_style import BLUE, GREEN, GREY, LIGHT_BLUE, ORANGE
from posor.reporting.html_page import Section, paragraph, render_page, table
from posor.reporting.json_text import json_text
from posor.reporting.plot import Plot
from scipy.special import stdtr

from posor_calibration.health.health_test import date_text

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

    from posor_calibration.health.health_chart import HealthChart

MONTH_NS = 365.25 / 12.0 * 86400e9
FAR_MONTHS = 240.0  # beyond which a creep is not extrapolated
LEAST_TESTS = 4  # after the reference, from which a step and a creep are distinguished
CHANCE = 1e-4  # probability below which the creep of any part is no chance, and is extrapolated
COLOURS = (ORANGE, BLUE, GREEN, LIGHT_BLUE, GREY)
MICRO = 1e6


class Change(NamedTuple):
    """How a part has changed along the axis where the change is the clearest."""

    part: str
    axis: str  # empty: a reading
    unit: str
    drift: float  # by the last test, from the reference tests
    sigma: float  # its standard uncertainty; the arm may be anywhere within its stated uncertainties
    stated: float  # standard uncertainty that the files state; NaN: none
    kind: str  # "step", "creep", or empty: not distinguished
    since_ns: int  # a step: the first test after it; a creep: its begin
    rate: float  # [unit / month] of a creep since its begin
    rate_sigma: float
    chance: float  # probability that noise looks like a creep as clear; 1: no creep

    def describe(self) -> str:
        """Return the change in words."""
        scale = f"{MICRO * self.drift:+.2f} µ{self.unit}{f' {self.axis}' if self.axis else ''}"
        text = f"{scale} (standard uncertainty {MICRO * self.sigma:.2f} µ{self.unit})"
        if self.kind == "creep":
            rate = f"{MICRO * self.rate:+.2f} ± {2.0 * MICRO * self.rate_sigma:.2f} µ{self.unit}"
            return f"{text}, a creep of {rate} a month since {date_text(self.since_ns)}"
        return text + (f", a step before {date_text(self.since_ns)}" if self.kind else "")


def change_of(chart: HealthChart, part: int) -> Change:
    """Return how a part of the chart has changed; a step or a creep is the one that leaves the smaller residuals."""
    own, sigmas = chart.parts[part], chart.sigmas[part][-1]
    axis = int(np.argmax(np.abs(chart.drifts[part][-1]) / sigmas))
    values = chart.drifts[part][:, axis]
    stamps = chart.stamps_ns[chart.reference :]
    months = (stamps - chart.stamps_ns[chart.reference - 1]) / MONTH_NS
    kind, since_ns, rate, rate_sigma, chance = "", int(stamps[0]), 0.0, float("inf"), 1.0
    if len(values) >= LEAST_TESTS:
        begins = np.concatenate([[0.0], months[:-2]])
        creeps = [(_misfit(np.maximum(months - begin, 0.0), values), begin) for begin in begins]
        steps = [(_misfit((months >= month).astype(float), values), n) for n, month in enumerate(months)]
        creep, step = min(creeps), min(steps)
        kind, since_ns = ("creep", 0) if creep[0] < step[0] else ("step", int(stamps[step[1]]))
        if kind == "creep":
            ramp = np.maximum(months - creep[1], 0.0)
            rate = float(ramp @ values / (ramp @ ramp))
            rate_sigma = float(np.sqrt(creep[0] / (len(values) - 2) / (ramp @ ramp)))
            chance = min(1.0, 2.0 * len(begins) * float(stdtr(len(values) - 2, -abs(rate) / rate_sigma)))
            since_ns = int(chart.stamps_ns[chart.reference - 1] + creep[1] * MONTH_NS)
    drift, sigma, stated = float(values[-1]), float(sigmas[axis]), float(own.stated[axis])
    return Change(
        own.name, own.axes[axis], own.units[axis], drift, sigma, stated, kind, since_ns, rate, rate_sigma, chance
    )


def _misfit(shape: FloatArray, values: FloatArray) -> float:
    """Return the sum of squares that a multiple of a shape leaves of values."""
    left = values - shape * (shape @ values) / (shape @ shape)
    return float(left @ left)


@dataclass(frozen=True)
class HealthReport:
    """Result of all tests of an arm."""

    arm: str
    chart: HealthChart

    @cached_property
    def changes(self) -> list[Change]:
        """How each part has changed, as if it alone had, the clearest first."""
        order = np.argsort(-self.chart.ratios[-1], kind="stable")
        return [change_of(self.chart, int(p)) for p in order]

    @property
    def suspects(self) -> list[Change]:
        """The parts that explain the last test, the likeliest first; empty: no alarm."""
        return [change_of(self.chart, p) for p in self.chart.suspects]

    @property
    def sentence(self) -> str:
        """The verdict."""
        tests = len(self.chart.ratios)
        since = date_text(int(self.chart.stamps_ns[0]))
        if not self.chart.suspects:
            past = f", {len(self.chart.alarms)} earlier ones gave an alarm" if self.chart.alarms.size else ""
            return (
                f"{self.arm} is sound: the last of {tests} tests since the reference of {since} shows no change{past}."
            )
        first, *others = self.suspects
        also = f" ({', '.join(each.part for each in others)} would explain it as well)" if others else ""
        return f"{self.arm} has changed: {first.part}{also}, {first.describe()}."

    @property
    def advice(self) -> str:
        """What to do, and when."""
        if self.chart.suspects:
            return f"{self.chart.parts[self.chart.suspects[0]].remedy}."
        limit = CHANCE / len(self.changes)
        first = next((each for each in self.changes if each.chance < limit), None)
        if first is None:
            return "no creep is seen: no calibration is due before the next test."
        months = max(0.0, (2.0 * first.sigma - abs(first.drift)) / abs(first.rate))  # until the drift is its U
        if months > FAR_MONTHS:
            return f"no calibration is due in the next {FAR_MONTHS / 12.0:g} years: {first.part}, {first.describe()}."
        date = date_text(int(self.chart.stamps_ns[-1] + months * MONTH_NS))
        return f"calibrate before {date}: {first.part} then leaves its stated uncertainty, {first.describe()}."

    def to_json(self) -> str:
        """Return all results as JSON."""
        content = {
            "arm": self.arm,
            "sound": not self.chart.suspects,
            "verdict": self.sentence,
            "advice": self.advice,
            "suspects": [each.part for each in self.suspects],
            "changes": [each._asdict() for each in self.changes],
        }
        return json_text(content, indent=1)

    def to_page(self) -> str:
        """Return all results as a page."""
        chart, stamps = self.chart, self.chart.stamps_ns
        months = (stamps[chart.reference :] - stamps[0]) / MONTH_NS
        shown = [int(p) for p in np.argsort(-chart.ratios.max(axis=0), kind="stable")[: len(COLOURS)]]
        control = Plot("control chart", "months since the first test", "statistic over its limit", y_log=True)
        for colour, p in zip(COLOURS, shown, strict=False):
            control.curve(chart.parts[p].name, months, np.maximum(chart.ratios[:, p], 1e-3), colour, marker="circle")
        control.horizontal("alarm", 1.0, dash="solid")
        first = (chart.suspects or shown)[0]
        change = change_of(chart, first)
        axis = chart.parts[first].axes.index(change.axis)
        drift = Plot(f"{change.part} {change.axis}".strip(), "months since the first test", f"change [µ{change.unit}]")
        values = MICRO * chart.drifts[first][:, axis]
        spread = np.full(len(values), 2.0 * MICRO * change.sigma)
        drift.band("sound, k = 2", months, -spread, spread, LIGHT_BLUE)
        drift.curve(change.part, months, values, BLUE, marker="circle")
        drift.zero()
        rows = [
            (
                each.part,
                each.axis,
                f"{MICRO * each.drift:.3f}",
                f"{MICRO * each.sigma:.3f}",
                "" if np.isnan(each.stated) else f"{MICRO * each.stated:.3f}",
                f"µ{each.unit}",
                each.kind,
                f"{MICRO * each.rate:.3f}" if each.kind == "creep" else "",
            )
            for each in self.changes
        ]
        header = ("part", "axis", "change", "u(change)", "stated u", "unit", "kind", "per month")
        text = "Each part as if it alone had changed since the reference tests, the clearest first."
        sections = [
            Section("Advice", paragraph(self.advice[:1].upper() + self.advice[1:])),
            Section("Control chart", paragraph(f"{len(months)} tests; above 1: alarm."), [control, drift]),
            Section("Changes", paragraph(text) + table(header, rows)),
        ]
        title = f"Health of {self.arm}, {date_text(int(stamps[-1]))}"
        return render_page(title, self.sentence, holds=not chart.suspects, sections=sections)
