"""Everything that a demo of calibration has to tell of one POSOR."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor_estimator.core.budget.first_order import error_budget, sensitivities
from posor_estimator.core.budget.poses import middle_pose, scan_at
from posor_estimator.core.budget.quantities import physical_quantities
from posor_estimator.core.calibrate.stated import root_of, stated_covariance
from posor_estimator.core.posor import Posor
from scipy.stats import norm

from posor_bringup.campaign.fresh import FREEDOMS, fresh_poses
from posor_bringup.campaign.judged import judged
from posor_bringup.campaign.many import CLAIM, FRESH, REGION_LIMIT, spare
from posor_bringup.findings import Finding, Findings, Verdict

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.budget.first_order import ErrorBudget, Sensitivities
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

    from posor_bringup.campaign.bagged import Bagged
    from posor_bringup.campaign.fresh import Fresh
    from posor_bringup.campaign.judged import Judged
    from posor_bringup.campaign.many import Coverage
    from posor_bringup.campaign.plant import Plant

POSES = 40
"""Fresh poses at which the calibrated POSOR of the demo is checked."""
CHANCE = 1e-3
"""Probability with which a sound campaign may fail a finding."""
NOISE = "noise of the readings"
TINY = 1e-300
TOLD = 1e-9
"""Of the largest singular value: a smaller one comes from rounding."""
OVER_BUDGET = 2.0
"""Root mean square error over the budget, that a sound campaign hardly exceeds; its errors are nearly all common."""


@dataclass(frozen=True)
class Told:
    """One POSOR.

    Attributes:
        plant: The truth.
        bagged: The steps of its campaign, from bags.
        numbers: What its file says at the end, beside the truth.
        fresh: The calibrated POSOR at fresh poses.
        budget: Its error budget in the middle of its range.
        gains: By quantity, what knowing it exactly would take away from each freedom's standard uncertainty there, as
            the root of the difference of the squares [m, rad], (6,). Quantities that vary together cannot be told apart
            by their own contributions; this can be compared.
        coverage: Of many campaigns; None: none were run.

    """

    plant: Plant
    bagged: list[Bagged]
    numbers: list[Judged]
    fresh: Fresh
    budget: ErrorBudget
    gains: Mapping[str, FloatArray]
    coverage: Coverage | None

    @staticmethod
    def of(plant: Plant, bagged: list[Bagged], coverage: Coverage | None) -> Told:
        """Judge a campaign that went through.

        Raises:
            PosorError: The calibrated POSOR cannot be judged.

        """
        calibration = bagged[-1].calibration
        posor = Posor(calibration)
        pose = middle_pose(posor)
        scan, covariance = scan_at(posor, pose), stated_covariance(calibration)
        return Told(
            plant=plant,
            bagged=bagged,
            numbers=judged(plant, calibration),
            fresh=fresh_poses(plant, calibration, POSES),
            budget=error_budget(posor, scan, pose, parameter_covariance=covariance),
            gains=_gains(posor, sensitivities(posor, scan, pose), covariance),
            coverage=coverage,
        )

    @property
    def calibration(self) -> Calibration:
        """What is known in the end."""
        return self.bagged[-1].calibration

    @property
    def findings(self) -> Findings:
        """What was found, and whether it holds."""
        many = [] if self.coverage is None else _of_many(self.coverage)
        return Findings((*_of_one(self), *many))


def _gains(posor: Posor, found: Sensitivities, covariance: FloatArray) -> dict[str, FloatArray]:
    """Return what knowing each quantity exactly would take away, see ``Told.gains``; noise first."""
    gains = {NOISE: np.sqrt(np.sum(np.square(found.by_reading * found.noise), axis=1))}
    root = root_of(covariance)
    pushed = found.by_parameter @ root
    for quantity in physical_quantities(posor):
        own = root[list(quantity.parameters)]
        if np.any(own):
            # Of the deviates behind all parameters, those that the quantity tells: what they do to the freedoms.
            _, sizes, right = np.linalg.svd(
                own / np.linalg.norm(own, axis=1, keepdims=True).clip(TINY), full_matrices=False
            )
            told = right[sizes > TOLD * sizes[0]]
            gains[quantity.name] = np.linalg.norm(pushed @ told.T, axis=1)
    return gains


def _of_one(told: Told) -> list[Finding]:
    name, numbers, fresh = told.plant.name, told.numbers, told.fresh
    inside = sum(number.inside for number in numbers)
    worst = max(numbers, key=lambda number: abs(number.pull))
    limit = float(norm.isf(0.5 * CHANCE / len(numbers)))
    fits = [(bag.step.name, what, fit) for bag in told.bagged for what, fit in bag.outcome.fits.items()]
    step, what, least = min(fits, key=lambda one: one[2].probability)
    known = np.isfinite(fresh.normalised)
    ratio = np.sqrt(np.nanmean(np.square(fresh.errors), axis=0) / np.nanmean(np.square(fresh.sigmas), axis=0))
    gain = np.sqrt(np.nanmean(np.square(fresh.before), axis=0) / np.nanmean(np.square(fresh.errors), axis=0))
    return [
        Finding(
            f"{name}: numbers of the file within their 95 % interval",
            f"{inside} of {len(numbers)}, {100.0 * inside / len(numbers):.1f} %",
            "95 %",
            "",
            "this campaign, truth known",
            Verdict.SHOWN,
            "one campaign; how often the intervals hold is the campaigns' to say",
        ),
        Finding(
            f"{name}: number furthest from its truth",
            f"{abs(worst.pull):.2f} sigmas, {worst.name}",
            "",
            f"at most {limit:.2f}",
            "this campaign, truth known",
            Verdict.of(holds=abs(worst.pull) <= limit),
            f"a sound campaign fails with a probability of {CHANCE:g}",
        ),
        Finding(
            f"{name}: least probable fit",
            f"chi-square of probability {least.probability:.2g}, {step}, {what}",
            "",
            f"at least {CHANCE / len(fits):.1g}",
            f"{len(fits)} fits",
            Verdict.of(holds=least.probability >= CHANCE / len(fits)),
        ),
        Finding(
            f"{name}: errors at {int(known.sum())} fresh poses over the budget, root mean square",
            ", ".join(f"{freedom} {value:.2f}" for freedom, value in zip(FREEDOMS, ratio, strict=True)),
            "1 on average",
            f"at most {OVER_BUDGET:g}",
            "first-order budget, JCGM 100",
            Verdict.of(holds=bool(np.all(ratio <= OVER_BUDGET))),
            f"{100.0 * np.mean(fresh.normalised[known] <= REGION_LIMIT):.0f} % within the 95 % region of all six",
        ),
        Finding(
            f"{name}: errors as built over errors calibrated",
            ", ".join(f"{freedom} {value:.0f}" for freedom, value in zip(FREEDOMS, gain, strict=True)),
            "",
            "more than 1",
            "the same fresh poses",
            Verdict.of(holds=bool(np.all(gain > 1.0))),
        ),
    ]


def _of_many(coverage: Coverage) -> list[Finding]:
    name, low, high = coverage.name, *CLAIM
    pooled, poses = coverage.pooled, coverage.fresh_inside
    chance = spare(pooled, coverage.campaigns, len(coverage.by_number))
    below = spare(poses, coverage.campaigns, FRESH)
    return [
        Finding(
            f"{name}: within their 95 % interval, all numbers of {coverage.campaigns} campaigns",
            f"{100.0 * pooled.value:.2f} % +- {100.0 * pooled.sigma:.2f} %",
            "95 %",
            f"{100.0 * low:g} % to {100.0 * high:g} %, give or take {100.0 * chance:.1f} % by chance",
            f"{coverage.campaigns} seeded campaigns",
            Verdict.of(holds=low - chance <= pooled.value <= high + chance and not coverage.refused),
            "; ".join(coverage.refused[:3]),
        ),
        Finding(
            f"{name}: number whose intervals hold least probably so often",
            f"probability {coverage.least_probable:.2g} (Bonferroni), smallest part "
            f"{100.0 * min(coverage.by_number.values()):.1f} %",
            f"95 % of right intervals give {100.0 * coverage.band[0]:.1f} % to {100.0 * coverage.band[1]:.1f} %",
            f"at least {CHANCE:g}",
            "binomial",
            Verdict.of(holds=coverage.least_probable >= CHANCE),
            f"{coverage.within_claim[0]} of {len(coverage.by_number)} numbers have 95 +- 3 %; right intervals: "
            f"{coverage.within_claim[1]:.0f}",
        ),
        Finding(
            f"{name}: fresh poses within the budget's 95 % region",
            f"{100.0 * poses.value:.1f} % +- {100.0 * poses.sigma:.1f} %",
            "95 %",
            f"at least {100.0 * low:g} %, less {100.0 * below:.1f} % by chance",
            f"{coverage.campaigns} seeded campaigns",
            Verdict.of(holds=poses.value + below >= low),
            f"normalised error squared {coverage.fresh_normalised.value:.2f} +- {coverage.fresh_normalised.sigma:.2f}, "
            "6 where the budget is right",
        ),
    ]
