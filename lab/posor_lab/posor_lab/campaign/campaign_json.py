"""Calibration campaigns as JSON, in SI units."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from posor_lab.campaign.parameter_coverage import measuring_steps
from posor_lab.campaign.validation_set import FREEDOMS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from posor_lab.campaign.campaign_report import CampaignReport
    from posor_lab.campaign.campaign_series import FamilyCoverage, SeriesCoverage


def campaigns_as_json(reports: Sequence[CampaignReport]) -> dict[str, Any]:
    """Return all figures by the name of the POSOR, and ``holds``."""
    content: dict[str, Any] = {report.truth.name: _report_as_json(report) for report in reports}
    return content | {"holds": all(report.findings.holds for report in reports)}


def _by_freedom(values: Mapping[str, Iterable[float]]) -> dict[str, dict[str, float]]:
    return {name: dict(zip(FREEDOMS, map(float, six), strict=True)) for name, six in values.items()}


def _report_as_json(report: CampaignReport) -> dict[str, Any]:
    validation = report.validation
    steps = measuring_steps(report.truth.as_built, [done.calibration for done in report.steps])
    return {
        "seed": report.truth.seed,
        "content_hash": report.calibration.content_hash,
        "parameters": {
            parameter.name: {
                "family": parameter.family,
                "unit": parameter.unit,
                "truth": parameter.truth,
                "estimate": parameter.estimate,
                "sigma": parameter.sigma,
                "within_95": parameter.inside,
                "measured_by": report.steps[steps[parameter.name]].step.name if parameter.name in steps else None,
            }
            for parameter in report.parameters
        },
        "steps": {
            done.step.name: {
                "procedure": record.procedure,
                "method": record.method,
                "instruments": {instrument.name: instrument.sigmas for instrument in record.instruments},
                "bag": record.recording.name,
                "sha256": record.recording.sha256,
                "date": record.date,
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


def _families_as_json(families: Sequence[FamilyCoverage]) -> dict[str, Any]:
    return {
        family.name: {
            "numbers": family.count,
            "within_95": family.inside.value,
            "sigma": family.inside.sigma,
            "interval_95": list(family.interval),
            "worst": {"name": family.worst[0], "within_95": family.worst[1]},
        }
        for family in families
    }


def _coverage_as_json(coverage: SeriesCoverage) -> dict[str, Any]:
    return {
        "count": coverage.campaigns,
        "refused": list(coverage.refused),
        "within_95": asdict(coverage.pooled),
        "binomial_band_of_one_number": list(coverage.binomial_band),
        "numbers_at_95_plus_minus_3": {
            "found": coverage.within_claim[0],
            "expected": coverage.within_claim[1],
            "of": len(coverage.by_parameter),
        },
        "least_probable_bonferroni": coverage.least_probable,
        "by_number": coverage.by_parameter,
        "families": _families_as_json(coverage.families),
        "procedures": _families_as_json(coverage.claims),
        "fresh_within_95_region": asdict(coverage.region_share),
        "fresh_normalised_error_squared": asdict(coverage.mean_normalised),
        "fresh_without_noise_within_95": asdict(coverage.noise_free_share),
        "fresh_root_mean_square": _by_freedom(coverage.root_mean_squares),
    }
