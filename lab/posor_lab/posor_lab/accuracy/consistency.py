# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Closure without noise, and consistency of the stated uncertainty: normalised errors, Monte Carlo (JCGM 101).

Closure takes scans of known poses through the estimator and through the closed form of the thesis, equations 5.3 to 5.5
and 5.32. The closed form holds for small angles without tilts, slanting rays and bump profile. Of more than three gap
probes it takes the plane of least squares. Closure is about the inversion alone, exact to the last digits, so its scans
come from the estimator's own model. All other scans obey the independent truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.calibration.calibration_file import Environment
from posor.calibration.designs import BUMPS, DesignName, design
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor.model.native_coordinates import rotation_from_native
from posor.model.reading_rows import GAP, RING, SPOT_X
from posor.numerics.vector import thetas_of
from scipy.special import chdtri

from posor_lab.harness.random_poses import errors_in_parent, readable_poses
from posor_lab.true_scans import TruePosor

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray, IntArray

FREEDOMS = 6
BAND = 0.95
REGION = 0.95
REGION_LIMIT = float(chdtri(FREEDOMS, 1.0 - REGION))
"""Largest normalised error squared inside the published 95 % region of a pose."""
FALSE_ALARM = 1e-12  # probability so small that no scan is excluded because of its residual


@dataclass(frozen=True)
class MeanEstimate:
    """A mean over independent cases, here arms, and its standard uncertainty."""

    value: float
    sigma: float

    @staticmethod
    def of(cases: FloatArray) -> MeanEstimate:
        """Return the mean of cases, (a,)."""
        return MeanEstimate(float(np.mean(cases)), float(np.std(cases, ddof=1) / np.sqrt(len(cases))))


@dataclass(frozen=True)
class Nees:
    """Mean normalised estimation error squared, divided by the number of freedoms, and its band, of 95 % by default."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class MonteCarlo:
    """Ratios of observed to stated standard deviation, each of the freedom with the ratio furthest from 1."""

    random_ratio: float
    systematic_ratio: float


def nees(stack: DesignName, runs: int, seed: int) -> Nees:
    """Return the normalised errors of noisy scans at random poses of a design."""
    random = np.random.default_rng(seed)
    posor = Posor(design(stack), false_alarm=FALSE_ALARM)
    rotations, translations = readable_poses(posor, stack, runs, random)
    scans = TruePosor(posor.calibration).scans_at(
        posor.stack, rotations, translations, np.arange(runs, dtype=np.int64), noise=random
    )
    found = posor.estimate_each(scans, thetas_of(rotations))
    known = np.isfinite(found.thetas)  # noise can push a reading at the rim out of its calibrated range
    errors = errors_in_parent(found.rotations[known], found.translations[known], rotations[known], translations[known])
    return normalised(errors, found.covariances_random[known])


def normalised(errors: FloatArray, covariances: FloatArray, band: float = BAND) -> Nees:
    """Return the mean normalised error squared of errors (n, 6) with stated covariances (n, 6, 6)."""
    count = FREEDOMS * len(errors)
    low, high = (float(chdtri(count, p)) / count for p in (0.5 + 0.5 * band, 0.5 - 0.5 * band))
    return Nees(float(np.sum(normalised_squares(errors, covariances))) / count, low, high)


def normalised_squares(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return e' C^-1 e of errors (n, k) with covariances (n, k, k), (n,)."""
    return np.asarray(np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0]))


class DrawnPosors:
    """POSORs that differ from one calibration as much as it says is uncertain.

    The estimator knows the calibration only, and neither the supply nor the temperature, which deviate from their
    references in the middle of the range.
    """

    def __init__(self, posor: Posor, random: np.random.Generator) -> None:
        self._stack, self._random, self._truth = posor.stack, random, TruePosor(posor.calibration)
        environment = posor.calibration.environment or Environment()
        parts = [environment.supply, environment.temperature]
        self._middles = np.array([0.0 if part is None else np.mean(part.range.array) for part in parts])
        self._spreads = np.array([0.0 if part is None else part.spread.number for part in parts])

    def scans(self, rotations: FloatArray, translations: FloatArray, noise: np.random.Generator | None = None) -> Scans:
        """Return scans without stamps of a new POSOR at n poses, (n, 3, 3), (n, 3); ``noise``: None, no noise."""
        stack, random = self._stack, self._random
        real = stack.with_parameter_values(
            stack.parameter_values + stack.parameter_sigmas * random.normal(size=stack.parameter_sigmas.size)
        )
        count = len(rotations)
        supply, temperature = np.repeat(self._middles + self._spreads * random.normal(size=2), count).reshape(2, count)
        stamps, unknown = np.zeros(count, dtype=np.int64), np.full(count, np.nan)
        scans = self._truth.scans_at(
            real, rotations, translations, stamps, supply_voltages=supply, temperatures=temperature, noise=noise
        )
        return scans.with_fields({"supply_voltages": unknown, "temperatures": unknown})


def _worst_ratio(errors: FloatArray, stated_variances: FloatArray) -> float:
    """Return the root mean square of errors (n, 6) over the stated standard deviations, the ratio furthest from 1."""
    ratios = np.sqrt(np.mean(np.square(errors), axis=0)) / np.sqrt(stated_variances)
    return float(ratios[np.argmax(np.abs(np.log(ratios)))])


def monte_carlo(stack: DesignName, draws: int, seed: int) -> MonteCarlo:
    """Return both ratios at one pose of a design, from ``draws`` draws of the noise and as many of the parameters."""
    random = np.random.default_rng(seed)
    posor = Posor(design(stack), false_alarm=FALSE_ALARM)
    rotation, translation = readable_poses(posor, stack, 1, random)
    rotations, translations = np.repeat(rotation, draws, axis=0), np.repeat(translation, draws, axis=0)
    stamps = np.arange(draws, dtype=np.int64)
    thetas = thetas_of(rotations)
    real = TruePosor(posor.calibration)
    found = posor.estimate_each(real.scans_at(posor.stack, rotations, translations, stamps, noise=random), thetas)
    # What the area of the probes shifts in all scans alike is no noise.
    quiet = posor.estimate_each(real.scans_at(posor.stack, rotation, translation, stamps[:1]), thetas[:1])
    without_noise = np.repeat(quiet.rotations, draws, axis=0), np.repeat(quiet.translations, draws, axis=0)
    errors = errors_in_parent(found.rotations, found.translations, *without_noise)
    random_ratio = _worst_ratio(errors, np.mean(np.diagonal(found.covariances_random, axis1=1, axis2=2), axis=0))

    posors, variances = DrawnPosors(posor, random), np.zeros(FREEDOMS)
    for n in range(draws):
        scans = posors.scans(rotation, translation)
        found = posor.estimate_each(scans, thetas[:1])
        errors[n] = errors_in_parent(found.rotations, found.translations, rotation, translation)[0]
        variances += np.diagonal(found.covariances_systematic[0]) / draws
    return MonteCarlo(random_ratio, _worst_ratio(errors, variances))


@dataclass(frozen=True)
class LargestError:
    """Largest errors over all poses; infinite if a pose was not found."""

    translation_m: float
    rotation_rad: float


def _largest(errors: FloatArray) -> LargestError:
    return LargestError(*(float(np.max(np.linalg.norm(part, axis=1))) for part in (errors[:, :3], errors[:, 3:])))


def closure(stack: DesignName, count: int, seed: int) -> tuple[LargestError, LargestError]:
    """Return the largest error of the estimator and of the closed form over random poses of a design."""
    random = np.random.default_rng(seed)
    posor = Posor(design(stack))
    rotations, translations = readable_poses(posor, stack, count, random)
    scans = scans_at(posor.stack, rotations, translations, np.arange(count, dtype=np.int64))
    thetas = thetas_of(rotations)
    bumps = [sensor.bump_angle for sensor in posor.calibration.sensors if sensor.bump_angle > 0.0]
    estimates = posor.estimate_each(scans, bumps[0] * np.round(thetas / bumps[0]) if bumps else None)
    if np.any(estimates.states != State.OK):
        exact = LargestError(math.inf, math.inf)
    else:
        exact = _largest(errors_in_parent(estimates.rotations, estimates.translations, rotations, translations))
    readings, reading_rows = posor.stack.linearise(scans), posor.stack.reading_rows
    poses = [
        _closed_form(reading_rows[rows], values, theta)
        for rows, values, theta in zip(readings.selected, readings.values, thetas, strict=True)
    ]
    found_rotations, found_translations = (np.array(part) for part in zip(*poses, strict=True))
    return exact, _largest(errors_in_parent(found_rotations, found_translations, rotations, translations))


def _closed_form(rows: NDArray[np.void], readings: FloatArray, known_theta: float) -> tuple[FloatArray, FloatArray]:
    """Return R_R_T (3, 3) and the origin of T in R (3,) [m] of rows and linearised readings [m], (m,), of one scan."""
    kinds = rows["kind"]
    tips = rows["tip"][kinds == GAP]
    plane = np.column_stack([np.ones(len(tips)), tips[:, 1], -tips[:, 0]])
    (gap, tan_alpha, tan_beta), *_ = np.linalg.lstsq(plane, readings[kinds == GAP])
    alpha, beta = math.atan(tan_alpha), math.atan(tan_beta)
    if np.any(kinds == RING):
        x, y, theta = _solve_ring(rows[kinds == RING], readings[kinds == RING], known_theta)
    else:
        x, y, theta = _solve_spots(rows, readings, np.flatnonzero(kinds == SPOT_X))
    return rotation_from_native(alpha, beta, theta), np.array([x, y, gap])


def _solve_spots(rows: NDArray[np.void], readings: FloatArray, spots: IntArray) -> tuple[float, float, float]:
    seen = rows["diode_origin"][spots, :2] + np.column_stack([readings[spots], readings[spots + 1]])
    sources = rows["source_origin"][spots, :2]
    along, before = seen[0] - seen[1], sources[0] - sources[1]
    theta = math.atan2(along[1], along[0]) - math.atan2(before[1], before[0])
    theta = math.remainder(theta, 2.0 * math.pi)
    turn = np.array([[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]])
    x, y = np.mean(seen - sources @ turn.T, axis=0)
    return float(x), float(y), theta


def _solve_ring(rows: NDArray[np.void], gaps: FloatArray, known_theta: float) -> tuple[float, float, float]:
    # Opposite probes are in phase, the two pairs in quadrature: sums contain theta, differences the runout.
    middle = math.hypot(*rows["tip"][0, :2]) - rows["mean_radius"][0]
    phase = math.atan2(middle - 0.5 * (gaps[1] + gaps[3]), middle - 0.5 * (gaps[0] + gaps[2]))
    theta = known_theta + math.remainder(phase - BUMPS * known_theta, 2.0 * math.pi) / BUMPS
    return 0.5 * (gaps[2] - gaps[0]), 0.5 * (gaps[3] - gaps[1]), theta
