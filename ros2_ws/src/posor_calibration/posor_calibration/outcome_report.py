# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The outcome of a procedure for people: a verdict of a few lines, a page with everything, the same numbers as JSON."""

from __future__ import annotations

import textwrap
from dataclasses import asdict, dataclass
from itertools import cycle
from typing import TYPE_CHECKING

from markupsafe import Markup
from posor.reporting.figure_style import BLUE, GREEN, GREY, LIGHT_BLUE, ORANGE
from posor.reporting.html_page import Section, bullet_list, paragraph, render_page, table
from posor.reporting.json_text import json_text

from posor_calibration.least_squares import WEAK
from posor_calibration.outcome_tables import WIDTH, format_cell, name_columns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.reporting.plot import Plot

    from posor_calibration.calibration_comparison import Comparison
    from posor_calibration.least_squares import Fit
    from posor_calibration.procedure import Figure, Outcome

MAX_LINES = 15  # lines of a verdict on a terminal of ``WIDTH`` columns, with the names of the written files
NAMED = 3
COLOURS = (BLUE, ORANGE, GREEN, LIGHT_BLUE, GREY)


@dataclass(frozen=True)
class ProcedureVerdict:
    """Summary of an outcome for a user."""

    holds: bool  # whether the residuals agree with the stated uncertainties
    headline: str
    findings: tuple[str, ...]  # one sentence each
    notes: tuple[str, ...]  # warnings of the procedure

    def lines(self, ending: Sequence[str], elsewhere: str) -> list[str]:
        """Return at most ``MAX_LINES`` lines, ``ending`` last; ``elsewhere`` tells where the notes are in full."""
        lines, end = _wrap([self.headline, *self.findings]), _wrap(ending)
        shown = self.notes[: max(0, MAX_LINES - 1 - len(lines) - len(end))]
        lines += [textwrap.shorten(f"Note: {note}", WIDTH, placeholder=" ...") for note in shown]
        summary = f"Notes: {len(shown)} of {len(self.notes)}, shortened; in full {elsewhere}"
        return [*lines, *([summary] if self.notes else []), *end]


def _wrap(sentences: Sequence[str]) -> list[str]:
    wrapper = textwrap.TextWrapper(WIDTH, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
    return [line for sentence in sentences for line in wrapper.wrap(sentence)]  # paths stay whole


def judge_outcome(name: str, outcome: Outcome, changes: Comparison | None) -> ProcedureVerdict:
    """Return the verdict on the outcome of the procedure ``name``; ``changes``: of the calibration file, if any."""
    what, worst = max(outcome.fits.items(), key=lambda item: item[1].spread)
    holds = not any(fit.is_too_large for fit in outcome.fits.values())
    usable = "usable" if holds else "usable with care: the residuals exceed the stated uncertainties"
    outliers = sum(map(_count_outliers, outcome.fits.values()))
    readings = sum(len(fit.residuals) for fit in outcome.fits.values())
    several = f" ({what}, the worst of {len(outcome.fits)} fits)" if len(outcome.fits) > 1 else ""
    residuals = (
        f"Residuals: {worst.spread:.3g} times the stated uncertainties{several}, probability {worst.probability:.2g}; "
        f"{outliers} of {readings} readings are outliers."
    )
    of_file = _describe_changes(changes) if changes else ["The calibration file is not changed."]
    if any(test.is_found for test in outcome.drifts):
        holds, usable = False, "usable with care: a reference drifts"
    findings = (residuals, *_describe_drifts(outcome), *of_file)
    return ProcedureVerdict(holds, f"{name}: {usable}.", findings, outcome.warnings)


def _describe_drifts(outcome: Outcome) -> list[str]:
    """Return a sentence on the drift of each reference."""
    sentences = []
    for topic in dict.fromkeys(test.topic for test in outcome.drifts):
        tests = [test for test in outcome.drifts if test.topic == topic]
        tested = sorted((t for t in tests if t.is_tested), key=lambda test: -abs(test.drift) / test.sigma)
        missing = [test.quantity for test in tests if not test.is_tested]
        if tested:
            found = "; more than its uncertainty" if tested[0].is_found else ""
            sentences.append(f"Drift of {topic} over the recording: {tested[0].text}{found}.")
        if missing:
            which = ", ".join(filter(None, (topic, *missing)))
            sentences.append(
                f"Drift of the reference is not tested ({which}): return to the start, more often or for longer."
            )
    return sentences


def _count_outliers(fit: Fit) -> int:
    return int(fit.outliers().sum())


def _describe_changes(changes: Comparison) -> list[str]:
    """Return sentences on the changed numbers: the worst determined, those not determined, the repeatability."""
    known = [number for number in changes.differences if number.first_sigma > 0.0]
    remaining = {number: number.second_sigma / number.first_sigma for number in known}
    others = f", and {len(changes.others)} other entries" if changes.others else ""
    sentences = [f"Changed: {len(changes.differences)} numbers of the file{others}."]
    if known:
        worst, largest = max(known, key=remaining.__getitem__), max(known, key=lambda number: abs(number.sigmas))
        weak = sorted((n for n in known if remaining[n] > WEAK), key=remaining.__getitem__, reverse=True)
        named = ", ".join(number.name for number in weak[:NAMED])
        such = f": {named}{', and others' if len(weak) > NAMED else ''}" if weak else ""
        determined = (
            f"Worst determined: {worst.name} = {worst.second:.6g} +- {worst.second_sigma:.2g} {worst.unit}; "
            f"{remaining[worst]:.3g} times its former uncertainty."
        )
        weakest = f"more than {WEAK:g} times the former uncertainty"
        sentences += [
            determined,
            f"Not determined ({weakest}): {len(weak)} of {len(known)}{such}.",
            f"Largest change: {largest.name} by {largest.sigmas:+.1f} former standard uncertainties.",
        ]
    noises = [number for number in changes.differences if number.name.endswith(".noise")]
    if noises:
        noise = max(noises, key=lambda number: number.second)
        sentences.append(f"Repeatability of one scan: {noise.second:.3g} {noise.unit} at worst ({noise.name}).")
    else:
        sentences.append("Repeatability: not measured by this procedure; gap_repeatability measures it.")
    return sentences


def render_outcome_page(title: str, verdict: ProcedureVerdict, outcome: Outcome) -> str:
    """Return the page with verdict, fits, notes, charts and all tables."""
    header = (
        "fit",
        "readings",
        "parameters",
        "freedoms",
        "root of chi-square over freedoms",
        "probability",
        "outliers",
    )
    rows = [
        (
            what,
            *map(str, (len(fit.residuals), len(fit.names), fit.freedoms)),
            *(f"{number:.3g}" for number in (fit.spread, fit.probability)),
            str(_count_outliers(fit)),
        )
        for what, fit in outcome.fits.items()
    ]
    tables = [
        Section(each.title, table(name_columns(each), [list(map(format_cell, row)) for row in each.rows]))
        for each in outcome.tables
    ]
    notes = [Section("Notes", bullet_list(verdict.notes))] if verdict.notes else []
    sections = [
        Section("Verdict", bullet_list(verdict.findings)),
        *notes,
        *([Section("Charts", Markup(""), [_plot(each) for each in outcome.figures])] if outcome.figures else []),
        Section("Fits", paragraph(f"Method: {outcome.method}.") + table(header, rows)),
        *tables,
    ]
    return render_page(title, verdict.headline, holds=verdict.holds, sections=sections)


def _plot(chart: Figure) -> Plot:
    from posor.reporting.plot import Plot  # noqa: PLC0415  takes a second to load

    plot = Plot(chart.title, chart.x_label, chart.y_label)
    for (name, (x, y)), colour in zip(chart.series.items(), cycle(COLOURS), strict=False):
        plot.curve(name, x, y, colour, dash=None, marker="circle")
    return plot


def outcome_json(name: str, verdict: ProcedureVerdict, outcome: Outcome) -> str:
    """Return the numbers of the page as JSON; a number that is not finite is null."""
    content = {
        "procedure": name,
        "holds": verdict.holds,
        "verdict": [verdict.headline, *verdict.findings],
        "notes": verdict.notes,
        "method": outcome.method,
        "fits": {
            what: {
                "parameters": list(fit.names),
                "units": list(fit.units),
                "values": fit.values.tolist(),
                "sigmas": fit.sigmas.tolist(),
                "residuals_over_sigma": fit.residuals.tolist(),
                "freedoms": fit.freedoms,
                "spread": fit.spread,
                "probability": fit.probability,
                "outliers": _count_outliers(fit),
            }
            for what, fit in outcome.fits.items()
        },
        "tables": [asdict(each) for each in outcome.tables],
        "drifts": [asdict(each) for each in outcome.drifts],
        "figures": [
            {
                "title": each.title,
                "x": each.x_label,
                "y": each.y_label,
                "series": {label: {"x": x.tolist(), "y": y.tolist()} for label, (x, y) in each.series.items()},
            }
            for each in outcome.figures
        ],
    }
    return json_text(content, indent=1)
