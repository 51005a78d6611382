"""Everything that a demo of calibration has to tell of one POSOR."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor_estimator.core.budget.first_order import error_budget, sensitivities
from posor_estimator.core.budget.poses import middle_pose, scan_at
from posor_estimator.core.budget.quantities import physical_quantities
from posor_estimator.core.posor import Posor
from scipy.stats import norm

from posor_bringup.campaign.fresh import FREEDOMS, fresh_poses
from posor_bringup.campaign.judged import judged
from posor_bringup.campaign.many import CLAIM, FRESH, REGION_LIMIT, interval_of, spare
from posor_bringup.findings import Finding, Findings, Verdict

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_estimator.core.budget.first_order import ErrorBudget
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

    from posor_bringup.arm_coverage import Figure
    from posor_bringup.campaign.bagged import Bagged
    from posor_bringup.campaign.fresh import Fresh
    from posor_bringup.campaign.judged import Judged
    from posor_bringup.campaign.many import Coverage
    from posor_bringup.campaign.plant import Plant

POSES = 40
"""Fresh poses at which the calibrated POSOR of the demo is checked."""
CHANCE = 1e-3
"""Probability with which a sound campaign may fail a finding."""
TINY = 1e-300
TOLD = 1e-9
"""Of the largest singular value: a smaller one comes from rounding."""
OVER_BUDGET, STILL_OVER_BUDGET = 2.0, 4.0
"""Root mean square error over the budget, that a sound campaign hardly exceeds: with noise, and without, where the
errors of all poses are common."""


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
        common: What the calibration leaves open of each freedom there, without noise [m, rad], (6,).
        coverage: Of many campaigns; None: none were run.

    """

    plant: Plant
    bagged: list[Bagged]
    numbers: list[Judged]
    fresh: Fresh
    budget: ErrorBudget
    gains: Mapping[str, FloatArray]
    common: FloatArray
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
        scan = scan_at(posor, pose)
        pushed = sensitivities(posor, scan, pose).by_parameter @ posor.parameter_root
        return Told(
            plant=plant,
            bagged=bagged,
            numbers=judged(plant, calibration),
            fresh=fresh_poses(plant, calibration, POSES),
            budget=error_budget(posor, scan, pose),
            gains=_gains(posor, pushed, posor.parameter_root),
            common=np.linalg.norm(pushed, axis=1),
            coverage=coverage,
        )

    @property
    def calibration(self) -> Calibration:
        """What is known in the end."""
        return self.bagged[-1].calibration

    @property
    def findings(self) -> Findings:
        """What was found, and whether it holds."""
        many = [] if self.coverage is None else findings_of_many(self.coverage)
        return Findings((*_of_one(self), *many))


def _gains(posor: Posor, pushed: FloatArray, root: FloatArray) -> dict[str, FloatArray]:
    """Return what knowing each quantity exactly would take away, see ``Told.gains``.

    Args:
        posor: The POSOR.
        pushed: d(freedom)/d(standard deviate behind the parameters), (6, r).
        root: d(parameter)/d(standard deviate), (p, r).

    """
    gains = {}
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


def holds(all_told: Sequence[Told]) -> bool:
    """Return whether everything holds."""
    return all(told.findings.holds for told in all_told)


def _of_one(told: Told) -> list[Finding]:
    name, numbers, fresh = told.plant.name, told.numbers, told.fresh
    inside = sum(number.inside for number in numbers)
    worst = max(numbers, key=lambda number: abs(number.pull))
    limit = float(norm.isf(0.5 * CHANCE / len(numbers)))
    fits = [(bag.step.name, what, fit) for bag in told.bagged for what, fit in bag.outcome.fits.items()]
    step, what, least = min(fits, key=lambda one: one[2].probability)
    known = fresh.known
    ratio = _ratio(fresh.errors, fresh.sigmas)
    still = _ratio(fresh.still_errors, fresh.still_sigmas)
    gain = _ratio(fresh.before, fresh.errors)
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
            _each(ratio, 2),
            "1 on average",
            f"at most {OVER_BUDGET:g}",
            "first-order budget, JCGM 100",
            Verdict.of(holds=bool(np.all(ratio <= OVER_BUDGET))),
            f"{100.0 * np.mean(fresh.normalised[known] <= REGION_LIMIT):.0f} % within the 95 % region of all six",
        ),
        Finding(
            f"{name}: the same of scans without noise over the calibration's part of the budget",
            _each(still, 2),
            "1 on average",
            f"at most {STILL_OVER_BUDGET:g}",
            "first-order budget, JCGM 100",
            Verdict.of(holds=bool(np.all(still <= STILL_OVER_BUDGET))),
            "the poses have one calibration in common, so one campaign says little",
        ),
        Finding(
            f"{name}: errors as built over errors calibrated",
            _each(gain, 0),
            "",
            "more than 1",
            "the same fresh poses",
            Verdict.of(holds=bool(np.all(gain > 1.0))),
        ),
    ]


def _ratio(over: FloatArray, under: FloatArray) -> FloatArray:
    """Return the ratio of the root mean squares over the poses, (6,)."""
    return np.asarray(np.sqrt(np.nanmean(np.square(over), axis=0) / np.nanmean(np.square(under), axis=0)))


def _each(values: FloatArray | Sequence[float], digits: int) -> str:
    return ", ".join(f"{freedom} {value:.{digits}f}" for freedom, value in zip(FREEDOMS, values, strict=True))


def _part(part: Figure, campaigns: int, each: int, digits: int = 1) -> str:
    """Return a part in percent with its uncertainty; where all cases are alike no scatter tells it."""
    said = f"{100.0 * part.value:.{digits}f} %"
    if part.sigma > 0.0:
        return f"{said} +- {100.0 * part.sigma:.{digits}f} %"
    low, high = interval_of(part, campaigns, each)
    return f"{said}, between {100.0 * low:.0f} % and {100.0 * high:.0f} %"


def findings_of_many(coverage: Coverage) -> list[Finding]:
    """Return what many campaigns say, and whether it holds."""
    name, low, high = coverage.name, *CLAIM
    pooled, poses = coverage.pooled, coverage.fresh_inside
    still, count = coverage.still_inside, coverage.campaigns
    chance = spare(pooled, count, len(coverage.by_number))
    below, still_below = (spare(poses, count, FRESH), spare(still, count, len(FREEDOMS)))
    return [
        Finding(
            f"{name}: within their 95 % interval, all numbers of {coverage.campaigns} campaigns",
            _part(pooled, count, len(coverage.by_number), 2),
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
            _part(poses, count, FRESH),
            "95 %",
            f"at least {100.0 * low:g} %, less {100.0 * below:.1f} % by chance",
            f"{coverage.campaigns} seeded campaigns",
            Verdict.of(holds=poses.value + below >= low),
            f"normalised error squared {coverage.fresh_normalised.value:.2f} +- {coverage.fresh_normalised.sigma:.2f}, "
            "6 where the budget is right",
        ),
        Finding(
            f"{name}: errors of scans without noise within 95 % by the calibration's part of the budget",
            _part(still, count, FRESH * len(FREEDOMS)),
            "95 %",
            f"at least {100.0 * low:g} %, less {100.0 * still_below:.1f} % by chance",
            f"{count} seeded campaigns",
            Verdict.of(holds=still.value + still_below >= low),
            f"root mean square over the budget: {_each(np.divide(coverage.still_errors, coverage.still_sigmas), 2)}",
        ),
    ]
