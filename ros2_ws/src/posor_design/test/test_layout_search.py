# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The search: the requirement is met, the trade-off holds no excelled layout, refusals name the nearest requirement."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from posor.errors import DesignError
from posor_design.layout_evaluation import evaluate, random_poses
from posor_design.layout_geometry import LayoutKind
from posor_design.layout_search import RESERVE, LayoutSearch, SearchResult, objectives, ratios, trade_off
from posor_design.nearest_requirement import binding_constraint, refuse
from posor_design.requirement import Requirement

from .layout_examples import candidate, example

KINDS = (
    LayoutKind("light_ring", 2, 4, gap_outside=True),
    LayoutKind("light_ring", 2, 3, gap_outside=True),
    LayoutKind("bumpy_ring", 8, 4, gap_outside=False),
    LayoutKind("light_ring", 3, 4, gap_outside=True),
)


def search_only(monkeypatch: pytest.MonkeyPatch, kinds: Sequence[LayoutKind]) -> None:
    for module in ("layout_search", "nearest_requirement"):
        monkeypatch.setattr(f"posor_design.{module}.layout_kinds", lambda _requirement: list(kinds))


@pytest.fixture
def some_kinds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search some kinds of layouts only, to save time."""
    search_only(monkeypatch, KINDS)


@pytest.fixture
def one_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search one kind of layouts only, for several searches."""
    search_only(monkeypatch, KINDS[:1])


@cache
def found(preference: str = "electronics") -> SearchResult:
    return LayoutSearch(example()).run(preference)  # type: ignore[arg-type]


def refusal_of(requirement: Requirement) -> DesignError:
    result = LayoutSearch(requirement).run()
    assert result.chosen is None
    with pytest.raises(DesignError) as refusal:
        refuse(result)
    return refusal.value


@pytest.mark.usefixtures("some_kinds")
def test_the_chosen_layout_meets_the_requirement_at_other_poses() -> None:
    chosen = found().chosen
    assert chosen is not None
    assert all(ratios(example(), each).worst <= 1.0 for each in found().feasible)
    poses = random_poses(example(), chosen.layout.gap, 200, np.random.default_rng(2))
    again = evaluate(example(), chosen.kind, chosen.layout, poses)
    assert again.readable
    assert np.all(again.sigmas <= example().sigmas)


@pytest.mark.usefixtures("some_kinds")
def test_the_trade_off_is_the_pareto_front() -> None:
    front = [list(objectives(example(), each).values()) for each in found().trade_off]
    everything = [list(objectives(example(), each).values()) for each in found().feasible]
    for own in front:
        assert not any(all(a <= b for a, b in zip(other, own, strict=True)) and other != own for other in everything)
    for own in everything:  # each is on the front or excelled by a layout of the front
        assert any(all(a <= b for a, b in zip(other, own, strict=True)) for other in front)
    assert trade_off(example(), [candidate(), candidate()]) != []


@pytest.mark.usefixtures("some_kinds")
@pytest.mark.long
def test_preferences_choose_the_best_checked_layout() -> None:
    unobserved = {id(each): len(found().unobservable(each)) for each in found().feasible}
    checked = [each for each in found().feasible if unobserved[id(each)] == min(unobserved.values())]
    assert all(math.isfinite(each.fault) for each in checked)
    for preference in ("electronics", "accuracy", "size", "detectability"):
        chosen = found(preference).chosen
        assert chosen is not None
        best = min(objectives(example(), each)[preference] for each in checked)
        assert objectives(example(), chosen)[preference] == best


@pytest.mark.usefixtures("some_kinds")
def test_the_optimum_is_not_worse_than_its_start() -> None:
    search = LayoutSearch(example())
    shares, best = search.optimised(KINDS[0])
    start = search.candidate(KINDS[0], 0.08, type(shares)())
    assert best is not None
    assert start is not None
    assert ratios(example(), best).worst <= ratios(example(), start).worst


@pytest.mark.usefixtures("one_kind")
def test_an_uncertainty_beyond_reach_is_refused_with_the_nearest_requirement() -> None:
    requirement = example().changed(uncertainty={"theta": 0.5e-6})
    refusal = refusal_of(requirement)
    assert re.match(r"requirement 'example': uncertainty of theta, 500 nrad, is beyond every layout", str(refusal))
    match = re.match(r"at least theta ([\d.]+) urad, all else unchanged", refusal.expected)
    assert match is not None
    nearest = float(match[1]) * 1e-6
    assert LayoutSearch(requirement.changed(uncertainty={"theta": nearest})).run().chosen is not None
    assert LayoutSearch(requirement.changed(uncertainty={"theta": 0.9 * nearest})).run().chosen is None


@pytest.mark.usefixtures("some_kinds")
@pytest.mark.long
def test_a_fault_beyond_detection_is_refused_with_the_smallest_detectable() -> None:
    content = example().model_dump(mode="json")
    content["minimum_detectable_fault"] = {"value": 1e-8, "unit": "m"}
    requirement = type(example()).model_validate(content)
    refusal = refusal_of(requirement)
    assert "minimum_detectable_fault 10 nm is beyond every layout" in str(refusal)
    match = re.match(r"at least minimum_detectable_fault ([\d.]+) (nm|um)", refusal.expected)
    assert match is not None
    fault = float(match[1]) * {"nm": 1e-9, "um": 1e-6}[match[2]]
    chosen = LayoutSearch(requirement.changed(minimum_detectable_fault=fault)).run().chosen
    assert chosen is not None
    assert chosen.fault <= fault


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"outside_diameter": 0.03}, "outside_diameter"),
        pytest.param({"range": {"gap": 4e-3}}, "range.gap", marks=pytest.mark.long),
        pytest.param({"range": {"runout": 12e-3}}, "range.runout", marks=pytest.mark.long),
        pytest.param({"inside_diameter": 0.05}, "outside_diameter", marks=pytest.mark.long),
    ],
)
def test_geometry_beyond_reach_is_refused_with_the_entry_that_must_change_least(
    changes: dict[str, float], name: str
) -> None:
    refusal = refusal_of(example().changed(**changes))
    assert f"{name} " in refusal.what
    assert refusal.what.endswith("no layout fits with this range of motion")
    match = re.search(rf"{name} of at (least|most) ([\d.]+) (mm|um|m)\b", refusal.expected)
    assert match is not None
    value = float(match[2]) * {"mm": 1e-3, "um": 1e-6, "m": 1.0}[match[3]]
    part, _, key = name.rpartition(".")

    def fits(number: float) -> bool:
        relaxed = example().changed(**{**changes, **({part: {key: number}} if part else {key: number})})
        return LayoutSearch(relaxed).run().best is not None

    assert fits(value)
    worse = 0.9 if match[1] == "least" else 1.1
    assert not fits(worse * value)


@pytest.mark.usefixtures("some_kinds")
def test_the_advised_diameter_meets_the_whole_requirement() -> None:
    tight = {"alpha": 8e-6, "beta": 8e-6}
    requirement = example().changed(outside_diameter=0.03, uncertainty=tight)
    match = re.search(r"outside_diameter of at least ([\d.]+) mm", refusal_of(requirement).expected)
    assert match is not None
    advised = 1e-3 * float(match[1])
    assert LayoutSearch(requirement.changed(outside_diameter=advised)).run().chosen is not None
    assert LayoutSearch(requirement.changed(outside_diameter=0.85 * advised)).run().chosen is None


@pytest.mark.usefixtures("some_kinds")
def test_a_diameter_that_fits_but_cannot_suffice_is_not_advised_as_sufficient() -> None:
    requirement = example().changed(outside_diameter=0.03, uncertainty={"x": 1e-9})
    expected = refusal_of(requirement).expected
    assert re.match(r"outside_diameter of more than [\d.]+ mm with a weaker required uncertainty or fault", expected)


def test_the_binding_constraint_is_the_one_that_is_used_most() -> None:
    own = candidate()
    tight = example().changed(uncertainty={"beta": float(own.sigmas[4]) / 2.0})
    assert binding_constraint(tight, own) == "beta"
    assert ratios(tight, own).freedoms[4] == pytest.approx(2.0 / RESERVE)
