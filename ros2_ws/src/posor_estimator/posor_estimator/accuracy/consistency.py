"""Does the stated uncertainty hold? Normalised errors, and Monte Carlo of both parts of the covariance (JCGM 101)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from posor_estimator.accuracy.poses import errors_in_parent, readable_poses, thetas_of
from posor_estimator.core.designs import DesignName, design
from posor_estimator.core.forward import scans_at
from posor_estimator.core.posor import Posor

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray

FREEDOMS = 6


@dataclass(frozen=True)
class Nees:
    """Mean normalised estimation error squared, over the freedoms, and its 95 % band."""

    mean: float
    low: float
    high: float

    def as_dict(self) -> dict[str, float]:
        """Return the figures by name."""
        return asdict(self)


@dataclass(frozen=True)
class MonteCarlo:
    """Standard deviations found over those stated, the ratio furthest from one of the six freedoms."""

    random_ratio: float
    systematic_ratio: float

    def as_dict(self) -> dict[str, float]:
        """Return the figures by name."""
        return asdict(self)


def normalised_squares(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return ``e' P^-1 e`` of each error e (n, 6) with its covariance P (n, 6, 6), shape (n,)."""
    return np.asarray(np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[:, :, None])[:, :, 0]))


def nees(stack: DesignName, runs: int, seed: int) -> Nees:
    """Return the normalised error of ``runs`` random poses read with noise, whatever their residual."""
    random = np.random.default_rng(seed)
    posor = Posor(design(stack), false_alarm=1e-12)
    rotations, translations = readable_poses(posor, stack, runs, random)
    scans = scans_at(posor.stack, rotations, translations, np.arange(runs, dtype=np.int64), noise=random)
    found = posor.locate_each(scans, thetas_of(rotations))
    known = np.isfinite(found.thetas)  # noise can push a reading at the rim out of its calibrated range
    errors = errors_in_parent(found.rotations[known], found.translations[known], rotations[known], translations[known])
    squared = normalised_squares(errors, found.covariances_random[known])
    count = len(errors)
    low, high = (float(chi2.ppf(p, FREEDOMS * count)) / (FREEDOMS * count) for p in (0.025, 0.975))
    return Nees(float(np.mean(squared)) / FREEDOMS, low, high)


def _furthest(found: FloatArray, stated: FloatArray) -> float:
    ratios = found / stated
    return float(ratios[np.argmax(np.abs(np.log(ratios)))])


def monte_carlo(stack: DesignName, draws: int, seed: int) -> MonteCarlo:
    """Return both ratios at one pose of a design, noise drawn ``draws`` times and parameters as often."""
    random = np.random.default_rng(seed)
    posor = Posor(design(stack), false_alarm=1e-12)
    rotation, translation = readable_poses(posor, stack, 1, random)
    rotations, translations = np.repeat(rotation, draws, axis=0), np.repeat(translation, draws, axis=0)
    stamps = np.arange(draws, dtype=np.int64)
    thetas = thetas_of(rotations)
    noisy = scans_at(posor.stack, rotations, translations, stamps, noise=random)
    found = posor.locate_each(noisy, thetas)
    errors = errors_in_parent(found.rotations, found.translations, rotations, translations)
    stated = np.sqrt(np.mean(np.diagonal(found.covariances_random, axis1=1, axis2=2), axis=0))
    random_ratio = _furthest(np.sqrt(np.mean(np.square(errors), axis=0)), stated)

    values, sigmas = posor.stack.parameter_values, posor.stack.parameter_sigmas
    errors = np.empty((draws, FREEDOMS))
    stated_squared = np.zeros(FREEDOMS)
    for n in range(draws):
        # The real POSOR differs from its calibration; the estimator knows the calibration only.
        real = posor.stack.with_parameter_values(values + sigmas * random.normal(size=sigmas.size))
        scan = scans_at(real, rotations[:1], translations[:1], stamps[:1])
        found = posor.locate_each(scan, thetas[:1])
        errors[n] = errors_in_parent(found.rotations, found.translations, rotations[:1], translations[:1])[0]
        stated_squared += np.diagonal(found.covariances_systematic[0]) / draws
    systematic_ratio = _furthest(np.sqrt(np.mean(np.square(errors), axis=0)), np.sqrt(stated_squared))
    return MonteCarlo(random_ratio, systematic_ratio)
