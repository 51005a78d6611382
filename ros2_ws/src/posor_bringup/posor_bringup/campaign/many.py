"""Many campaigns in several processes, and whether the stated intervals hold over them."""

from __future__ import annotations

import multiprocessing
import os
import signal
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor_estimator.errors import PosorError
from scipy.stats import beta, binom, binomtest, chi2, t

from posor_bringup.arm_coverage import Figure
from posor_bringup.campaign.campaign import run_campaign
from posor_bringup.campaign.fresh import fresh_poses
from posor_bringup.campaign.judged import WITHIN_95, judged
from posor_bringup.campaign.plant import Plant

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor_bringup.campaign.judged import Judged
    from posor_bringup.campaign.plant import PosorName

FRESH = 20
"""Poses of each campaign at which the calibrated POSOR is checked."""
REGION_LIMIT = float(chi2.ppf(0.95, 6))
ROOT_MEAN_SQUARES = ("errors", "sigmas", "before", "still_errors", "still_sigmas")
"""What is told of the fresh poses by its root mean square for each freedom."""
CLAIM = (0.92, 0.98)
"""Where the part of the campaigns whose interval holds the truth is to be."""


@dataclass(frozen=True)
class One:
    """What came of one campaign.

    Attributes:
        seed: It was drawn with.
        refused: What a procedure said, empty where all went through.
        claims: What each procedure found and stated, by the time it did.
        found: What the file says at the end.
        inside: Part of the fresh poses whose error is within the 95 % region of the budget.
        normalised: Mean normalised error squared of the fresh poses; 6 where the budget is right.
        errors: Root mean square of the errors of the calibrated POSOR, (6,).
        sigmas: The same of its budget, (6,).
        before: The same of the POSOR as built, (6,).
        still_inside: Part of the errors without noise that are within 95 % by the calibration's part of the budget.
        still_errors: Their root mean square, (6,).
        still_sigmas: The same of that part of the budget, (6,).

    """

    seed: int
    refused: str
    claims: tuple[Judged, ...] = ()
    found: tuple[Judged, ...] = ()
    inside: float = 0.0
    normalised: float = np.nan
    errors: tuple[float, ...] = ()
    sigmas: tuple[float, ...] = ()
    before: tuple[float, ...] = ()
    still_inside: float = 0.0
    still_errors: tuple[float, ...] = ()
    still_sigmas: tuple[float, ...] = ()


def one_campaign(name: PosorName, seed: int) -> One:
    """Run one campaign and judge it."""
    plant = Plant.drawn(name, seed)
    claims: list[Judged] = []
    calibration = plant.known
    try:
        for done in run_campaign(plant):
            calibration = done.calibration
            claims += judged(plant, calibration, last=True)
    except PosorError as error:
        return One(seed, str(error))
    fresh = fresh_poses(plant, calibration, FRESH)
    known = fresh.known
    return One(
        seed=seed,
        refused="",
        claims=tuple(claims),
        found=tuple(judged(plant, calibration)),
        inside=float(np.mean(fresh.normalised[known] <= REGION_LIMIT)),
        normalised=float(np.mean(fresh.normalised[known])),
        still_inside=float(np.mean(np.abs(fresh.still_errors[known]) < WITHIN_95 * fresh.still_sigmas[known])),
        **{
            what: tuple(np.sqrt(np.nanmean(np.square(getattr(fresh, what)), axis=0)).tolist())
            for what in ROOT_MEAN_SQUARES
        },
    )


def many_campaigns(
    name: PosorName, seeds: Sequence[int], *, workers: int = 0, on_done: Callable[[], None] = lambda: None
) -> list[One]:
    """Run campaigns in several processes.

    Args:
        name: Of the POSOR.
        seeds: One for each campaign; the result does not depend on the number of processes.
        workers: Processes; 0: as many as there are processors.
        on_done: Called after each; what it raises ends the run.

    """
    # Read when a worker loads numpy: its threads and the other worker's would only wait for one another.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    pool = ProcessPoolExecutor(
        workers or os.cpu_count(), mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker
    )
    done = []
    try:
        for one in pool.map(_work, [(name, seed) for seed in seeds]):
            done.append(one)
            on_done()
    finally:
        pool.shutdown(cancel_futures=True)
    return done


def _start_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the main program ends the workers


def _work(what: tuple[PosorName, int]) -> One:
    return one_campaign(*what)


@dataclass(frozen=True)
class Family:
    """How often the intervals of some numbers hold the truth.

    Attributes:
        name: What they are.
        numbers: How many of them there are in a campaign.
        inside: Part of them within, over the campaigns, with its standard uncertainty: the numbers of one campaign are
            not independent of one another.
        interval: Where that part is with 95 % probability, see ``interval_of``.
        worst: The number with the smallest part within, and that part.

    """

    name: str
    numbers: int
    inside: Figure
    interval: tuple[float, float]
    worst: tuple[str, float]


@dataclass(frozen=True)
class Coverage:
    """What many campaigns say.

    Attributes:
        name: Of the POSOR.
        campaigns: How many went through.
        refused: What was said of those that did not.
        pooled: Part of all numbers within their stated 95 % interval.
        families: By family, in the file at the end.
        claims: By procedure and family, when the procedure stated them.
        by_number: Part of the campaigns in which each number was within.
        band: Where a number's part is, with 95 % probability, if its intervals are right (binomial).
        within_claim: How many numbers have a part within ``CLAIM``, and how many would have if all were right.
        least_probable: Probability, times the number of numbers, of the most improbable part (Bonferroni).
        fresh_inside: Part of fresh poses within the budget's 95 % region.
        fresh_normalised: Mean normalised error squared, 6 where the budget is right.
        still_inside: Part of the errors without noise within 95 % by the calibration's part of the budget.
        errors: Root mean square of the errors at fresh poses over all campaigns, (6,).
        sigmas: The same of the budgets.
        before: The same of the POSORs as built.
        still_errors: The same of the errors without noise.
        still_sigmas: The same of the calibration's part of the budgets.

    """

    name: PosorName
    campaigns: int
    refused: tuple[str, ...]
    pooled: Figure
    families: tuple[Family, ...]
    claims: tuple[Family, ...]
    by_number: dict[str, float]
    band: tuple[float, float]
    within_claim: tuple[int, float]
    least_probable: float
    fresh_inside: Figure
    fresh_normalised: Figure
    still_inside: Figure
    errors: tuple[float, ...]
    sigmas: tuple[float, ...]
    before: tuple[float, ...]
    still_errors: tuple[float, ...]
    still_sigmas: tuple[float, ...]


def spare(figure: Figure, campaigns: int, each: int) -> float:
    """Return what chance may take away from a part near 95 %, with a probability of one half per cent.

    Args:
        figure: Mean over the campaigns, and its standard uncertainty by their scatter.
        campaigns: How many; of few, the scatter is hardly known (Student).
        each: Cases in each; the scatter is no smaller than if all were independent.

    """
    least = np.sqrt(0.95 * 0.05 / (campaigns * each))
    return float(t.isf(0.005, campaigns - 1) * max(figure.sigma, least))


def interval_of(part: Figure, campaigns: int, each: int) -> tuple[float, float]:
    """Return where a part is with 95 % probability, between 0 and 1.

    That of Clopper and Pearson, of as many independent cases as would scatter as the campaigns do (Korn and Graubard
    1998, Survey Methodology 24, 193 to 201): no fewer than campaigns, no more than cases; where all cases are alike
    there is no scatter to go by, and a campaign counts as one.

    Args:
        part: Mean over the campaigns, and its standard uncertainty by their scatter.
        campaigns: How many, two at least.
        each: Cases in each.

    """
    mean, cases = part.value, float(campaigns)
    if part.sigma > 0.0:
        few = (t.ppf(0.975, campaigns * each - 1) / t.ppf(0.975, campaigns - 1)) ** 2
        cases = float(np.clip(few * mean * (1.0 - mean) / part.sigma**2, campaigns, campaigns * each))
    inside = mean * cases
    low = float(beta.ppf(0.025, inside, cases - inside + 1.0)) if mean > 0.0 else 0.0
    high = float(beta.ppf(0.975, inside + 1.0, cases - inside)) if mean < 1.0 else 1.0
    return low, high


def coverage_of(name: PosorName, ones: Sequence[One]) -> Coverage:
    """Return what campaigns say together; two at least must have gone through."""
    sound = [one for one in ones if not one.refused]
    count = len(sound)
    by_number = _parts([{j.name: j.inside for j in one.found} for one in sound])
    low, high = (k / count for k in binom.interval(0.95, count, 0.95))
    inside = sum(CLAIM[0] <= part <= CLAIM[1] for part in by_number.values())
    least, most = np.ceil(CLAIM[0] * count - 1e-9), np.floor(CLAIM[1] * count + 1e-9)
    expected = len(by_number) * float(binom.cdf(most, count, 0.95) - binom.cdf(least - 1, count, 0.95))
    improbable = min(binomtest(round(part * count), count, 0.95).pvalue for part in by_number.values())
    return Coverage(
        name=name,
        campaigns=count,
        refused=tuple(one.refused for one in ones if one.refused),
        pooled=Figure.of(np.array([np.mean([j.inside for j in one.found]) for one in sound])),
        families=_families([list(one.found) for one in sound], by_procedure=False),
        claims=_families([list(one.claims) for one in sound], by_procedure=True),
        by_number=by_number,
        band=(float(low), float(high)),
        within_claim=(inside, expected),
        least_probable=min(1.0, improbable * len(by_number)),
        fresh_inside=Figure.of(np.array([one.inside for one in sound])),
        fresh_normalised=Figure.of(np.array([one.normalised for one in sound])),
        still_inside=Figure.of(np.array([one.still_inside for one in sound])),
        **{
            what: tuple(np.sqrt(np.mean(np.square([getattr(one, what) for one in sound]), axis=0)).tolist())
            for what in ROOT_MEAN_SQUARES
        },
    )


def _parts(by_campaign: Sequence[dict[str, bool]]) -> dict[str, float]:
    names = dict.fromkeys(name for one in by_campaign for name in one)
    return {name: float(np.mean([one[name] for one in by_campaign if name in one])) for name in names}


def _families(campaigns: Sequence[list[Judged]], *, by_procedure: bool) -> tuple[Family, ...]:
    def called(j: Judged) -> str:
        return f"{j.procedure}: {j.family}" if by_procedure else j.family

    found = []
    for family in dict.fromkeys(called(j) for one in campaigns for j in one):
        members = [{j.name: j.inside for j in one if called(j) == family} for one in campaigns]
        parts = _parts(members)
        worst = min(parts, key=lambda name: parts[name])
        means = np.array([np.mean(list(one.values())) for one in members if one])
        inside = Figure.of(means)
        interval = interval_of(inside, len(means), len(parts))
        found.append(Family(family, len(parts), inside, interval, (worst, parts[worst])))
    return tuple(found)
