# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Invalid measurements, arrays of the wrong shape, and no scans."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.joint_measurements import MeasuredJoint
from posor.chain.kinematic_chain import Chain
from posor.errors import ChainError
from posor_lab.harness.case_tables import refusal

from .six_axis_arm import JOINTS, SCANS, WINDOW_S, assert_bits, six_axis_chain, swinging


@pytest.fixture(scope="module")
def chain() -> Chain:
    return six_axis_chain()


WRONG = {
    "shoulder has a pose that is not finite": ("poses", (1, 0), math.nan),
    "shoulder has a pose that is not finite ": ("poses", (1, 6), math.inf),
    "elbow has an orientation that is not a unit quaternion": ("poses", (2, slice(3, 7)), 0.6),
    "tool_roll has a covariance that is not finite": ("random", (5, 4, 2), math.nan),
    "tool_roll has a covariance that is not positive semi-definite": ("systematic", (5, 4, 4), -1e-9),
}


@pytest.mark.parametrize("sentence", WRONG)
def test_an_invalid_measurement_gives_no_endpoint_and_its_joint_is_named(chain: Chain, sentence: str) -> None:
    which, where, value = WRONG[sentence]
    poses, stamps = swinging(chain, SCANS)
    random, systematic = np.zeros((2, SCANS, JOINTS, 6, 6))
    bad = SCANS // 2
    others = np.arange(SCANS) != bad
    without = chain.estimate_all(
        poses[others], random[others], systematic[others], stamps[others], acceleration_window=WINDOW_S
    )
    {"poses": poses, "random": random, "systematic": systematic}[which][bad][where] = value
    found = chain.estimate_all(poses, random, systematic, stamps, acceleration_window=WINDOW_S)
    assert np.flatnonzero(~found.usable).tolist() == [bad]
    assert np.isnan(found.poses[bad]).all()
    assert np.isnan(found.covariances_random[bad]).all()
    assert np.isnan(found.covariances_systematic[bad]).all()
    assert np.isnan(found.angles[bad]).all()
    # All other scans are unaffected, also in their accelerations.
    assert_bits(found.poses[others], without.poses)
    estimator = chain.estimator()

    def estimate(n: int) -> bool:
        estimator.poses[:] = poses[n]
        estimator.covariances_random[:], estimator.covariances_systematic[:] = random[n], systematic[n]
        return estimator.estimate()

    assert not estimate(bad)
    assert np.isnan(estimator.pose).all()
    assert estimator.fault_text() == sentence.strip()
    assert estimate(0)
    assert estimator.fault_text() == ""


def test_invalid_measurements_are_refused_by_joint(chain: Chain) -> None:
    sound = {joint.name: MeasuredJoint(pin.SE3.Identity()) for joint in chain.joints}
    unsound = {**sound, "elbow": MeasuredJoint(pin.SE3.Identity(), np.full((6, 6), np.nan))}
    assert refusal(ChainError, chain.estimate, unsound).what == "elbow has a covariance that is not finite"
    del sound["elbow"]
    assert refusal(ChainError, chain.estimate, sound).what == "joint 'elbow' has no measurement"


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("poses", (3, 5, 7)),
        ("covariances_random", (3, 6, 36)),
        ("covariances_systematic", (2, 6, 6, 6)),
        ("stamps_ns", (2,)),
        ("thetas", (3, 5)),
    ],
)
def test_arrays_of_the_wrong_shape_are_refused(chain: Chain, name: str, shape: tuple[int, ...]) -> None:
    shapes: dict[str, tuple[int, ...]] = {
        "poses": (3, JOINTS, 7),
        "covariances_random": (3, JOINTS, 6, 6),
        "covariances_systematic": (3, JOINTS, 6, 6),
        "stamps_ns": (3,),
        "thetas": (3, JOINTS),
    }
    expected = shapes[name]
    shapes[name] = shape
    arrays = {each: np.zeros(size, dtype=np.int64 if each == "stamps_ns" else float) for each, size in shapes.items()}
    error = refusal(ChainError, chain.estimator().estimate_all, **arrays)
    assert (error.what, error.expected) == (f"{name} of shape {shape}", str(expected))


def test_a_moving_arm_needs_stamps(chain: Chain) -> None:
    poses, exact = np.zeros((3, JOINTS, 7)), np.zeros((3, JOINTS, 6, 6))
    error = refusal(ChainError, chain.estimator(WINDOW_S).estimate_all, poses, exact, exact)
    assert (error.what, error.expected) == ("the endpoints of an arm in motion need stamps", "3 stamps")


def test_no_scans_give_no_endpoints(chain: Chain) -> None:
    exact = np.zeros((0, JOINTS, 6, 6))
    found = chain.estimator(WINDOW_S).estimate_all(np.zeros((0, 6, 7)), exact, exact, np.zeros(0, dtype=np.int64))
    assert len(found.poses) == len(found.usable) == 0
