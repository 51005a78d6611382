"""Protection levels of the endpoint: effects of shifts, and errors in a simulation with a fault."""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from posor.calibration.designs import sized_design
from posor.chain.beams_file import BeamsFile
from posor.chain.joint_measurements import MeasuredJoint
from posor.chain.kinematic_chain import Chain
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor.numerics.array_types import FloatArray
from posor.uncertainty.protection_level import (
    COVERAGE_FACTOR,
    INTEGRITY_RISK,
    endpoint_effects,
    endpoint_protection_level,
    expansion_bound,
    expansion_shifts,
)
from posor.uncertainty.reliability import joint_reliability
from posor_lab.harness.beams import beams_file, quantity, uncertainty
from scipy.special import ndtr

from .biased_readings import biased_scans, drawn_stack

URDF = Path(__file__).with_name("two_joints.urdf").read_text(encoding="utf-8")
ANGLES = {"a": 0.4, "b": -0.7}
BEAMS = {"f1": ("0.2 0.1 0.6", 23e-6, 5.0), "f2": ("0.1 0 0.4", 12e-6, 2.0)}
"""Beams of the arm: origin in the URDF, coefficient of expansion [1/K], largest deviation [K]."""
NONE = np.zeros((6, 6))
DRAWS = 600


def disturbed(pose: pin.SE3, error: FloatArray) -> pin.SE3:
    """Return a transform with an error (x, y, z [m], about X, Y, Z [rad]) in the axes of the parent."""
    return pin.SE3(pin.exp3(error[3:]) @ pose.rotation, pose.translation + error[:3])


@pytest.fixture(scope="module")
def chain() -> Chain:
    return Chain(URDF, "tool")


def poses_of(chain: Chain) -> dict[str, pin.SE3]:
    return {name: chain.nominal_joint(name, angle) for name, angle in ANGLES.items()}


def endpoint_change(chain: Chain, shifts: dict[str, FloatArray]) -> FloatArray:
    poses = poses_of(chain)
    before, after = (
        chain.estimate({name: MeasuredJoint(pose) for name, pose in case.items()}).T_base_endpoint
        for case in (poses, {name: disturbed(pose, shifts.get(name, np.zeros(6))) for name, pose in poses.items()})
    )
    turn = pin.log3(after.rotation @ before.rotation.T)
    return np.concatenate([after.translation - before.translation, turn])


@pytest.mark.parametrize("joint", ["a", "b"])
def test_effects_are_those_of_the_chain(chain: Chain, joint: str, rng: np.random.Generator) -> None:
    shift = 1e-7 * rng.normal(size=6)
    effect = endpoint_effects(chain, poses_of(chain))[joint]
    np.testing.assert_allclose(effect @ shift, endpoint_change(chain, {joint: shift}), rtol=0.0, atol=1e-12)


def test_the_worst_single_fault_counts(chain: Chain, rng: np.random.Generator) -> None:
    effects = endpoint_effects(chain, poses_of(chain))
    shifts = {name: 1e-6 * rng.normal(size=(5, 6)) for name in ANGLES}
    root = 1e-6 * rng.normal(size=(6, 6))
    level = endpoint_protection_level([shifts[n] for n in ANGLES], [effects[n] for n in ANGLES], root @ root.T)
    worst = np.max([np.abs(effects[n] @ shift) for n in ANGLES for shift in shifts[n]], axis=0)
    np.testing.assert_allclose(level, worst + COVERAGE_FACTOR * np.linalg.norm(root, axis=1))
    assert 2.0 * (1.0 - ndtr(COVERAGE_FACTOR)) == pytest.approx(INTEGRITY_RISK)


def test_an_undetectable_shift_leaves_the_endpoint_unbounded_where_it_acts(chain: Chain) -> None:
    effects = list(endpoint_effects(chain, poses_of(chain)).values())
    shifts = [np.zeros((1, 6)), np.array([[math.inf, 0.0, 0.0, 0.0, 0.0, 0.0]])]
    level = endpoint_protection_level(shifts, effects, NONE)
    assert np.isinf(level[:3]).any()
    np.testing.assert_array_equal(level[3:], 0.0)


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


def test_beams_that_expand_stay_within_their_bound_and_reach_it(chain: Chain) -> None:
    with_beams = Chain(URDF, "tool", warm_beams())
    expansions = expansion_shifts(with_beams, poses_of(with_beams))
    bound, before = expansion_bound(expansions), chain.nominal_endpoint(ANGLES)
    largest = np.zeros(6)
    for shares in product((-1.0, -0.4, 0.0, 0.7, 1.0), repeat=len(BEAMS)):
        if not any(shares):
            continue
        deviations = {name: share * BEAMS[name][2] for name, share in zip(BEAMS, shares, strict=True)}
        after = chain_at(deviations).nominal_endpoint(ANGLES)
        shift = np.concatenate([after.translation - before.translation, pin.log3(after.rotation @ before.rotation.T)])
        np.testing.assert_allclose(shift, shares @ expansions, rtol=0.0, atol=1e-13)
        largest = np.maximum(largest, np.abs(shift))
    np.testing.assert_allclose(largest, bound, rtol=0.0, atol=1e-13)
    assert np.all(bound[:3] > 1e-6)


def test_the_level_contains_the_bound_of_the_beams_and_the_covariance_does_not(chain: Chain) -> None:
    with_beams, poses = Chain(URDF, "tool", warm_beams()), poses_of(chain)
    expansions, effects = expansion_shifts(with_beams, poses), list(endpoint_effects(chain, poses).values())
    shifts = [np.ones((1, 6)) * 1e-6] * 2
    found = endpoint_protection_level(shifts, effects, NONE, expansions)
    expected = endpoint_protection_level(shifts, effects, NONE) + expansion_bound(expansions)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    measured = {name: MeasuredJoint(pose) for name, pose in poses.items()}
    np.testing.assert_array_equal(with_beams.estimate(measured).covariance(), NONE)
    np.testing.assert_array_equal(expansion_shifts(chain, poses), np.zeros((0, 6)))


def test_undetected_errors_of_a_reading_stay_within_the_level(chain: Chain) -> None:
    """A bias up to twice the detectable size on any reading; noise and calibration errors in both joints."""
    poses, stamps, random = poses_of(chain), np.ones(1, dtype=np.int64), np.random.default_rng(16)
    posors, found, covariances = {}, {}, {}
    for name, pose in poses.items():
        frames = (f"{name}_r", f"{name}_t")
        posors[name] = posor = Posor(sized_design("quad_light_ring", 0.15, frames=frames, title=name))
        scans = scans_at(posor.stack, pose.rotation[None], pose.translation[None], stamps)
        found[name] = joint_reliability(posor, scans[0], pose)
        estimate = posor.estimate_each(scans)
        covariances[name] = estimate.covariances_random[0] + estimate.covariances_systematic[0]
    effects = endpoint_effects(chain, poses)
    covariance = chain.estimate({n: MeasuredJoint(poses[n], covariances[n]) for n in poses}).covariance()
    level = endpoint_protection_level([found[n].shifts for n in poses], [effects[n] for n in poses], covariance)
    assert np.isfinite(level).all()
    within = undetected = 0
    for n in range(DRAWS):
        faulty = ("a", "b")[n % 2]
        i = int(random.integers(len(found[faulty].names)))
        size = found[faulty].biases[i] * random.uniform(0.0, 2.0)
        shifts = {}
        for name, pose in poses.items():
            biases = np.zeros(len(found[name].names))
            biases[i] = size if name == faulty else 0.0
            scans = biased_scans(drawn_stack(posors[name], random), pose, biases, random)
            estimate = posors[name].estimate_each(scans)
            if estimate.states[0] != State.OK:
                break
            turn = pin.log3(estimate.rotations[0] @ pose.rotation.T)
            shifts[name] = np.concatenate([estimate.translations[0] - pose.translation, turn])
        else:
            undetected += 1
            within += bool(np.all(np.abs(endpoint_change(chain, shifts)) <= level))
    assert DRAWS // 4 < undetected < DRAWS
    assert within >= 0.99 * undetected
