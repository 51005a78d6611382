# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Control charts of an arm's parts over its health tests: Shewhart and EWMA, each part tested as if it alone changed.

The mean of the first tests is the reference. Charted is the generalised likelihood ratio of a change of each part, in a
sound arm chi-square of its observed freedoms: of the present test (Shewhart), and of the exponentially weighted mean of
all tests (EWMA; both together: Lucas and Saccucci, Technometrics 32, 1990). A sound arm has the noise of its readings
and seats, new in each test, and is anywhere within the uncertainties that its files state. The limits share one
probability of a false alarm in a test between all charts (Bonferroni): n tests give an alarm with at most n times it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.errors import FitError
from scipy.special import chdtri

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

    from posor_calibration.health.health_model import HealthModel, Part
    from posor_calibration.health.health_test import HealthTest

WEIGHTS = {"present test": 1.0, "EWMA": 0.2}
"""Charts, and the weight of the newest test in each."""
REFERENCE_TESTS = 3
FALSE_ALARM = 1e-5  # in a test of a sound arm: one in 8,000 years of monthly tests
LARGEST, HIDDEN = 1e-3, 0.1
"""Standard uncertainty [m], [rad] beyond which a direction is not observed; its part of an axis that is then hidden."""
AS_LIKELY = 9.0  # difference of the statistic up to which another part explains the tests as well


@dataclass(frozen=True)
class HealthChart:
    """Charts of p parts over t tests after the reference tests."""

    parts: Sequence[Part]
    stamps_ns: IntArray  # of all tests, reference tests first
    reference: int  # number of reference tests
    ratios: FloatArray  # statistic over its limit, the greater of both charts; above 1: alarm, (t, p)
    excess: FloatArray  # statistic less its limit, the greater of both, (t, p)
    drifts: Sequence[FloatArray]  # of each part alone, from the reference, by each test alone, (t, k)
    sigmas: Sequence[FloatArray]  # their standard uncertainties, (t, k); infinite: not observed

    @property
    def alarms(self) -> IntArray:
        """Numbers of the tests with an alarm, counted from the first test after the reference."""
        return np.flatnonzero((self.ratios > 1.0).any(axis=1))

    @property
    def suspects(self) -> list[int]:
        """Parts that explain the last test, the likeliest first; empty: no alarm."""
        return self.suspects_at(-1)

    def suspects_at(self, test: int) -> list[int]:
        """Return the parts that explain a test, the likeliest first; empty: the test gives no alarm."""
        excess = self.excess[test]
        order = np.argsort(-excess, kind="stable")
        return [int(p) for p in order if excess[p] > max(0.0, excess[order[0]] - AS_LIKELY)]


def chart_tests(
    model: HealthModel, tests: Sequence[HealthTest], reference: int = REFERENCE_TESTS, false_alarm: float = FALSE_ALARM
) -> HealthChart:
    """Return the charts of all tests, in their order; the first ones are the reference.

    Raises FitError: the tests observe no axis of a part.
    """
    values = np.array([model.observe(test) for test in tests])
    mean = values[:reference].mean(axis=0)
    of_mean = np.sum([model.noise(test) for test in tests[:reference]], axis=0) / reference**2
    stated = (1.0 + 1.0 / reference) * model.stated @ model.stated.T
    columns = np.hstack([part.columns for part in model.parts])
    ends = np.cumsum([len(part.axes) for part in model.parts])
    spans = [slice(end - len(part.axes), end) for end, part in zip(ends, model.parts, strict=True)]
    tail = false_alarm / (len(model.parts) * len(WEIGHTS))
    shape = len(WEIGHTS), len(tests) - reference, len(model.parts)
    statistics, limits = np.zeros(shape), np.zeros(shape)
    drifts = [np.zeros((shape[1], len(part.axes))) for part in model.parts]
    sigmas = [np.zeros((shape[1], len(part.axes))) for part in model.parts]
    for w, weight in enumerate(WEIGHTS.values()):
        total, state, noise = 0.0, np.zeros_like(mean), np.zeros_like(of_mean)
        for t, test in enumerate(tests[reference:]):
            state = (1.0 - weight) * state + weight * (values[reference + t] - mean)
            noise = (1.0 - weight) ** 2 * noise + weight**2 * model.noise(test)
            total = (1.0 - weight) * total + weight
            covariance = noise / total**2 + of_mean + stated
            solved = np.linalg.solve(covariance, np.column_stack([columns, state / total]))
            information, projected = columns.T @ solved[:, :-1], columns.T @ solved[:, -1]
            for p, own in enumerate(spans):
                known, root = observed_axes(information[own, own])
                found = root.T @ projected[own]
                statistics[w, t, p] = found @ found
                limits[w, t, p] = chdtri(root.shape[1], tail) if root.size else 0.0
                if weight == 1.0:
                    drifts[p][t] = root @ found
                    sigmas[p][t] = np.where(known, np.linalg.norm(root, axis=1), np.inf)
    stamps_ns = np.array([test.stamp_ns for test in tests])
    if not limits.all():
        part = model.parts[int(np.argmin(limits.min(axis=(0, 1))))].name
        raise FitError(
            f"the tests observe no change of {part} below {LARGEST:g} m or rad",
            where="the uncertainties and dwells of the tests",
            expected="uncertainties in metres, and dwells in which each part moves",
        )
    ratios, excess = (statistics / limits).max(axis=0), (statistics - limits).max(axis=0)
    return HealthChart(model.parts, stamps_ns, reference, ratios, excess, drifts, sigmas)


def observed_axes(information: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Return which axes of a part are observed, (k,), and a root of the covariance of what is observed, (k, rank)."""
    values, vectors = np.linalg.eigh(information)
    seen = values > 1.0 / LARGEST**2
    hidden = np.linalg.norm(vectors[:, ~seen], axis=1)
    return hidden < HIDDEN, vectors[:, seen] / np.sqrt(values[seen])
