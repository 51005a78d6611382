"""Tells calibration campaigns as a page, and in numbers for other programs."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np
from posor_estimator.core.budget.first_order import Kind

from posor_bringup.campaign.determined import determined
from posor_bringup.campaign.fresh import FREEDOMS
from posor_bringup.campaign.told import holds
from posor_bringup.document import (
    Picture,
    Section,
    cells,
    document,
    findings_table,
    image,
    notes_list,
    table,
    terms_list,
)
from posor_bringup.findings import Findings

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_estimator.core.calibration.fit_record import Instrument

    from posor_bringup.campaign.many import Coverage, Family
    from posor_bringup.campaign.told import Told

HEADINGS: Mapping[str, str] = {"computed": "found", "stated": "expected", "limit": "must be", "source": "source"}
INSTEAD: Mapping[str, str] = {
    "residuals": "residuals of the fits",
    "budget": "error budget in the middle of the range",
    "truth": "numbers, errors at fresh poses and coverage against the truth",
}
"""What to say of each picture where it cannot be shown."""
AS_BUILT = "as built, not measured"
ITSELF = "no reference"
MEASURED = (
    "A number is measured by the step that lowered its standard uncertainty most; later steps state it again. Where "
    "that is still 95 % or more of the one as built, nothing has measured it. Method, bag and the instruments' "
    "uncertainties stand below, with the fits."
)
SPREAD = (
    "Spread: root of chi-square over the degrees of freedom, 1 where the stated uncertainties of the readings are "
    "right. Probability: that of a chi-square at least as large, if they are."
)
NOTES = (
    (
        "Simulated: each POSOR is drawn from what is known of it as built, so the truth behind every number is known. "
        "Scans have the electronics' noise and come from a converter of 16 bits; each reference is off by its stated "
        "standard uncertainty, at each stop or, in motion, at each reading. What is stated without being measured is "
        "off by less: the heights of 3_spacing, stated to 1 mm, scatter by 20 µm, and the heights and angles of 6_rays "
        "have no error."
    ),
    (
        "Every procedure ran on a rosbag2 bag by the code of the command line, each from the file that the one before "
        "had written; bags, files and printed tables are beside this page."
    ),
    (
        "Uncertainties are standard uncertainties, k = 1 (JCGM 100); intervals of 95 % are 1.96 of them. What a "
        "procedure takes for known is in its uncertainty; how the numbers vary together stands in the file's records."
    ),
    (
        "Errors without noise are those of scans as the electronics would give them without noise and converter: what "
        "they are off by, the calibration is to blame for."
    ),
    (
        "Budget bars: the noise of single readings, and what knowing one quantity exactly would take away from the "
        "freedom's standard uncertainty, as the root of the difference of the squares: where quantities vary together, "
        "their own contributions would exceed the total. The longest are what to improve first."
    ),
    (
        "Fresh poses are drawn over the whole range and have not been used before. The errors of one calibration are "
        "common to all of them: within one campaign they are not independent of one another."
    ),
    (
        "The part of many campaigns in which an interval holds the truth is itself uncertain. Among the findings: by "
        "one standard deviation from campaign to campaign. In picture and table: its own 95 % interval, that of "
        "Clopper and Pearson, of as many independent cases as scatter like the campaigns, since the numbers of one "
        "campaign are not independent of one another."
    ),
)


def page(all_told: Sequence[Told], pictures: Sequence[Mapping[str, bytes]], provenance: Mapping[str, str]) -> str:
    """Return the page, with the pictures of each POSOR that ``draw`` made; it refers to nothing outside itself."""
    every = Findings(tuple(finding for told in all_told for finding in told.findings.findings))
    sections = [Section("Findings", findings_table(every, HEADINGS))]
    for told, shown in zip(all_told, pictures, strict=True):
        sections += _sections(told, shown)
    sections += [Section("Notes", notes_list(NOTES)), Section("Provenance", terms_list(provenance))]
    return document(
        f"Calibration of {' and '.join(told.plant.name for told in all_told)}, simulated campaigns",
        "Everything holds." if holds(all_told) else "Not everything holds.",
        holds=holds(all_told),
        picture=None,
        sections=tuple(sections),
    )


def _sections(told: Told, pictures: Mapping[str, bytes]) -> list[Section]:
    name = told.plant.name
    shown = {what: image(Picture(png, f"{name}: {INSTEAD[what]}")) for what, png in pictures.items()}
    many = "" if told.coverage is None else _coverage_table(told.coverage)
    return [
        Section(f"{name}: judged by the truth", shown["truth"] + many),
        Section(f"{name}: parameters", _parameter_table(told)),
        Section(f"{name}: fits and their residuals", shown["residuals"] + _fit_table(told)),
        Section(f"{name}: error budget and fresh poses", shown["budget"] + _budget_table(told)),
    ]


def _parameter_table(told: Told) -> str:
    header = (
        *("number", "as built", "sigma", "found", "sigma", "unit", "truth", "off / sigma"),
        *("measured by", "with", "date"),
    )
    steps = determined(told.plant.known, [bag.calibration for bag in told.bagged])
    rows = []
    for number in told.numbers:
        before, unsure = number.before
        known = [_shown(before, unsure), f"{unsure:#.2g}"] if unsure > 0.0 else [""] * 2
        if unsure == 0.0:
            known = [f"{before:.6g}", "exact"]
        off = f'<td class="{"holds" if number.inside else "fails"}">{number.pull:+.2f}</td>'
        measured = [AS_BUILT, "", ""]
        if number.name in steps:
            bag, record = told.bagged[steps[number.name]], told.calibration.fits[steps[number.name]]
            measured = [f"{bag.step.name}: {record.procedure}", bag.step.instrument or ITSELF, record.date]
        rows.append(
            [
                *cells([number.name, *known, _shown(number.estimate, number.sigma), f"{number.sigma:#.2g}"]),
                *cells([number.unit, _shown(number.truth, number.sigma)]),
                off,
                *cells(measured),
            ]
        )
    return f"<p>{escape(MEASURED)}</p>{table(header, rows)}"


def _shown(value: float, sigma: float) -> str:
    """Return a number to the second digit of its standard uncertainty."""
    digits = int(np.floor(np.log10(max(abs(value), sigma))) - np.floor(np.log10(sigma))) + 2
    return f"{value + 0.0:#.{digits}g}".rstrip(".")  # never -0.0


def _fit_table(told: Told) -> str:
    header = (
        *("step", "procedure and method", "instrument, its standard uncertainty", "fit", "residuals"),
        *("spread", "probability", "outliers", "bag, SHA-256", "date"),
    )
    rows = []
    for bag, record in zip(told.bagged, told.calibration.fits, strict=True):
        measured = "; ".join(f"{one.name}: {_sigmas(one, bag.step.unit)}" for one in record.instruments)
        for what, figures in record.residuals.items():
            row = [
                bag.step.name,
                f"{record.procedure}: {record.method}",
                measured or ITSELF,
                what,
                f"{figures.readings} of {figures.parameters} parameters",
                f"{figures.spread:.3f}",
                f"{figures.probability:.2g}",
                f"{figures.outliers}",
            ]
            digits = (
                f'<td style="overflow-wrap: anywhere">{escape(record.recording.name)} {record.recording.sha256}</td>'
            )
            rows.append([*cells(row), digits, *cells([record.date])])
    warnings = [f"{bag.step.name}: {said}" for bag in told.bagged for said in bag.outcome.warnings]
    said = f"<p>{escape(SPREAD)}</p><p>What the procedures said of their data:</p>{notes_list(warnings)}"
    return table(header, rows) + said


def _sigmas(instrument: Instrument, unit: str) -> str:
    """Return the standard uncertainties of an instrument's numbers, each once; ``unit``: of a single number."""
    units = [unit] if len(instrument.sigmas) == 1 else ["m"] * 3 + ["rad"] * 3
    each = zip(instrument.sigmas, units, strict=False)
    return ", ".join(dict.fromkeys(f"{round(1e6 * sigma, 6):g} µ{unit}" for sigma, unit in each))


def _budget_table(told: Told) -> str:
    fresh, budget = told.fresh, told.budget
    header = ("standard uncertainty, root mean square", *(f"{freedom} [µ{unit}]" for freedom, unit in FREEDOMS.items()))
    lines = (
        ("budget in the middle of the range: noise", budget.root_sum_square(Kind.RANDOM)[:6]),
        ("budget in the middle: calibration, with its correlations", told.common),
        ("budget in the middle: total", budget.sigmas[:6]),
        ("budget at the fresh poses", np.sqrt(np.nanmean(np.square(fresh.sigmas), axis=0))),
        ("errors at the fresh poses", np.sqrt(np.nanmean(np.square(fresh.errors), axis=0))),
        ("the calibration's part of it", np.sqrt(np.nanmean(np.square(fresh.still_sigmas), axis=0))),
        ("errors there of scans without noise", np.sqrt(np.nanmean(np.square(fresh.still_errors), axis=0))),
        ("errors of the POSOR as built", np.sqrt(np.nanmean(np.square(fresh.before), axis=0))),
    )
    rows = [cells([what, *(f"{1e6 * value:.3g}" for value in values)]) for what, values in lines]
    return table(header, rows)


def _coverage_table(coverage: Coverage) -> str:
    header = ("numbers", "how many", "within their 95 % interval, and how sure that is", "worst of them")
    band = f"{100.0 * coverage.band[0]:.1f} % to {100.0 * coverage.band[1]:.1f} %"
    text = (
        f"<p>{coverage.campaigns} campaigns. A single number whose interval is right comes out between {escape(band)} "
        "with a probability of 95 %.</p>"
    )
    ended = table(header, [cells(_family(family)) for family in coverage.families])
    claimed = table(header, [cells(_family(family)) for family in coverage.claims])
    return f"{text}<p>In the file at the end:</p>{ended}<p>When each procedure stated them:</p>{claimed}"


def _family(family: Family) -> list[str]:
    low, high = family.interval
    inside = f"{100.0 * family.inside.value:.1f} %, {100.0 * low:.1f} % to {100.0 * high:.1f} %"
    return [family.name, str(family.numbers), inside, f"{family.worst[0]}: {100.0 * family.worst[1]:.1f} %"]
