# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Why a requirement cannot be met, and the nearest one that can: the refusal of ``posor design posor``.

If layouts fit between the diameters but are too uncertain, the uncertainties beyond their reach are raised to what the
best layout achieves. If no layout fits, each entry of the range and each diameter is relaxed alone, and the one that
has to change least is the binding constraint. The nearest requirement is searched before it is proposed.
"""

from __future__ import annotations

import math
from itertools import product
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple, NoReturn

import numpy as np
import pinocchio as pin
from posor.errors import DesignError
from posor.estimation.posor import Posor
from posor.reporting.progress import progress_display
from posor.uncertainty.budget_poses import scan_at
from posor.uncertainty.budget_quantities import NATIVE
from posor.uncertainty.first_order import error_budget

from posor_design.layout_evaluation import evaluate, extreme_poses
from posor_design.layout_geometry import arrange, layout_kinds
from posor_design.layout_search import RESERVE, START, LayoutSearch, ratios
from posor_design.quantity_text import format_quantity
from posor_design.requirement import FREEDOMS, OPTIONS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from posor_design.layout_evaluation import Candidate
    from posor_design.layout_search import Preference, SearchResult
    from posor_design.requirement import Requirement

SLACK = 1.01
"""By how much more than necessary a requirement is relaxed; the excess grows fourfold until a search succeeds."""
ATTEMPTS = 4
LARGEST_FACTOR = 64.0  # largest change of an entry that is tried
STEPS = 7  # bisections of such a change
EXCESSES = (0.0, *(0.01 * 2.0**n for n in range(8)))
"""By how much more than the least change a value is relaxed until it is accepted; then quarters of the last step."""
_UNITS = dict(NATIVE)
_FAULT = "minimum_detectable_fault"


class Relaxation(NamedTuple):
    """An entry of a requirement that can be relaxed: its name, its unit, and whether a larger value is easier."""

    name: str
    unit: str
    larger: bool

    def value(self, requirement: Requirement) -> float:
        """Return the present value."""
        return float(attrgetter(self.name)(requirement).number)

    def changed(self, requirement: Requirement, value: float) -> Requirement:
        """Return the requirement with another value."""
        part, _, key = self.name.rpartition(".")
        return requirement.changed(**({part: {key: value}} if part else {key: value}))


RELAXATIONS = tuple(
    Relaxation(option.entry, option.unit, larger=option.entry == "outside_diameter")
    for option in OPTIONS.values()
    if option.entry and option.entry not in {"scan_rate", "target_tilt", _FAULT}
)


def search_layouts(
    requirements: Mapping[str, Requirement], preference: Preference = "electronics"
) -> dict[str, tuple[SearchResult, Candidate]]:
    """Return result and chosen layout of each requirement by its name; a terminal shows the progress.

    Raises DesignError: a requirement cannot be met.
    """
    found = {}
    with progress_display() as progress:
        for name, requirement in requirements.items():
            step = progress.add(name, 1.0)
            result = LayoutSearch(requirement, step.set).run(preference)
            if result.chosen is None:
                refuse(result, step.set)
            found[name] = result, result.chosen
    return found


def refuse(result: SearchResult, progress: Callable[[float], object] = lambda _share: None) -> NoReturn:
    """Raise the error of a requirement that a search could not meet.

    Raises DesignError: always; it names the binding constraint and the nearest requirement that can be met.
    """
    where = f"requirement '{result.requirement.name}'"
    if result.best is None:
        _refuse_geometry(result.requirement, where)
    _refuse_uncertainty(result.requirement, result.best, where, progress)


def _refuse_uncertainty(
    requirement: Requirement, best: Candidate, where: str, progress: Callable[[float], object]
) -> NoReturn:
    used, name = ratios(requirement, best), binding_constraint(requirement, best)
    changes: dict[str, float] = {}
    slack, bound = SLACK, "at least"
    for _ in range(ATTEMPTS):
        changes = _relaxed(requirement, best, slack)
        own = {key: value for key, value in changes.items() if key != _FAULT}
        fault = {_FAULT: changes[_FAULT]} if _FAULT in changes else {}
        if LayoutSearch(requirement.changed(uncertainty=own, **fault), progress).run().chosen is not None:
            break
        slack = 1.0 + 4.0 * (slack - 1.0)
    else:
        bound = "more than"
    if name == _FAULT:
        reached = "no reading of every layout is checked" if math.isinf(best.fault) else _length(best.fault)
        what = f"{_FAULT} {_length(requirement.fault)} is beyond every layout: the best one detects {reached}"
    else:
        i = FREEDOMS.index(name)
        unit, factor = _UNITS[name], requirement.uncertainty.coverage_factor
        asked = format_quantity(getattr(requirement.uncertainty, name).number, unit)
        reached = format_quantity(factor * float(best.sigmas[i]), unit, 3)
        what = (
            f"uncertainty of {name}, {asked}, is beyond every layout within "
            f"{_length(requirement.outside_diameter.number)}: the best one ({best.kind.name}) reaches {reached}, most "
            f"of it due to {largest_contribution(requirement, best, i)}, and keeps {100 * (1 - RESERVE):.0f} % in "
            "reserve"
        )
    ways = ", ".join(f"{key} {format_quantity(value, _UNITS.get(key, 'm'))}" for key, value in changes.items())
    diameter = None if used.fault > 1.0 else _sufficient_diameter(requirement, best)
    larger = "" if diameter is None else f", or outside_diameter {_length(diameter)}"
    raise DesignError(what, where=where, expected=f"{bound} {ways}, all else unchanged{larger}")


def binding_constraint(requirement: Requirement, candidate: Candidate) -> str:
    """Return the name of the freedom, or ``minimum_detectable_fault``, of which a candidate uses most."""
    used = ratios(requirement, candidate)
    return _FAULT if used.fault >= np.max(used.freedoms) else FREEDOMS[int(np.argmax(used.freedoms))]


def largest_contribution(requirement: Requirement, candidate: Candidate, freedom: int) -> str:
    """Return the input that contributes most to a freedom in the middle of the range, from the error budget."""
    posor = Posor(candidate.layout.calibration(requirement))
    poses = extreme_poses(requirement, candidate.layout.gap)
    pose = pin.SE3(poses.rotations[-1], poses.translations[-1])
    budget = error_budget(posor, scan_at(posor, pose), pose)
    return max(budget.contributions, key=lambda part: float(part.effects[freedom])).name


def _relaxed(requirement: Requirement, best: Candidate, slack: float) -> dict[str, float]:
    """Return the entries that are beyond the best layout, raised to what it reaches."""
    used, factor = ratios(requirement, best), requirement.uncertainty.coverage_factor
    changes = {
        name: _rounded(slack * factor * float(sigma) / RESERVE)
        for name, sigma, ratio in zip(FREEDOMS, best.sigmas, used.freedoms, strict=True)
        if ratio > 1.0
    }
    if used.fault > 1.0:
        changes[_FAULT] = _rounded(slack * best.fault)
    return changes or {name: _rounded(slack * getattr(requirement.uncertainty, name).number) for name in FREEDOMS}


def _sufficient_diameter(requirement: Requirement, best: Candidate) -> float | None:
    """Return the outside diameter at which the kind of the best layout meets the requirement; None: none is found."""
    entry = RELAXATIONS[0]

    def sufficient(larger: Requirement) -> bool:
        search = LayoutSearch(larger)
        candidate = search.candidate(best.kind, larger.outside_diameter.number, START[1])
        return candidate is not None and ratios(larger, candidate).worst <= 1.0

    factor = _least_factor(requirement, entry, sufficient, 8.0)
    return None if factor is None else _verified(requirement, entry, factor, sufficient)


def _refuse_geometry(requirement: Requirement, where: str) -> NoReturn:
    found = {}
    for entry in RELAXATIONS:
        if entry.value(requirement) > 0.0:
            factor = _least_factor(requirement, entry, _usable, LARGEST_FACTOR)
            if factor is not None:
                found[entry] = factor
    if not found:
        expected = "a larger outside diameter and a smaller range"
        raise DesignError("no layout fits, whichever single entry is relaxed", where=where, expected=expected)
    binding = min(found, key=lambda entry: found[entry])
    value = binding.value(requirement)
    ways = []
    for entry, factor in sorted(found.items(), key=lambda item: item[1]):
        limit, bound = _verified(requirement, entry, factor, _sufficient), "at least" if entry.larger else "at most"
        if limit is None:  # a layout fits, but is too uncertain
            own = entry.value(requirement)
            limit, bound = own * factor if entry.larger else own / factor, "more than" if entry.larger else "less than"
            near = format_quantity(limit, entry.unit, 4)
            ways.append(f"{entry.name} of {bound} {near} with a weaker required uncertainty or fault")
        else:
            ways.append(f"{entry.name} of {bound} {format_quantity(limit, entry.unit)}")
    what = f"{binding.name} {format_quantity(value, binding.unit)}: no layout fits with this range of motion"
    raise DesignError(what, where=where, expected=f"{' or '.join(ways)}, all else unchanged")


def _least_factor(
    requirement: Requirement, entry: Relaxation, accepts: Callable[[Requirement], bool], largest: float
) -> float | None:
    """Return by which factor an entry has to be relaxed at least; None: up to ``largest`` it does not suffice."""

    def relaxed(logarithm: float) -> bool:
        value, factor = entry.value(requirement), math.exp(logarithm)
        return accepts(entry.changed(requirement, value * factor if entry.larger else value / factor))

    low, high, step = 0.0, 0.0, math.log(2.0)
    while not relaxed(high):
        low, high = high, high + step
        if high > math.log(largest) + 1e-9:
            return None
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if relaxed(middle) else (middle, high)
    return math.exp(high)


def _verified(
    requirement: Requirement, entry: Relaxation, factor: float, accepts: Callable[[Requirement], bool]
) -> float | None:
    """Return the value, of three digits, nearest to one relaxed by a factor that is accepted; None: none is found."""
    own, refused = entry.value(requirement), 0.0

    def value(excess: float) -> float:
        relaxed = factor * (1.0 + excess)
        return _rounded(own * relaxed if entry.larger else own / relaxed, up=entry.larger)

    def accepted(excess: float) -> bool:
        return accepts(entry.changed(requirement, value(excess)))

    for excess in EXCESSES:
        if accepted(excess):
            return value(next(float(each) for each in np.linspace(refused, excess, 5)[1:] if accepted(each)))
        refused = excess
    return None


def _sufficient(requirement: Requirement) -> bool:
    """Return whether a layout of the first simplex meets the requirement, with the reserve."""
    search, diameter = LayoutSearch(requirement), requirement.outside_diameter.number
    tried = (search.candidate(kind, diameter, shares) for kind, shares in product(layout_kinds(requirement), START))
    return any(each is not None and ratios(requirement, each).worst <= 1.0 for each in tried)


def _usable(requirement: Requirement) -> bool:
    """Return whether a layout fits and gives a pose everywhere."""
    for kind, shares in product(layout_kinds(requirement), START):
        layout = arrange(requirement, kind, requirement.outside_diameter.number, shares)
        if layout and evaluate(requirement, kind, layout, extreme_poses(requirement, layout.gap)).readable:
            return True
    return False


def _rounded(value: float, *, up: bool = True) -> float:
    """Return three digits, not less than the value, or not more."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 2)
    count = math.ceil(value / digit - 1e-9) if up else math.floor(value / digit + 1e-9)
    return float(f"{count * digit:.12g}")


def _length(value: float) -> str:
    return format_quantity(value, "m", 4)
