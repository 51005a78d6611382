# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Evaluation of one campaign of a POSOR: its findings, and all figures as JSON, in SI units."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.estimation.posor import Posor
from posor.uncertainty.budget_poses import middle_pose, scan_at
from posor.uncertainty.budget_quantities import physical_quantities
from posor.uncertainty.first_order import error_budget, sensitivities
from scipy.stats import norm

from posor_lab.accuracy.consistency import REGION_LIMIT
from posor_lab.campaign.campaign_series import CLAIM, VALIDATION_POSES, chance_margin, share_interval
from posor_lab.campaign.parameter_coverage import compare_with_truth, measuring_steps
from posor_lab.campaign.validation_set import FREEDOMS, validate_calibration
from posor_lab.lab_output import figures_of, page_notes
from posor_lab.reports.findings import Finding, Findings, judge

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray
    from posor.uncertainty.first_order import ErrorBudget

    from posor_lab.accuracy.consistency import MeanEstimate
    from posor_lab.campaign.campaign_run import CompletedStep
    from posor_lab.campaign.campaign_series import SeriesCoverage
    from posor_lab.campaign.ground_truth import GroundTruth
    from posor_lab.campaign.parameter_coverage import EstimatedParameter
    from posor_lab.campaign.validation_set import ValidationSet

POSES = 40  # validation poses of the calibrated POSOR
CHANCE = 1e-3  # probability that a sound campaign fails a finding
TINY = 1e-300
RANK_TOLERANCE = 1e-9  # singular values below this share of the largest come from rounding
OVER_BUDGET, NOISE_FREE_OVER_BUDGET = 2.0, 4.0
"""Limits of root mean square error over budget that a sound campaign hardly exceeds: with noise, and without, where
all poses share the errors of one calibration."""


@dataclass(frozen=True)
class CampaignReport:
    """Evaluation of one POSOR."""

    truth: GroundTruth  # the true POSOR
    steps: list[CompletedStep]  # the steps of its campaign, from bags
    parameters: list[EstimatedParameter]  # parameters of its file at the end, beside the truth
    validation: ValidationSet  # the calibrated POSOR at validation poses
    budget: ErrorBudget  # error budget in the middle of the range
    gains: Mapping[str, FloatArray]
    """By quantity, reduction of the standard uncertainty of each freedom there if the quantity were known exactly, as
    the root of the difference of the squares [m, rad], (6,). Gains of correlated quantities can be compared."""
    calibration_sigmas: FloatArray  # part of the calibration in the uncertainty of each freedom there [m, rad], (6,)
    coverage: SeriesCoverage | None  # coverage of further campaigns; None: none were run

    @staticmethod
    def evaluate(truth: GroundTruth, steps: list[CompletedStep], coverage: SeriesCoverage | None) -> CampaignReport:
        """Evaluate a completed campaign. Raises PosorError: the calibrated POSOR cannot be evaluated."""
        calibration = steps[-1].calibration
        posor = Posor(calibration)
        pose = middle_pose(posor)
        scan = scan_at(posor, pose)
        effects = sensitivities(posor, scan, pose).by_parameter @ posor.parameter_square_root
        return CampaignReport(
            truth=truth,
            steps=steps,
            parameters=compare_with_truth(truth, calibration),
            validation=validate_calibration(truth, calibration, POSES),
            budget=error_budget(posor, scan, pose),
            gains=_quantity_gains(posor, effects),
            calibration_sigmas=np.linalg.norm(effects, axis=1),
            coverage=coverage,
        )

    @property
    def calibration(self) -> Calibration:
        """The calibration at the end."""
        return self.steps[-1].calibration

    @cached_property
    def findings(self) -> Findings:
        """The findings of the campaign and of further campaigns."""
        further = () if self.coverage is None else coverage_findings(self.coverage)
        return Findings((*_campaign_findings(self), *further))


def all_findings(reports: Iterable[CampaignReport]) -> Findings:
    """Return the findings of all POSORs."""
    return Findings(tuple(finding for report in reports for finding in report.findings.findings))


def _quantity_gains(posor: Posor, effects: FloatArray) -> dict[str, FloatArray]:
    """Return ``CampaignReport.gains``; ``effects``: d(freedom)/d(standard normal factor of the parameters), (6, r)."""
    gains = {}
    for quantity in physical_quantities(posor):
        own = posor.parameter_square_root[list(quantity.parameters)]
        if np.any(own):
            # Directions of the standard normal factors that the quantity determines.
            scaled = own / np.linalg.norm(own, axis=1, keepdims=True).clip(TINY)
            _, sizes, directions = np.linalg.svd(scaled, full_matrices=False)
            gains[quantity.name] = np.linalg.norm(effects @ directions[sizes > RANK_TOLERANCE * sizes[0]].T, axis=1)
    return gains


def _campaign_findings(report: CampaignReport) -> Iterator[Finding]:
    texts = page_notes("calibration")["findings"]
    name, parameters, validation = report.truth.name, report.parameters, report.validation
    inside, count = sum(parameter.inside for parameter in parameters), len(parameters)
    yield judge(texts["parameters"], name=name, inside=inside, count=count, share=100.0 * inside / count)
    worst = max(parameters, key=lambda parameter: abs(parameter.normalised_error))
    error, limit = abs(worst.normalised_error), float(norm.isf(0.5 * CHANCE / count))
    figures = {"error": error, "parameter": worst.name, "limit": limit, "chance": CHANCE}
    yield judge(texts["worst"], holds=error <= limit, name=name, **figures)
    fits = [(done.step.name, fit_name, fit) for done in report.steps for fit_name, fit in done.outcome.fits.items()]
    step, fit_name, least = min(fits, key=lambda fit: fit[2].probability)
    limit = CHANCE / len(fits)
    figures = {"probability": least.probability, "step": step, "fit": fit_name, "limit": limit, "count": len(fits)}
    yield judge(texts["fit"], holds=least.probability >= limit, name=name, **figures)
    in_region = 100.0 * np.mean(validation.normalised_squares[validation.located] <= REGION_LIMIT)
    rms = validation.root_mean_squares()
    for key, errors, budget, limit in (
        ("errors", "errors", "budget", OVER_BUDGET),
        ("noise_free_errors", "errors_without_noise", "budget_of_calibration", NOISE_FREE_OVER_BUDGET),
    ):
        ratio = rms[errors] / rms[budget]
        figures = {"count": validation.located.sum(), "ratios": _format_freedoms(ratio, 2), "in_region": in_region}
        yield judge(texts[key], holds=bool(np.all(ratio <= limit)), name=name, limit=limit, **figures)
    gain = rms["errors_as_built"] / rms["errors"]
    yield judge(texts["gain"], holds=bool(np.all(gain > 1.0)), name=name, ratios=_format_freedoms(gain, 0))


def _format_freedoms(values: FloatArray, digits: int) -> str:
    return ", ".join(f"{name} {value:.{digits}f}" for name, value in zip(FREEDOMS, values, strict=True))


def _format_share(share: MeanEstimate, campaigns: int, cases: int, digits: int = 1) -> str:
    """Return a share in percent with its standard uncertainty; without scatter, with its 95 % interval."""
    text = f"{100.0 * share.value:.{digits}f} %"
    if share.sigma > 0.0:
        return f"{text} +- {100.0 * share.sigma:.{digits}f} %"
    low, high = share_interval(share, campaigns, cases)
    return f"{text}, between {100.0 * low:.0f} % and {100.0 * high:.0f} %"


def coverage_findings(coverage: SeriesCoverage) -> Iterator[Finding]:
    """Yield the findings of a series of campaigns."""
    texts = page_notes("calibration")["findings"]
    name, count, (low, high), pooled = coverage.name, coverage.campaigns, CLAIM, coverage.pooled
    parameters, percents = len(coverage.by_parameter), {"low": 100.0 * low, "high": 100.0 * high}
    margin = chance_margin(pooled, count, parameters)
    yield judge(
        texts["pooled"],
        holds=low - margin <= pooled.value <= high + margin and not coverage.refused,
        name=name,
        count=count,
        share=_format_share(pooled, count, parameters, 2),
        margin=100.0 * margin,
        refused="; ".join(coverage.refused[:3]),
        **percents,
    )
    yield judge(
        texts["least_probable"],
        holds=coverage.least_probable >= CHANCE,
        name=name,
        probability=coverage.least_probable,
        smallest=100.0 * min(coverage.by_parameter.values()),
        band=" to ".join(f"{100.0 * end:.1f} %" for end in coverage.binomial_band),
        limit=CHANCE,
        found=coverage.within_claim[0],
        expected=coverage.within_claim[1],
        count=parameters,
    )
    rms = coverage.root_mean_squares
    noise_free_ratio = np.divide(rms["errors_without_noise"], rms["budget_of_calibration"])
    noise_free = {"ratios": _format_freedoms(noise_free_ratio, 2)}
    for key, share, cases, figures in (
        ("region_share", coverage.region_share, VALIDATION_POSES, asdict(coverage.mean_normalised)),
        ("noise_free_share", coverage.noise_free_share, VALIDATION_POSES * len(FREEDOMS), noise_free),
    ):
        below, text = chance_margin(share, count, cases), _format_share(share, count, cases)
        figures |= {"name": name, "count": count, "share": text, "margin": 100.0 * below, **percents}
        yield judge(texts[key], holds=share.value + below >= low, **figures)


def campaigns_as_json(reports: Sequence[CampaignReport]) -> dict[str, Any]:
    """Return all figures by the name of the POSOR, and ``holds``."""
    content: dict[str, Any] = {report.truth.name: _report_as_json(report) for report in reports}
    return content | {"holds": all(report.findings.holds for report in reports)}


def _by_freedom(values: Mapping[str, Iterable[float]]) -> dict[str, dict[str, float]]:
    return {name: dict(zip(FREEDOMS, map(float, six), strict=True)) for name, six in values.items()}


def _report_as_json(report: CampaignReport) -> dict[str, Any]:
    validation, names = report.validation, page_notes("calibration")["figures"]
    steps = measuring_steps(report.truth.as_built, [done.calibration for done in report.steps])
    measured_by = {name: report.steps[index].step.name for name, index in steps.items()}
    return {
        "seed": report.truth.seed,
        "content_hash": report.calibration.content_hash,
        "parameters": {
            each.name: {**figures_of(each, names["parameter"]), "measured_by": measured_by.get(each.name)}
            for each in report.parameters
        },
        "steps": {
            done.step.name: {
                **figures_of(record, names["step"]),
                "instruments": {instrument.name: instrument.sigmas for instrument in record.instruments},
            }
            for done, record in zip(report.steps, report.calibration.fits, strict=True)
        },
        "fresh_poses": {
            "count": int(validation.located.sum()),
            "root_mean_square": _by_freedom(validation.root_mean_squares()),
            "normalised_error_squared": float(np.mean(validation.normalised_squares[validation.located])),
        },
        "campaigns": None if report.coverage is None else _coverage_as_json(report.coverage),
    }


def _coverage_as_json(coverage: SeriesCoverage) -> dict[str, Any]:
    names = page_notes("calibration")["figures"]
    families = {"families": coverage.families, "procedures": coverage.claims}
    found, expected = coverage.within_claim
    return {
        **figures_of(coverage, names["coverage"]),
        **{key: asdict(getattr(coverage, name)) for key, name in names["shares"].items()},
        **{key: {each.name: figures_of(each, names["family"]) for each in of_key} for key, of_key in families.items()},
        "numbers_at_95_plus_minus_3": {"found": found, "expected": expected, "of": len(coverage.by_parameter)},
        "fresh_root_mean_square": _by_freedom(coverage.root_mean_squares),
    }
