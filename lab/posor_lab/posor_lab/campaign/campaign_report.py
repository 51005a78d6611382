"""Evaluation of one campaign of a POSOR, with its findings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from posor.estimation.posor import Posor
from posor.uncertainty.budget_poses import middle_pose, scan_at
from posor.uncertainty.budget_quantities import physical_quantities
from posor.uncertainty.first_order import error_budget, sensitivities
from scipy.stats import norm

from posor_lab.accuracy.consistency import REGION_LIMIT
from posor_lab.campaign.campaign_series import CLAIM, VALIDATION_POSES, chance_margin, share_interval
from posor_lab.campaign.parameter_coverage import compare_with_truth
from posor_lab.campaign.validation_set import FREEDOMS, validate_calibration
from posor_lab.reports.findings import Finding, Findings, Verdict

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray
    from posor.uncertainty.first_order import ErrorBudget

    from posor_lab.arm_study.arm_coverage import MeanEstimate
    from posor_lab.campaign.campaign_run import CompletedStep
    from posor_lab.campaign.campaign_series import SeriesCoverage
    from posor_lab.campaign.ground_truth import GroundTruth
    from posor_lab.campaign.parameter_coverage import EstimatedParameter
    from posor_lab.campaign.validation_set import ValidationSet

POSES = 40
"""Validation poses of the calibrated POSOR."""
CHANCE = 1e-3
"""Probability that a sound campaign fails a finding."""
TINY = 1e-300
RANK_TOLERANCE = 1e-9
"""Singular values below this share of the largest come from rounding."""
OVER_BUDGET, NOISE_FREE_OVER_BUDGET = 2.0, 4.0
"""Limits of root mean square error over budget that a sound campaign hardly exceeds: with noise, and without, where
all poses share the errors of one calibration."""


@dataclass(frozen=True)
class CampaignReport:
    """Evaluation of one POSOR.

    Attributes:
        truth: The true POSOR.
        steps: The steps of its campaign, from bags.
        parameters: Parameters of its file at the end, beside the truth.
        validation: The calibrated POSOR at validation poses.
        budget: Error budget in the middle of the range.
        gains: By quantity, reduction of the standard uncertainty of each freedom there if the quantity were known
            exactly, as the root of the difference of the squares [m, rad], (6,). Unlike contributions, gains of
            correlated quantities can be compared.
        calibration_sigmas: Part of the calibration in the standard uncertainty of each freedom there [m, rad], (6,).
        coverage: Coverage of further campaigns; None: none were run.

    """

    truth: GroundTruth
    steps: list[CompletedStep]
    parameters: list[EstimatedParameter]
    validation: ValidationSet
    budget: ErrorBudget
    gains: Mapping[str, FloatArray]
    calibration_sigmas: FloatArray
    coverage: SeriesCoverage | None

    @staticmethod
    def evaluate(truth: GroundTruth, steps: list[CompletedStep], coverage: SeriesCoverage | None) -> CampaignReport:
        """Evaluate a completed campaign.

        Raises:
            PosorError: The calibrated POSOR cannot be evaluated.

        """
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
        further = [] if self.coverage is None else coverage_findings(self.coverage)
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


def _campaign_findings(report: CampaignReport) -> list[Finding]:
    name, parameters, validation = report.truth.name, report.parameters, report.validation
    inside = sum(parameter.inside for parameter in parameters)
    worst = max(parameters, key=lambda parameter: abs(parameter.normalised_error))
    limit = float(norm.isf(0.5 * CHANCE / len(parameters)))
    fits = [(done.step.name, fit_name, fit) for done in report.steps for fit_name, fit in done.outcome.fits.items()]
    step, fit_name, least = min(fits, key=lambda fit: fit[2].probability)
    located = validation.located
    rms = validation.root_mean_squares()
    ratio = rms["errors"] / rms["budget"]
    noise_free_ratio = rms["errors_without_noise"] / rms["budget_of_calibration"]
    gain = rms["errors_as_built"] / rms["errors"]
    in_region = 100.0 * np.mean(validation.normalised_squares[located] <= REGION_LIMIT)
    source, budget = "this campaign, truth known", "first-order budget, JCGM 100"
    return [
        Finding(
            f"{name}: parameters of the file within their 95 % interval",
            f"{inside} of {len(parameters)}, {100.0 * inside / len(parameters):.1f} %",
            "95 %",
            "",
            source,
            Verdict.NOT_JUDGED,
            "one campaign; the coverage of the intervals needs many",
        ),
        Finding(
            f"{name}: parameter with the largest error over its standard uncertainty",
            f"{abs(worst.normalised_error):.2f} sigmas, {worst.name}",
            "",
            f"at most {limit:.2f}",
            source,
            Verdict.of(holds=abs(worst.normalised_error) <= limit),
            f"a sound campaign fails with a probability of {CHANCE:g}",
            "the procedure that measured it states too small an uncertainty: see its fit and warnings",
        ),
        Finding(
            f"{name}: least probable fit",
            f"chi-square of probability {least.probability:.2g}, {step}, {fit_name}",
            "",
            f"at least {CHANCE / len(fits):.1g}",
            f"{len(fits)} fits",
            Verdict.of(holds=least.probability >= CHANCE / len(fits)),
            if_fails="a stated uncertainty of an instrument or reading is too small, or the model is incomplete",
        ),
        Finding(
            f"{name}: errors at {int(located.sum())} validation poses over the budget, root mean square",
            _format_freedoms(ratio, 2),
            "1 on average",
            f"at most {OVER_BUDGET:g}",
            budget,
            Verdict.of(holds=bool(np.all(ratio <= OVER_BUDGET))),
            f"{in_region:.0f} % within the 95 % region of all six",
            "the budget is too small: a parameter with a large error, above, or noise that the file does not state",
        ),
        Finding(
            f"{name}: errors there without noise over the calibration's part of the budget, root mean square",
            _format_freedoms(noise_free_ratio, 2),
            "1 on average",
            f"at most {NOISE_FREE_OVER_BUDGET:g}",
            budget,
            Verdict.of(holds=bool(np.all(noise_free_ratio <= NOISE_FREE_OVER_BUDGET))),
            "all poses share one calibration, so one campaign shows little",
            "a parameter has an error far beyond its standard uncertainty: see the parameters",
        ),
        Finding(
            f"{name}: errors as built over errors calibrated",
            _format_freedoms(gain, 0),
            "",
            "more than 1",
            "the same validation poses",
            Verdict.of(holds=bool(np.all(gain > 1.0))),
            if_fails="the calibration has made a freedom worse: a step has fitted a wrong value",
        ),
    ]


def _format_freedoms(values: FloatArray, digits: int) -> str:
    return ", ".join(f"{name} {value:.{digits}f}" for name, value in zip(FREEDOMS, values, strict=True))


def _format_share(share: MeanEstimate, campaigns: int, cases: int, digits: int = 1) -> str:
    """Return a share in percent with its standard uncertainty; without scatter, with its 95 % interval."""
    text = f"{100.0 * share.value:.{digits}f} %"
    if share.sigma > 0.0:
        return f"{text} +- {100.0 * share.sigma:.{digits}f} %"
    low, high = share_interval(share, campaigns, cases)
    return f"{text}, between {100.0 * low:.0f} % and {100.0 * high:.0f} %"


def coverage_findings(coverage: SeriesCoverage) -> list[Finding]:
    """Return the findings of a series of campaigns."""
    name, count, (low, high) = coverage.name, coverage.campaigns, CLAIM
    parameters = len(coverage.by_parameter)
    margin = chance_margin(coverage.pooled, count, parameters)
    rms = coverage.root_mean_squares
    noise_free_ratio = np.divide(rms["errors_without_noise"], rms["budget_of_calibration"])
    band = " to ".join(f"{100.0 * end:.1f} %" for end in coverage.binomial_band)
    source = f"{count} seeded campaigns"

    def share_finding(quantity: str, share: MeanEstimate, cases: int, remark: str) -> Finding:
        below = chance_margin(share, count, cases)
        return Finding(
            f"{name}: {quantity}",
            _format_share(share, count, cases),
            "95 %",
            f"at least {100.0 * low:g} %, less {100.0 * below:.1f} % by chance",
            source,
            Verdict.of(holds=share.value + below >= low),
            remark,
            "the calibration states too small uncertainties, as far as they act on the pose",
        )

    return [
        Finding(
            f"{name}: within their 95 % interval, all parameters of {count} campaigns",
            _format_share(coverage.pooled, count, parameters, 2),
            "95 %",
            f"{100.0 * low:g} % to {100.0 * high:g} %, give or take {100.0 * margin:.1f} % by chance",
            source,
            Verdict.of(holds=low - margin <= coverage.pooled.value <= high + margin and not coverage.refused),
            "; ".join(coverage.refused[:3]),
            "a campaign was refused, or the intervals do not have their width: see the table of families",
        ),
        Finding(
            f"{name}: parameter with the least probable coverage",
            f"probability {coverage.least_probable:.2g} (Bonferroni), smallest share "
            f"{100.0 * min(coverage.by_parameter.values()):.1f} %",
            f"95 % of right intervals give {band}",
            f"at least {CHANCE:g}",
            "binomial",
            Verdict.of(holds=coverage.least_probable >= CHANCE),
            f"{coverage.within_claim[0]} of {parameters} parameters have 95 +- 3 %; right intervals: "
            f"{coverage.within_claim[1]:.0f}",
            "the interval of this parameter is too narrow or too wide: see the step that measures it",
        ),
        share_finding(
            "validation poses within the budget's 95 % region",
            coverage.region_share,
            VALIDATION_POSES,
            f"normalised squared error {coverage.mean_normalised.value:.2f} +- {coverage.mean_normalised.sigma:.2f}, "
            "6 if the budget is right",
        ),
        share_finding(
            "errors without noise within 95 % by the calibration's part of the budget",
            coverage.noise_free_share,
            VALIDATION_POSES * len(FREEDOMS),
            f"root mean square over the budget: {_format_freedoms(noise_free_ratio, 2)}",
        ),
    ]
