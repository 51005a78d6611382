# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Protection levels: the kernel against pinocchio, bounds of beams, and errors in a simulation with faults."""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from posor.calibration.calibration_file import Calibration
from posor.calibration.causes import Cause
from posor.calibration.designs import sized_design
from posor.chain.beams_file import BeamsFile
from posor.chain.fault_bounds import COVERAGE_FACTOR, INTEGRITY_RISK, STAMPS
from posor.chain.joint_measurements import MeasuredJoint
from posor.chain.kinematic_chain import Chain
from posor.errors import ParameterError
from posor.estimation.fault_model import ALWAYS, SECOND, SHARED, JointCauses
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.numerics.array_types import FloatArray
from posor.uncertainty.protection_level import arm_reliability, joint_protection_levels
from posor_lab.faults.cause_faults import cause_stacks, judge_causes
from posor_lab.faults.offline_faults import draw_joint_poses
from posor_lab.harness.beams import beams_file, quantity, uncertainty
from posor_lab.harness.endpoint_effects import endpoint_effects, expansion_shifts
from scipy.special import ndtr

URDF = Path(__file__).with_name("two_joints.urdf").read_text(encoding="utf-8")
ANGLES = {"a": 0.4, "b": -0.7}
BEAMS = {"f1": ("0.2 0.1 0.6", 23e-6, 5.0), "f2": ("0.1 0 0.4", 12e-6, 2.0)}
"""Beams of the arm: origin in the URDF, coefficient of expansion [1/K], largest deviation [K]."""
CAUSES = JointCauses(("alone", "pair", "always", "shared"), (0, 1, 1, 2, 2, 3), (0, 0, SECOND, ALWAYS, ALWAYS, SHARED))


def disturbed(pose: pin.SE3, error: FloatArray) -> pin.SE3:
    """Return a transform with an error (x, y, z [m], about X, Y, Z [rad]) in the axes of the parent."""
    return pin.SE3(pin.exp3(error[3:]) @ pose.rotation, pose.translation + error[:3])


@pytest.fixture(scope="module")
def chain() -> Chain:
    return Chain(URDF, "tool")


def poses_of(chain: Chain) -> dict[str, pin.SE3]:
    return {name: chain.nominal_joint(name, angle) for name, angle in ANGLES.items()}


def level_of(
    chain: Chain,
    effects: FloatArray,
    root: FloatArray,
    causes: JointCauses = CAUSES,
    home: FloatArray | None = None,
    shifts: FloatArray | None = None,
) -> tuple[FloatArray, tuple[tuple[str, str], ...], FloatArray]:
    """Return level, what sets it, and covariance of an endpoint.

    ``effects``, ``shifts``: of faults and stamps at both joints, (2, C, 7) and (2, 6).
    """
    poses, estimator = poses_of(chain), chain.estimator()
    estimator.use_causes([causes] * 2)
    packed = np.array([[pin.SE3ToXYZQUAT(pose) for pose in poses.values()]])
    covariance = np.tile(root @ root.T, (1, 2, 1, 1))
    parts, stamp_shifts = (0.25 * covariance, 0.75 * covariance), None if shifts is None else shifts[None]
    endpoints = estimator.estimate_all(packed, *parts, np.zeros(1, dtype=np.int64), stamp_shifts=stamp_shifts)
    endpoints = endpoints if home is None else endpoints.relative_to(home)
    bounds = estimator.bound_all(endpoints, packed, effects[None].astype(np.float32), stamp_shifts, home)
    return bounds.levels[0], estimator.set_by(bounds, 0), endpoints.covariances()[0]


@pytest.mark.parametrize("joint", ["a", "b"])
def test_the_reference_of_the_kernel_is_that_of_the_chain(chain: Chain, joint: str, rng: np.random.Generator) -> None:
    shift, poses = 1e-7 * rng.normal(size=6), poses_of(chain)
    before, after = (
        chain.estimate({name: MeasuredJoint(pose) for name, pose in case.items()}).T_base_endpoint
        for case in (poses, {**poses, joint: disturbed(poses[joint], shift)})
    )
    turn = pin.log3(after.rotation @ before.rotation.T)
    change = np.concatenate([after.translation - before.translation, turn])
    np.testing.assert_allclose(endpoint_effects(chain, poses)[joint] @ shift, change, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("turned", [False, True])
def test_the_worst_fault_counts_and_all_causes_that_are_always_there(
    chain: Chain, *, turned: bool, rng: np.random.Generator
) -> None:
    effects = np.concatenate([1e-6 * rng.normal(size=(2, 6, 6)), np.ones((2, 6, 1))], axis=2)
    root = 1e-7 * rng.normal(size=(6, 6))
    home = pin.SE3ToXYZQUAT(pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))) if turned else None
    axes = np.eye(3) if home is None else pin.XYZQUATToSE3(home).rotation
    level, set_by, covariance = level_of(chain, effects, root, home=home)
    turn = np.kron(np.eye(2), axes.T)
    moved = np.stack([effects[j, :, :6] @ (turn @ matrix).T for j, matrix in enumerate(_matrices(chain))])
    alone, always = np.abs(moved[:, 0]), np.abs(moved[:, 3:5]).sum(axis=(0, 1))
    pair, shared = np.hypot(moved[:, 1], moved[:, 2]), np.abs(moved[:, 5]).sum(axis=0)
    faults = np.vstack([alone, pair, shared[None]])
    sigmas = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(level, COVERAGE_FACTOR * sigmas + faults.max(axis=0) + always, rtol=1e-6)
    names = [(joint, cause) for cause in ("alone", "pair") for joint in ANGLES]
    largest_shared = np.array(list(ANGLES))[np.abs(moved[:, 5]).argmax(axis=0)]
    for k, found in enumerate(set_by):
        number = int(faults[:, k].argmax())
        assert found == (names[number] if number < len(names) else (largest_shared[k], "shared"))
    assert 2.0 * (1.0 - ndtr(COVERAGE_FACTOR)) == pytest.approx(INTEGRITY_RISK, rel=1e-12)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("size", [1e-9, 1e-3])
def test_the_cause_is_the_stamps_of_the_joint_that_moves_most_where_no_fault_does_more(
    chain: Chain, *, size: float, turned: bool, rng: np.random.Generator
) -> None:
    effects = np.concatenate([1e-6 * rng.normal(size=(2, 6, 6)), np.ones((2, 6, 1))], axis=2)
    home = pin.SE3ToXYZQUAT(pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))) if turned else None
    turn = np.kron(np.eye(2), np.eye(3) if home is None else pin.XYZQUATToSE3(home).rotation.T)
    shifts = size * rng.uniform(size=(2, 6)) * [[3.0, 3.0, 3.0, 0.3, 0.3, 0.3], [0.3, 0.3, 0.3, 1.0, 1.0, 1.0]]
    moved = [np.abs(turn @ matrix) @ own for matrix, own in zip(_matrices(chain), shifts, strict=True)]
    _, without, _ = level_of(chain, effects, np.zeros((6, 6)), home=home)
    _, set_by, _ = level_of(chain, effects, np.zeros((6, 6)), home=home, shifts=shifts)
    by_stamps = tuple((list(ANGLES)[joint], STAMPS) for joint in np.argmax(moved, axis=0))
    assert len(set(by_stamps)) == len(ANGLES)
    assert set_by == (by_stamps if size == 1e-3 else without)


def _matrices(chain: Chain) -> list[FloatArray]:
    return list(endpoint_effects(chain, poses_of(chain)).values())


def test_an_unbounded_effect_leaves_the_endpoint_unbounded_where_it_acts(chain: Chain) -> None:
    effects = np.zeros((2, 6, 7))
    effects[..., 6] = 1.0
    effects[1, 0] = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf]
    level, set_by, _ = level_of(chain, effects, np.zeros((6, 6)))
    np.testing.assert_array_equal(np.isinf(level), np.abs(_matrices(chain)[1][:, 0]) > 1e-6)
    assert set_by[int(np.isinf(level).argmax())] == ("b", "alone")
    np.testing.assert_array_equal(level[3:], 0.0)
    for wrong in (math.nan, -0.1, 1.5):
        effects[0, 3, 6] = wrong
        assert np.isnan(level_of(chain, effects, np.zeros((6, 6)))[0]).all()


def test_a_joint_without_causes_leaves_the_level_unknown(chain: Chain) -> None:
    level, set_by, _ = level_of(chain, np.zeros((2, 0, 7)), np.zeros((6, 6)), JointCauses())
    assert np.isnan(level).all()
    assert set_by == (("", ""),) * 6


def warm_beams() -> BeamsFile:
    beams = [
        {
            "joint": name,
            "uncertainty": uncertainty([0.0] * 3, [0.0] * 3),
            "temperature": {"coefficient": quantity(coefficient, "1/K"), "deviation": quantity(deviation, "K")},
        }
        for name, (_, coefficient, deviation) in BEAMS.items()
    ]
    return beams_file(*beams, version=2)


def chain_at(deviations: dict[str, float]) -> Chain:
    """Return the arm whose beams have these deviations of temperature [K], by the lengths in its URDF."""
    urdf = URDF
    for name, deviation in deviations.items():
        origin, coefficient, _ = BEAMS[name]
        lengths = (1.0 + coefficient * deviation) * np.array([float(part) for part in origin.split()])
        urdf = urdf.replace(f'"{origin}"', '"' + " ".join(f"{length:.17g}" for length in lengths) + '"')
    assert urdf != URDF
    return Chain(urdf, "tool")


def test_beams_that_expand_stay_within_the_level_and_reach_it(chain: Chain) -> None:
    with_beams = Chain(URDF, "tool", warm_beams())
    before, largest = chain.nominal_endpoint(ANGLES), np.zeros(6)
    expansions, effects = expansion_shifts(with_beams, poses_of(with_beams)), np.zeros((2, 6, 7))
    effects[..., 6] = 1.0
    level, _, covariance = level_of(with_beams, effects, np.zeros((6, 6)))
    for shares in product((-1.0, -0.4, 0.0, 0.7, 1.0), repeat=len(BEAMS)):
        if not any(shares):
            continue
        deviations = {name: share * BEAMS[name][2] for name, share in zip(BEAMS, shares, strict=True)}
        after = chain_at(deviations).nominal_endpoint(ANGLES)
        shift = np.concatenate([after.translation - before.translation, pin.log3(after.rotation @ before.rotation.T)])
        np.testing.assert_allclose(shift, shares @ expansions, rtol=0.0, atol=1e-13)
        largest = np.maximum(largest, np.abs(shift))
    np.testing.assert_allclose(largest, level, rtol=0.0, atol=1e-13)
    np.testing.assert_array_equal(covariance, np.zeros((6, 6)))
    assert np.all(level[:3] > 1e-6)


def calibrations_of() -> dict[str, Calibration]:
    return {
        name: sized_design("quad_light_ring", 0.15, frames=(f"{name}_r", f"{name}_t"), title=name) for name in ANGLES
    }


def test_an_arm_has_the_level_of_its_effects_and_names_what_sets_it(chain: Chain) -> None:
    found = arm_reliability(chain, calibrations_of(), ANGLES)
    assert np.isfinite(found.protection_level).all()
    kinds = {cause.name: cause.kind for cause in found.joints["a"].hypotheses.causes}
    faults, always = [], np.zeros(6)
    for own in found.effects.values():
        always += sum((effect for cause, effect in own.items() if kinds[cause] == "always"), np.zeros(6))
        faults += [effect for cause, effect in own.items() if kinds[cause] == "fault"]
    rest = found.protection_level - np.max(faults, axis=0) - always - found.expansions
    assert np.all(rest > 0.0)  # noise and calibration
    for k, (joint, cause) in enumerate(found.set_by):
        assert found.effects[joint][cause][k] == pytest.approx(np.max(faults, axis=0)[k])


def test_levels_of_estimates_need_their_effects() -> None:
    posor = Posor(calibrations_of()["a"])
    scans = scans_at(posor.stack, np.eye(3)[None], np.array([[0.0, 0.0, 7.35e-4]]), np.ones(1, dtype=np.int64))
    levels = joint_protection_levels(posor, posor.estimate_each(scans, fault_effects=True)).levels
    assert np.isfinite(levels).all()
    with pytest.raises(ParameterError, match="no fault effects; expected estimate_all"):
        joint_protection_levels(posor, posor.estimate_each(scans))


STACKS = cause_stacks()
FAULTS = ["reading", "light spot", "wedge of gaps", "bit of gap converter", "ambient light", "gradient of ring"]


def judged(calibration: Calibration, cause: Cause, seed: int, scans: int = 60) -> Any:
    random = np.random.default_rng(seed)
    return judge_causes(calibration, [(cause, 1.0)], draw_joint_poses(scans, random), random)


@pytest.mark.parametrize("stack", STACKS)
@pytest.mark.parametrize("name", FAULTS)
def test_no_undetected_fault_exceeds_the_level_of_its_own_scan(stack: str, name: str) -> None:
    """A part of ``make faults`` with a fixed seed."""
    cause = next((each for each in Posor(STACKS[stack]).hypotheses.causes if each.name == name), None)
    if cause is not None:
        found = judged(STACKS[stack], cause, 40)
        assert found.wrong == 0
        assert found.ok > 0


@pytest.mark.parametrize(("stack", "name"), [("quad_light_ring", "light spot"), ("quad_bumpy_ring", "wedge of gaps")])
def test_levels_of_single_readings_alone_do_not_cover_a_common_cause(stack: str, name: str) -> None:
    """What was published before causes: each fault moves one reading. The judge notices."""
    calibration = STACKS[stack]
    causes = Posor(calibration).hypotheses.causes
    cause = next(each for each in causes if each.name == name)
    without = [each.model_copy(update={"bound": 0.0}) for each in causes if not each.unlimited]
    assert judged(calibration.model_copy(update={"causes": without}), cause, 40, 150).wrong > 5


def test_an_encoder_bounds_a_spot_that_may_move_anywhere() -> None:
    calibration, random = STACKS["quad_light_ring"], np.random.default_rng(40)
    spot = Cause(name="light spot", moves="one spot", unit="m", unlimited=True, source="test")
    calibration, truth = calibration.model_copy(update={"causes": [spot]}), draw_joint_poses(150, random)
    alone = judge_causes(calibration, [(spot, 1.0)], truth, random)
    found = judge_causes(calibration, [(spot, 1.0)], truth, random, encoder=2e-5)
    assert alone.unbounded == alone.ok
    assert (found.unbounded, found.wrong) == (0, 0)
    assert found.ok > found.beyond > 0
