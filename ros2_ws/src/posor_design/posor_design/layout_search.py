# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Search for the layouts that meet a requirement, and the choice among them.

The discrete choices are enumerated: sensor for theta, numbers of probes, which ring is outside, noise of the
electronics. For each combination the continuous choices, radius of the ring and size of its parts, are optimised by the
method of Nelder and Mead (``scipy.optimize``) for the smallest ratio of an uncertainty to the required one, at the
smallest noise. The same layouts at smaller diameters and with more noise are further candidates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from scipy.optimize import minimize

from posor_design.layout_evaluation import evaluate, extreme_poses, random_poses, with_noise
from posor_design.layout_geometry import LayoutKind, Shares, arrange, layout_kinds
from posor_design.observable_causes import unobservable_causes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from posor.numerics.array_types import FloatArray

    from posor_design.layout_evaluation import Candidate
    from posor_design.requirement import Requirement

Preference = Literal["electronics", "accuracy", "size", "detectability"]
PREFERENCES: tuple[Preference, ...] = ("electronics", "accuracy", "size", "detectability")
NOISES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # noise of the electronics over the reference that candidates may have
DIAMETERS = (1.0, 0.9, 0.8, 0.7, 0.6)  # outside diameters of candidates over the required one
RESERVE = 0.9  # largest uncertainty of a candidate over the required one
EVALUATIONS = 14  # of the method of Nelder and Mead for each combination
CHECKED_POSES = 300
SEED = 1985
START = (Shares(1.0, 0.0), Shares(1.0, 0.4), Shares(0.8, 0.4))
"""Corners of the first simplex of the method of Nelder and Mead."""
_IMPOSSIBLE = 1e3


class Ratios(NamedTuple):
    """How much of the requirement a candidate uses: uncertainties (6,) and the fault; 1 or less: met."""

    freedoms: FloatArray
    fault: float

    @property
    def worst(self) -> float:
        """The largest."""
        return float(max(np.max(self.freedoms), self.fault))


@dataclass(frozen=True)
class SearchResult:
    """Result of a search."""

    requirement: Requirement  # what was searched for
    # candidate with the smallest worst ratio, of the smallest noise; None: no layout fits the geometry
    best: Candidate | None
    feasible: tuple[Candidate, ...]  # all candidates that meet the requirement
    # those of them that no other one excels in size, accuracy, detectability and noise at once
    trade_off: tuple[Candidate, ...]
    chosen: Candidate | None  # the preferred one, verified at random poses; None: the requirement cannot be met
    evaluations: int  # number of layouts whose uncertainty was computed
    preference: Preference  # what the chosen one is best in
    # names of the causes that no reading of a kind of layout shows
    causes: Mapping[LayoutKind, tuple[str, ...]] = field(default_factory=dict)

    def unobservable(self, candidate: Candidate) -> tuple[str, ...]:
        """Return the names of the causes that no reading of a candidate shows."""
        found = self.causes.get(candidate.kind)
        return unobservable_of(self.requirement, candidate) if found is None else found


def unobservable_of(requirement: Requirement, candidate: Candidate) -> tuple[str, ...]:
    """Return the names of the causes that no reading of a candidate shows."""
    layout = candidate.layout
    return unobservable_causes(layout.calibration(requirement), layout.gap, requirement.rotation)


def ratios(requirement: Requirement, candidate: Candidate) -> Ratios:
    """Return how much of a requirement a candidate uses; the uncertainties include the reserve."""
    if not candidate.readable:
        return Ratios(np.full(6, _IMPOSSIBLE), _IMPOSSIBLE)
    fault = candidate.fault / requirement.fault if math.isfinite(requirement.fault) else 0.0
    return Ratios(candidate.sigmas / (RESERVE * requirement.sigmas), fault)


class LayoutSearch:
    """The search for one requirement; ``progress`` is called after each combination with the share that is done."""

    def __init__(self, requirement: Requirement, progress: Callable[[float], object] = lambda _share: None) -> None:
        self.requirement = requirement
        self.evaluations = 0
        self._causes: dict[LayoutKind, tuple[str, ...]] = {}
        self._progress = progress

    def run(self, preference: Preference = "electronics") -> SearchResult:
        """Return the result; the same for the same requirement."""
        best: Candidate | None = None
        feasible: list[Candidate] = []
        kinds = layout_kinds(self.requirement)
        for number, kind in enumerate(kinds):
            shares, candidate = self.optimised(kind)
            if candidate is not None and candidate.readable:
                best = candidate if best is None else min(best, candidate, key=self._worst)
                found = self._variants(kind, shares, candidate)
                if found:
                    self._causes[kind] = unobservable_of(self.requirement, found[0])
                feasible += found
            self._progress((number + 1) / len(kinds))
        return SearchResult(
            self.requirement,
            best,
            tuple(feasible),
            tuple(trade_off(self.requirement, feasible)),
            self._choose(feasible, preference),
            self.evaluations,
            preference,
            self._causes,
        )

    def optimised(self, kind: LayoutKind) -> tuple[Shares, Candidate | None]:
        """Return the best continuous choices of a kind at the required diameter and the smallest noise."""
        found: dict[Shares, Candidate | None] = {}
        diameter = self.requirement.outside_diameter.number

        def objective(point: FloatArray) -> float:
            shares = Shares(*np.clip(point, 0.0, 1.0).tolist())
            if shares not in found:
                found[shares] = self.candidate(kind, diameter, shares)
            candidate = found[shares]
            return 2.0 * _IMPOSSIBLE if candidate is None else self._worst(candidate)

        if all(arrange(self.requirement, kind, diameter, start) is None for start in START):
            return Shares(), None
        minimize(
            objective,
            (START[0].radius, START[0].size),
            method="Nelder-Mead",
            bounds=((0.0, 1.0), (0.0, 1.0)),
            options={
                "maxfev": EVALUATIONS,
                "initial_simplex": [(start.radius, start.size) for start in START],
                "xatol": 0.01,
                "fatol": 0.002,
            },
        )
        usable = {shares: candidate for shares, candidate in found.items() if candidate is not None}
        if not usable:
            return Shares(), None
        shares = min(usable, key=lambda each: self._worst(usable[each]))
        return shares, usable[shares]

    def candidate(self, kind: LayoutKind, diameter: float, shares: Shares) -> Candidate | None:
        """Return a candidate of the smallest noise; None: its parts do not fit."""
        layout = arrange(self.requirement, kind, diameter, shares)
        if layout is None:
            return None
        self.evaluations += 1
        layout = type(layout)(**{**vars(layout), "noise": NOISES[0]})
        return evaluate(self.requirement, kind, layout, extreme_poses(self.requirement, layout.gap))

    def _worst(self, candidate: Candidate) -> float:
        return ratios(self.requirement, candidate).worst

    def _variants(self, kind: LayoutKind, shares: Shares, largest: Candidate) -> list[Candidate]:
        """Return the feasible candidates of a kind: smaller ones, each with the smallest and the largest noise."""
        found = []
        for share in DIAMETERS:
            diameter = share * self.requirement.outside_diameter.number
            quiet = largest if share == DIAMETERS[0] else self.candidate(kind, diameter, shares)
            if quiet is None or self._worst(quiet) > 1.0:
                continue
            found.append(quiet)
            noise = NOISES[0] * quiet.largest_noise(RESERVE * self.requirement.sigmas)
            for level in reversed([level for level in NOISES[1:] if level <= noise]):
                poses = extreme_poses(self.requirement, quiet.layout.gap)
                self.evaluations += 1
                noisy = with_noise(self.requirement, quiet, level, poses)
                if self._worst(noisy) <= 1.0:
                    found.append(noisy)
                    break
        return found

    def _choose(self, feasible: Sequence[Candidate], preference: Preference) -> Candidate | None:
        """Return the preferred candidate that also meets the requirement at random poses."""
        random = np.random.default_rng(SEED)
        for candidate in sorted(feasible, key=lambda each: self._preference(each, preference)):
            poses = random_poses(self.requirement, candidate.layout.gap, CHECKED_POSES, random)
            self.evaluations += 1
            checked = evaluate(self.requirement, candidate.kind, candidate.layout, poses)
            if checked.readable and np.all(checked.sigmas <= self.requirement.sigmas):
                return candidate
        return None

    def _preference(self, candidate: Candidate, preference: Preference) -> tuple[float, ...]:
        """Return the sort key: fewest unobservable causes, then what is preferred, then the others in their order."""
        own = objectives(self.requirement, candidate)
        order = [preference, *(each for each in PREFERENCES if each != preference)]
        return (len(self._causes[candidate.kind]), *(own[name] for name in order))


def objectives(requirement: Requirement, candidate: Candidate) -> dict[Preference, float]:
    """Return what should be small of a candidate, by preference."""
    return {
        "electronics": -candidate.layout.noise,
        "accuracy": float(np.max(candidate.sigmas / requirement.sigmas)),
        "size": candidate.layout.outside_diameter,
        "detectability": candidate.fault,
    }


def trade_off(requirement: Requirement, candidates: Iterable[Candidate]) -> list[Candidate]:
    """Return the candidates that no other one excels in all objectives (Pareto), by diameter and accuracy."""
    listed = list(candidates)
    values = np.array([list(objectives(requirement, each).values()) for each in listed]).reshape(-1, len(PREFERENCES))
    kept = [
        each
        for each, own in zip(listed, values, strict=True)
        if not np.any(np.all(values <= own, axis=1) & np.any(values < own, axis=1))
    ]
    return sorted(kept, key=lambda own: (own.layout.outside_diameter, float(np.max(own.sigmas / requirement.sigmas))))
