"""Tells calibration campaigns as a page, and in numbers for other programs."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from posor_estimator.core.budget.first_order import Kind

from posor_bringup.campaign.fresh import FREEDOMS
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

    from posor_bringup.campaign.many import Coverage, Family
    from posor_bringup.campaign.told import Told

ROOTS: Mapping[str, str] = {
    "errors": "errors",
    "budget": "sigmas",
    "errors_as_built": "before",
    "errors_without_noise": "still_errors",
    "budget_of_calibration": "still_sigmas",
}
"""By what they are called in the figures for other programs: attributes of ``Fresh`` and ``Coverage``."""
HEADINGS: Mapping[str, str] = {"computed": "found", "stated": "expected", "limit": "must be", "source": "source"}
INSTEAD: Mapping[str, str] = {
    "residuals": "residuals of the fits",
    "budget": "error budget in the middle of the range",
    "truth": "numbers, errors at fresh poses and coverage against the truth",
}
"""What to say of each picture where it cannot be shown."""
NOTES = (
    (
        "Simulated: each POSOR is drawn from what is known of it as built, so the truth behind every number is known. "
        "Scans have the electronics' noise and come from a converter of 16 bits; each reference is off by its stated "
        "standard uncertainty, at each stop or, in motion, at each reading."
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
        "Budget bars: what knowing one quantity exactly would take away from the freedom's standard uncertainty, as "
        "the root of the difference of the squares: where quantities vary together, their own contributions would "
        "exceed the total."
    ),
    (
        "Fresh poses are drawn over the whole range and have not been used before. The errors of one calibration are "
        "common to all of them: within one campaign they are not independent of one another."
    ),
    (
        "The part of many campaigns in which an interval holds the truth has itself an uncertainty, given as one "
        "standard deviation from campaign to campaign; the numbers of one campaign are not independent of one another."
    ),
)


def holds(all_told: Sequence[Told]) -> bool:
    """Return whether everything holds."""
    return all(told.findings.holds for told in all_told)


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
    header = ("number", "as built", "sigma", "found", "sigma", "unit", "truth", "off / sigma", "procedure")
    rows = []
    for number in told.numbers:
        before, unsure = (f"{value:.6g}" if np.isfinite(value) else "" for value in number.before)
        off = f'<td class="{"holds" if number.inside else "fails"}">{number.pull:+.2f}</td>'
        rows.append(
            [
                *cells([number.name, before, unsure, _shown(number.estimate, number.sigma), f"{number.sigma:.2g}"]),
                *cells([number.unit, _shown(number.truth, number.sigma)]),
                off,
                *cells([number.procedure]),
            ]
        )
    told_by = "<p>Method, date, bag and instrument of each procedure stand below, with its fits.</p>"
    return told_by + table(header, rows)


def _shown(value: float, sigma: float) -> str:
    """Return a number to the second digit of its standard uncertainty."""
    digits = int(np.floor(np.log10(max(abs(value), sigma))) - np.floor(np.log10(sigma))) + 2
    return f"{value:.{digits}g}"


def _fit_table(told: Told) -> str:
    header = (
        "step",
        "procedure and method",
        "instrument, its standard uncertainty",
        "fit",
        "residuals",
        "spread",
        "probability",
        "outliers",
        "bag, SHA-256",
        "date",
    )
    rows = []
    for bag, record in zip(told.bagged, told.calibration.fits, strict=True):
        measured = "; ".join(
            f"{one.name}: {', '.join(f'{sigma:.2g}' for sigma in dict.fromkeys(one.sigmas))}"
            for one in record.instruments
        )
        for what, figures in record.residuals.items():
            rows.append(
                cells(
                    [
                        bag.step.name,
                        f"{record.procedure}: {record.method}",
                        measured or "none",
                        what,
                        f"{figures.readings} of {figures.parameters} parameters",
                        f"{figures.spread:.3f}",
                        f"{figures.probability:.2g}",
                        f"{figures.outliers}",
                        f"{record.recording.name}, {record.recording.sha256[:16]}…",
                        record.date,
                    ]
                )
            )
    warnings = [f"{bag.step.name}: {said}" for bag in told.bagged for said in bag.outcome.warnings]
    return table(header, rows) + "<p>What the procedures said of their data:</p>" + notes_list(warnings)


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
    header = ("numbers", "how many", "within their 95 % interval", "worst of them")
    band = f"{100.0 * coverage.band[0]:.1f} % to {100.0 * coverage.band[1]:.1f} %"
    text = (
        f"<p>{coverage.campaigns} campaigns. A single number whose interval is right comes out between {escape(band)} "
        "with a probability of 95 %.</p>"
    )
    ended = table(header, [cells(_family(family)) for family in coverage.families])
    claimed = table(header, [cells(_family(family)) for family in coverage.claims])
    return f"{text}<p>In the file at the end:</p>{ended}<p>When each procedure stated them:</p>{claimed}"


def _family(family: Family) -> list[str]:
    inside = f"{100.0 * family.inside.value:.1f} % +- {100.0 * family.inside.sigma:.1f} %"
    return [family.name, str(family.numbers), inside, f"{family.worst[0]}: {100.0 * family.worst[1]:.1f} %"]


def as_json(all_told: Sequence[Told]) -> dict[str, Any]:
    """Return everything by name, in SI units."""
    return {told.plant.name: _posor_json(told) for told in all_told} | {"holds": holds(all_told)}


def _posor_json(told: Told) -> dict[str, Any]:
    fresh = told.fresh
    rms = {
        called: dict(zip(FREEDOMS, np.sqrt(np.nanmean(np.square(getattr(fresh, what)), axis=0)).tolist(), strict=True))
        for called, what in ROOTS.items()
    }
    return {
        "seed": told.plant.seed,
        "content_hash": told.calibration.content_hash,
        "parameters": {
            number.name: {
                "family": number.family,
                "unit": number.unit,
                "truth": number.truth,
                "estimate": number.estimate,
                "sigma": number.sigma,
                "within_95": number.inside,
                "procedure": number.procedure,
            }
            for number in told.numbers
        },
        "fresh_poses": {
            "count": int(fresh.known.sum()),
            "root_mean_square": rms,
            "normalised_error_squared": float(np.mean(fresh.normalised[fresh.known])),
        },
        "campaigns": None if told.coverage is None else _coverage_json(told.coverage),
    }


def _coverage_json(coverage: Coverage) -> dict[str, Any]:
    def families(of: Sequence[Family]) -> dict[str, Any]:
        return {
            one.name: {
                "numbers": one.numbers,
                "within_95": one.inside.value,
                "sigma": one.inside.sigma,
                "worst": {"name": one.worst[0], "within_95": one.worst[1]},
            }
            for one in of
        }

    return {
        "count": coverage.campaigns,
        "refused": list(coverage.refused),
        "within_95": {"value": coverage.pooled.value, "sigma": coverage.pooled.sigma},
        "binomial_band_of_one_number": list(coverage.band),
        "numbers_at_95_plus_minus_3": {
            "found": coverage.within_claim[0],
            "expected": coverage.within_claim[1],
            "of": len(coverage.by_number),
        },
        "least_probable_bonferroni": coverage.least_probable,
        "by_number": coverage.by_number,
        "families": families(coverage.families),
        "procedures": families(coverage.claims),
        "fresh_within_95_region": {"value": coverage.fresh_inside.value, "sigma": coverage.fresh_inside.sigma},
        "fresh_normalised_error_squared": {
            "value": coverage.fresh_normalised.value,
            "sigma": coverage.fresh_normalised.sigma,
        },
        "fresh_without_noise_within_95": {"value": coverage.still_inside.value, "sigma": coverage.still_inside.sigma},
        "fresh_root_mean_square": {
            called: dict(zip(FREEDOMS, getattr(coverage, what), strict=True)) for called, what in ROOTS.items()
        },
    }
