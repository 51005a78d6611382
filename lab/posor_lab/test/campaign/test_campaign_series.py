# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Series of campaigns: coverage of right, too small and too large uncertainties."""

from __future__ import annotations

import multiprocessing
from dataclasses import replace

import numpy as np
import pytest
from posor_lab.accuracy.consistency import MeanEstimate
from posor_lab.campaign.campaign_report import coverage_findings
from posor_lab.campaign.campaign_series import (
    VALIDATION_POSES,
    CampaignResult,
    coverage_of_series,
    run_campaigns,
    share_interval,
)
from posor_lab.campaign.parameter_coverage import EstimatedParameter
from posor_lab.reports.findings import Verdict
from scipy.stats import binomtest


def make_results(scale: float) -> list[CampaignResult]:
    """Return the results of campaigns whose errors are ``scale`` times as large as stated."""
    rng = np.random.default_rng(5)
    results = []
    for seed in range(30):
        parameters = tuple(
            EstimatedParameter(
                f"sensors[0].probes[{k % 3}].tip[{k}]", "gap probe tip", "m", 0.0, (0.0, 1.0), error, 1.0, "bundle"
            )
            for k, error in enumerate(scale * rng.normal(size=80))
        )
        squares = scale**2 * rng.chisquare(6, size=VALIDATION_POSES)
        noise_free = scale * rng.normal(size=120)
        ones, scaled = (1.0,) * 6, (scale,) * 6
        results.append(
            CampaignResult(
                seed=seed,
                claims=parameters,
                parameters=parameters,
                region_share=float(np.mean(squares < 12.59)),
                mean_normalised=float(np.mean(squares)),
                noise_free_share=float(np.mean(np.abs(noise_free) < 1.96)),
                root_mean_squares={
                    "errors": scaled,
                    "budget": ones,
                    "errors_as_built": ones,
                    "errors_without_noise": scaled,
                    "budget_of_calibration": ones,
                },
            )
        )
    return results


def verdicts(results: list[CampaignResult]) -> list[Verdict]:
    return [finding.verdict for finding in coverage_findings(coverage_of_series("triad_diodes", results))]


def test_right_uncertainties_hold() -> None:
    coverage = coverage_of_series("triad_diodes", make_results(1.0))
    assert coverage.pooled.value == pytest.approx(0.95, abs=0.02)
    assert coverage.campaigns == 30
    assert coverage.families[0].count == 80
    assert set(verdicts(make_results(1.0))) == {Verdict.HOLDS}


@pytest.mark.parametrize("scale", [3.0, 1.3])
def test_too_small_uncertainties_fail(scale: float) -> None:
    pooled, _, region, noise_free = verdicts(make_results(scale))
    assert pooled is region is noise_free is Verdict.FAILS


def test_too_large_uncertainties_fail() -> None:
    assert verdicts(make_results(0.5))[0] is Verdict.FAILS


def test_one_wrong_parameter_among_many_fails() -> None:
    wrong = []
    for result in make_results(1.0):
        first, *others = result.parameters
        wrong.append(replace(result, parameters=(replace(first, estimate=3.0 * first.estimate), *others)))
    assert verdicts(wrong)[:2] == [Verdict.HOLDS, Verdict.FAILS]


def test_a_refused_campaign_fails_and_is_quoted() -> None:
    results = [*make_results(1.0), CampaignResult(99, "bag: too few dwells.")]
    first = next(coverage_findings(coverage_of_series("triad_diodes", results)))
    assert first.verdict is Verdict.FAILS
    assert first.remark == "bag: too few dwells."


@pytest.mark.parametrize(("campaigns", "cases"), [(6, 1), (6, 9), (40, 3)])
def test_the_interval_of_a_share_contains_it(campaigns: int, cases: int) -> None:
    random = np.random.default_rng(9)
    contained = []
    for _ in range(300):
        share = MeanEstimate.of(np.mean(random.random((campaigns, cases)) < 0.95, axis=1))
        low, high = share_interval(share, campaigns, cases)
        assert 0.0 <= low <= share.value <= high <= 1.0
        assert high - low > 0.0
        contained.append(low <= 0.95 <= high)
    assert np.mean(contained) >= 0.93


@pytest.mark.parametrize(("shares", "inside"), [([1.0] * 9 + [0.0], 9), ([1.0] * 6, 6)])
def test_the_interval_of_a_share_allows_for_dependence_within_a_campaign(shares: list[float], inside: int) -> None:
    exact = binomtest(inside, len(shares)).proportion_ci(method="exact")
    assert share_interval(MeanEstimate.of(np.array(shares)), len(shares), 50) == pytest.approx(exact)


@pytest.mark.long
def test_an_interrupt_ends_a_series() -> None:
    calls: list[int] = []

    def interrupt() -> None:
        calls.append(1)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaigns("triad_diodes", range(7, 27), workers=2, on_done=interrupt)
    assert calls == [1]
    assert not multiprocessing.active_children()
