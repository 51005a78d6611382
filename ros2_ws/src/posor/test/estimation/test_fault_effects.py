# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Effects of undetected faults: directions against changed raw scans, sizes against the test, the hypotheses of two."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from posor.calibration.calibration_file import calibration_from
from posor.calibration.causes import Cause
from posor.calibration.designs import sized_design
from posor.chain.fault_bounds import largest_of_pair
from posor.estimation.fault_hypotheses import Hypotheses
from posor.estimation.posor import Posor
from posor.model.scan import Scans
from posor.uncertainty.budget_poses import scan_at
from posor_lab.faults.cause_injection import inject, with_readings
from scipy.special import chndtr

POSE = pin.SE3(
    pin.exp3(np.array([1e-4, -2e-4, 0.0])) @ pin.exp3(np.array([0.0, 0.0, 0.01])), np.array([1e-5, 0.0, 7.4e-4])
)
STACKS = {
    stack: sized_design(stack, 0.15, frames=("receiving", "target"), title=stack)
    for stack in ("quad_light_ring", "quad_bumpy_ring", "triad_light_ring")
}


def posor_with(stack: str, **cause: Any) -> Posor:
    """Return a POSOR whose only causes are an unlimited one and none by default."""
    none = [
        each.model_copy(update={"bound": 0.0, "unlimited": False}) for each in Posor(STACKS[stack]).hypotheses.causes
    ]
    causes = [*none, Cause(name="tested", source="test", **cause)] if cause else none
    return Posor(STACKS[stack].model_copy(update={"causes": causes, "motion": None}))


def estimated(posor: Posor, scans: Scans) -> Any:
    return posor.estimate_each(scans, np.full(len(scans), 0.01), fault_effects=True)


@pytest.mark.parametrize("stack", STACKS)
def test_other_parameter_values_have_the_same_hypotheses_and_memory_of_their_own(stack: str) -> None:
    posor = Posor(STACKS[stack])
    other = posor.with_parameter_values(posor.stack.parameter_values + posor.stack.parameter_sigmas)
    expected = Hypotheses.of(posor.calibration, other.stack)
    assert (other.hypotheses.causes, other.hypotheses.names) == (expected.causes, expected.names)
    np.testing.assert_array_equal(other.model.faults.columns, expected.model.columns)
    np.testing.assert_array_equal(other.model.faults.coefficients, expected.model.coefficients)
    for own, others in zip(other.model.faults[2:], posor.model.faults[2:], strict=True):
        assert not np.shares_memory(own, others)


@pytest.mark.parametrize(("kept", "parameters"), [((0, 1), 2), ((0,), 1), ((1,), 1), ((), 0)])
def test_probes_on_a_line_have_a_gradient_along_it_only(kept: tuple[int, ...], parameters: int) -> None:
    content = STACKS["quad_light_ring"].model_dump(mode="json", exclude_defaults=True)
    for probe in content["sensors"][0]["probes"]:
        probe["tip"]["value"] = [number if axis in kept else 0.01 for axis, number in enumerate(probe["tip"]["value"])]
    assert Posor(calibration_from(content)).hypotheses.names.count("wedge of gaps") == parameters


@pytest.mark.parametrize(
    ("stack", "cause", "size"),
    [
        ("quad_light_ring", {"moves": "all gap probes", "unit": "m"}, 1e-7),
        ("quad_light_ring", {"moves": "all gap probes", "unit": "V"}, 1e-3),
        ("quad_light_ring", {"moves": "all gap probes", "unit": "1"}, 1e-4),
        ("quad_light_ring", {"moves": "supply channel", "unit": "V"}, 1e-2),
        ("quad_light_ring", {"moves": "temperature channel", "unit": "K"}, 1e-1),
        ("quad_light_ring", {"moves": "ambient light on all diodes", "unit": "1"}, 1e-5),
        ("quad_bumpy_ring", {"moves": "all ring probes", "unit": "m"}, 1e-8),
        ("quad_bumpy_ring", {"moves": "all probes", "unit": "1"}, 1e-5),
    ],
)
def test_the_direction_is_that_of_changed_raw_readings(stack: str, cause: dict[str, str], size: float) -> None:
    """One unlimited hypothesis that the redundant readings do not limit, or do: the direction of the shift agrees."""
    posor = posor_with(stack, **cause, bound=size)
    scan = Scans.of([scan_at(posor, POSE)])
    before = estimated(posor, scan)
    random = np.random.default_rng(1)
    after = estimated(posor, inject(posor.hypotheses.causes[0], np.array([size]), scan, posor.stack, random))
    moved = np.concatenate(
        [after.translations[0] - before.translations[0], pin.log3(after.rotations[0] @ before.rotations[0].T)]
    )
    expected = before.fault_effects[0, 0, :6].astype(float)
    for part in (slice(3), slice(3, 6)):
        sign = math.copysign(1.0, float(moved[part] @ expected[part]))
        scale = max(np.abs(expected).max(), 1e-12)
        np.testing.assert_allclose(sign * moved[part] / scale, expected[part] / scale, atol=0.02)


@pytest.mark.parametrize("stack", ["quad_light_ring", "quad_bumpy_ring"])
def test_a_single_fault_of_the_stated_size_is_missed_as_rarely_as_stated(stack: str) -> None:
    posor = posor_with(stack, moves="one reading", unit="m", unlimited=True)
    scan = Scans.of([scan_at(posor, POSE)])
    found = estimated(posor, scan)
    whole = np.abs(posor.model.workspace[0]["gain"]).max()
    assert whole > 0.0
    for column, effect in enumerate(found.fault_effects[0]):
        if math.isinf(effect[6]):
            continue
        moved = np.zeros((1, posor.stack.readings))
        gain = posor.model.workspace[0]["gain"][column]
        size = np.linalg.norm(effect[:6].astype(float)) / np.linalg.norm(gain)
        moved[0, column] = size

        changed = estimated(posor, with_readings(scan, posor.stack, posor.stack.linearise(scan).values + moved))
        residual = float(changed._records["residual"][0])  # non-centrality, as there is no noise
        passing = chndtr(posor.residual_limit, posor.redundancy, residual)
        assert passing == pytest.approx(1e-2, rel=0.1)


def test_two_parameters_reach_the_edge_of_both_limits(rng: np.random.Generator) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 20001)
    around = np.stack([np.cos(angles), np.sin(angles)])
    for cuts in ((1.0, 1.0), (0.3, 0.0), (0.0, 0.0), (0.9, 0.2), (1e-6, 0.999), (1.0, 0.5)):
        radius = 1.0 / np.sqrt(
            np.maximum(around[0] ** 2 + cuts[1] * around[1] ** 2, cuts[0] * around[0] ** 2 + around[1] ** 2)
        )
        for effects in rng.normal(size=(50, 2)) * 10.0 ** rng.uniform(-3.0, 3.0, size=(50, 2)):
            expected = np.max(np.abs(effects @ around) * radius)
            assert largest_of_pair(float(effects[0]), float(effects[1]), *cuts) == pytest.approx(expected, rel=1e-4)


def test_a_spot_in_a_free_direction_is_unbounded_with_two_diodes_and_bounded_by_its_bound() -> None:
    for bound, infinite in (({"unlimited": True}, True), ({"bound": 5e-6}, False)):
        posor = posor_with("quad_light_ring", moves="one spot", unit="m", **bound)
        effects = estimated(posor, Scans.of([scan_at(posor, POSE)])).fault_effects[0]
        assert np.isinf(effects[:, 6]).any() == infinite
        assert (effects[:, 6] < 1.0).any() != infinite


def test_a_cause_that_is_always_there_widens_what_is_missed() -> None:
    alone = posor_with("quad_light_ring", moves="one contact", unit="1", unlimited=True)
    ambient = Cause(
        name="ambient", moves="ambient light on all diodes", unit="1", bound=1e-3, source="test", kind="always"
    )
    causes = [*alone.calibration.causes, ambient]
    masked = Posor(alone.calibration.model_copy(update={"causes": causes}))
    scan = Scans.of([scan_at(alone, POSE)])
    before, after = (estimated(each, scan).fault_effects[0] for each in (alone, masked))
    ratios = np.linalg.norm(after[: len(before), :6], axis=1) / np.linalg.norm(before[:, :6], axis=1)
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-5)
    assert ratios[0] > 1.05


def test_without_a_pose_the_effects_are_unknown_and_without_a_test_unbounded() -> None:
    posor = posor_with("quad_light_ring", moves="one reading", unit="m", unlimited=True)
    scan = Scans.of([scan_at(posor, POSE)])
    lost = scan.with_fields({"gap_voltages": np.full((1, 4), np.nan)})
    assert np.isnan(estimated(posor, lost).fault_effects).all()
    untested = Posor(posor.calibration, false_alarm=0.0)
    assert np.isinf(estimated(untested, scan).fault_effects[0, :, 6]).all()
    assert posor.estimate_all(scan).fault_effects.shape == (1, 0, 7)


@pytest.mark.parametrize(("moves", "pairs"), [("one reading", 1), ("one spot", 2)])
def test_an_encoder_bounds_what_turns_theta(moves: str, pairs: int) -> None:
    """With the encoder the effect about Z of what no reading checks is what the encoder's test misses."""
    posor = posor_with("triad_light_ring", moves=moves, unit="m", unlimited=True)
    scan, sigma = Scans.of([scan_at(posor, POSE)]), 2e-5
    alone = estimated(posor, scan).fault_effects[0]
    posor.confirm_theta(0.01, sigma)
    confirmed = posor.estimate_all(scan, fault_effects=True)
    effects = confirmed.fault_effects[0]
    total = math.sqrt(sigma**2 + confirmed.covariances()[0, 5, 5])
    before, after = np.isinf(alone[:, 6]), np.isinf(effects[:, 6])
    turning = before & (np.abs(alone[:, 5]) > 1.0)
    assert turning.any() == (pairs == 2)
    assert not after[turning].any()
    if pairs == 2:
        largest = (5.0 + 2.326) * total + np.abs(alone[0, 5])
        np.testing.assert_allclose(np.abs(effects[turning, 5]), largest, rtol=1e-3)
    np.testing.assert_array_equal(after[~turning], before[~turning])
