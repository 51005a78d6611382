# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A series of campaigns in several processes, and the coverage of the stated intervals over the series."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.errors import PosorError
from scipy.stats import beta, binom, binomtest, t

from posor_lab.accuracy.consistency import REGION_LIMIT, MeanEstimate
from posor_lab.campaign.campaign_run import run_in_memory
from posor_lab.campaign.ground_truth import GroundTruth
from posor_lab.campaign.parameter_coverage import QUANTILE_95, compare_with_truth
from posor_lab.campaign.validation_set import validate_calibration
from posor_lab.reports.process_pool import ordered_map

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor_lab.campaign.ground_truth import PosorName
    from posor_lab.campaign.parameter_coverage import EstimatedParameter

VALIDATION_POSES = 20  # validation poses of each campaign
CLAIM = (0.92, 0.98)  # accepted share of campaigns whose interval contains the truth


@dataclass(frozen=True)
class CampaignResult:
    """Result of one campaign."""

    seed: int  # seed of the draw
    refusal: str = ""  # error of a procedure; empty: the campaign was completed
    claims: tuple[EstimatedParameter, ...] = ()  # parameters as each procedure stated them
    parameters: tuple[EstimatedParameter, ...] = ()  # parameters of the file at the end
    region_share: float = 0.0  # share of the validation poses with an error within the 95 % region of the budget
    mean_normalised: float = np.nan  # mean normalised squared error of the validation poses; 6 if the budget is right
    noise_free_share: float = 0.0  # errors without noise within 95 % by the calibration's part of the budget
    root_mean_squares: dict[str, tuple[float, ...]] = field(default_factory=dict)  # of ``ValidationSet``


def _run_campaign(name: PosorName, seed: int) -> CampaignResult:
    """Run one campaign and compare its result with the truth."""
    truth = GroundTruth.draw(name, seed)
    claims: list[EstimatedParameter] = []
    calibration = truth.as_built
    try:
        for completed in run_in_memory(truth):
            calibration = completed.calibration
            claims += compare_with_truth(truth, calibration, last_procedure=True)
    except PosorError as error:
        return CampaignResult(seed, str(error))
    validation = validate_calibration(truth, calibration, VALIDATION_POSES)
    located = validation.located
    normalised = validation.normalised_squares[located]
    noise_free = np.abs(validation.noise_free_errors[located]) < QUANTILE_95 * validation.calibration_sigmas[located]
    return CampaignResult(
        seed=seed,
        claims=tuple(claims),
        parameters=tuple(compare_with_truth(truth, calibration)),
        region_share=float(np.mean(normalised <= REGION_LIMIT)),
        mean_normalised=float(np.mean(normalised)),
        noise_free_share=float(np.mean(noise_free)),
        root_mean_squares={name: tuple(v.tolist()) for name, v in validation.root_mean_squares().items()},
    )


def run_campaigns(
    name: PosorName, seeds: Sequence[int], *, workers: int = 0, on_done: Callable[[], None] = lambda: None
) -> list[CampaignResult]:
    """Run one campaign for each seed in several processes; the result does not depend on their number.

    ``workers`` of 0: one for each processor; an exception of ``on_done``, called after each campaign, ends the series.
    """
    # Read when a worker loads numpy: threads of several workers would only wait for one another.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return ordered_map(partial(_run_campaign, name), seeds, workers, lambda _: on_done())


class WorstParameter(NamedTuple):
    """The parameter with the smallest share of intervals with the truth."""

    name: str
    within_95: float


@dataclass(frozen=True)
class FamilyCoverage:
    """Coverage of the intervals of similar parameters."""

    name: str  # name of the family
    count: int  # number of parameters per campaign
    inside: MeanEstimate  # share of intervals with the truth; parameters of one campaign are not independent
    interval: tuple[float, float]  # 95 % interval of that share, see ``share_interval``
    worst: WorstParameter


@dataclass(frozen=True)
class SeriesCoverage:
    """Coverage over a series of campaigns."""

    name: PosorName  # design of the POSOR
    campaigns: int  # number of completed campaigns
    refused: tuple[str, ...]  # errors of the other campaigns
    pooled: MeanEstimate  # share of all parameters within their stated 95 % interval
    families: tuple[FamilyCoverage, ...]  # by family, in the file at the end
    claims: tuple[FamilyCoverage, ...]  # by procedure and family, when the procedure stated them
    by_parameter: dict[str, float]  # share of the campaigns in which each parameter was within its interval
    binomial_band: tuple[float, float]  # 95 % range of that share for right intervals
    within_claim: tuple[int, float]  # number of parameters with a share within ``CLAIM``, and the expected number
    least_probable: float  # probability of the most improbable share, times the number of parameters (Bonferroni)
    region_share: MeanEstimate  # share of validation poses within the 95 % region of the budget
    mean_normalised: MeanEstimate  # mean normalised squared error; 6 if the budget is right
    noise_free_share: MeanEstimate  # share of errors without noise within 95 % by the calibration's part of the budget
    root_mean_squares: dict[str, tuple[float, ...]]  # over all campaigns, see ``ValidationSet.root_mean_squares``


def chance_margin(figure: MeanEstimate, campaigns: int, cases: int) -> float:
    """Return the deviation of a share near 95 % that chance exceeds with a probability of one half per cent.

    ``figure`` is the mean over the campaigns with its standard uncertainty by their scatter: that of few campaigns is
    uncertain (Student), and it is no smaller than that of as many independent cases.
    """
    least = np.sqrt(0.95 * 0.05 / (campaigns * cases))
    return float(t.isf(0.005, campaigns - 1) * max(figure.sigma, least))


def share_interval(share: MeanEstimate, campaigns: int, cases: int) -> tuple[float, float]:
    """Return the 95 % interval of a share, between 0 and 1; ``cases``: in each of two campaigns or more.

    Interval of Clopper and Pearson for the effective number of independent cases, which follows from the scatter of the
    campaigns (Korn and Graubard 1998, Survey Methodology 24, 193 to 201): at least the number of campaigns, at most
    the number of cases. Without scatter each campaign counts as one case.
    """
    mean, effective = share.value, float(campaigns)
    if share.sigma > 0.0:
        correction = (t.ppf(0.975, campaigns * cases - 1) / t.ppf(0.975, campaigns - 1)) ** 2
        effective = float(np.clip(correction * mean * (1.0 - mean) / share.sigma**2, campaigns, campaigns * cases))
    inside = mean * effective
    low = float(beta.ppf(0.025, inside, effective - inside + 1.0)) if mean > 0.0 else 0.0
    high = float(beta.ppf(0.975, inside + 1.0, effective - inside)) if mean < 1.0 else 1.0
    return low, high


def coverage_of_series(name: PosorName, results: Sequence[CampaignResult]) -> SeriesCoverage:
    """Return the coverage of a series with at least two completed campaigns."""
    done = [result for result in results if not result.refusal]
    count = len(done)
    by_parameter = _shares([{p.name: p.inside for p in result.parameters} for result in done])
    low, high = (k / count for k in binom.interval(0.95, count, 0.95))
    least, most = np.ceil(CLAIM[0] * count - 1e-9), np.floor(CLAIM[1] * count + 1e-9)
    claim_probability = float(binom.cdf(most, count, 0.95) - binom.cdf(least - 1, count, 0.95))
    improbable = min(binomtest(round(share * count), count, 0.95).pvalue for share in by_parameter.values())
    return SeriesCoverage(
        name=name,
        campaigns=count,
        refused=tuple(result.refusal for result in results if result.refusal),
        pooled=MeanEstimate.of(np.array([np.mean([p.inside for p in result.parameters]) for result in done])),
        families=_family_coverages([result.parameters for result in done], by_procedure=False),
        claims=_family_coverages([result.claims for result in done], by_procedure=True),
        by_parameter=by_parameter,
        binomial_band=(float(low), float(high)),
        within_claim=(
            sum(CLAIM[0] <= share <= CLAIM[1] for share in by_parameter.values()),
            len(by_parameter) * claim_probability,
        ),
        least_probable=min(1.0, improbable * len(by_parameter)),
        region_share=MeanEstimate.of(np.array([result.region_share for result in done])),
        mean_normalised=MeanEstimate.of(np.array([result.mean_normalised for result in done])),
        noise_free_share=MeanEstimate.of(np.array([result.noise_free_share for result in done])),
        root_mean_squares={
            key: tuple(np.sqrt(np.mean(np.square([result.root_mean_squares[key] for result in done]), axis=0)).tolist())
            for key in done[0].root_mean_squares
        },
    )


def _shares(inside_by_campaign: Sequence[dict[str, bool]]) -> dict[str, float]:
    """Return the share of the campaigns in which each parameter was inside."""
    names = dict.fromkeys(name for inside in inside_by_campaign for name in inside)
    return {name: float(np.mean([inside[name] for inside in inside_by_campaign if name in inside])) for name in names}


def _family_coverages(
    campaigns: Sequence[Sequence[EstimatedParameter]], *, by_procedure: bool
) -> tuple[FamilyCoverage, ...]:
    def family_name(parameter: EstimatedParameter) -> str:
        return f"{parameter.procedure}: {parameter.family}" if by_procedure else parameter.family

    coverages = []
    for family in dict.fromkeys(family_name(p) for parameters in campaigns for p in parameters):
        members = [{p.name: p.inside for p in parameters if family_name(p) == family} for parameters in campaigns]
        shares = _shares(members)
        worst = min(shares, key=lambda name: shares[name])
        means = np.array([np.mean(list(inside.values())) for inside in members if inside])
        share = MeanEstimate.of(means)
        interval = share_interval(share, len(means), len(shares))
        coverages.append(FamilyCoverage(family, len(shares), share, interval, WorstParameter(worst, shares[worst])))
    return tuple(coverages)
