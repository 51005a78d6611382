"""Invalid measurements, arrays of the wrong shape, and no scans."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.joint_measurements import MeasuredJoint
from posor.errors import ChainError

from .six_axis_arm import JOINTS, SCANS, WINDOW_S, assert_bits, six_axis_chain, swinging

if TYPE_CHECKING:
    from posor.chain.kinematic_chain import Chain


@pytest.fixture(scope="module")
def chain() -> Chain:
    return six_axis_chain()


WRONG = {
    "shoulder has a pose that is not finite": ("poses", (1, 0), math.nan),
    "shoulder has a pose that is not finite ": ("poses", (1, 6), math.inf),
    "elbow has an orientation that is not a unit quaternion": ("poses", (2, slice(3, 7)), 0.6),
    "tool_roll has a covariance that is not finite": ("covariances", (5, 4, 2), math.nan),
}


@pytest.mark.parametrize("sentence", WRONG)
def test_an_invalid_measurement_gives_no_endpoint_and_its_joint_is_named(chain: Chain, sentence: str) -> None:
    which, where, value = WRONG[sentence]
    poses, stamps = swinging(chain, SCANS)
    covariances = np.zeros((SCANS, JOINTS, 6, 6))
    bad = SCANS // 2
    others = np.arange(SCANS) != bad
    without = chain.estimate_all(poses[others], covariances[others], stamps[others], acceleration_window=WINDOW_S)
    {"poses": poses, "covariances": covariances}[which][bad][where] = value
    found = chain.estimate_all(poses, covariances, stamps, acceleration_window=WINDOW_S)
    assert np.flatnonzero(~found.usable).tolist() == [bad]
    assert np.isnan(found.poses[bad]).all()
    assert np.isnan(found.covariances[bad]).all()
    assert np.isnan(found.angles[bad]).all()
    # All other scans are unaffected, also in their accelerations.
    assert_bits(found.poses[others], without.poses)
    estimator = chain.estimator()
    estimator.poses[:], estimator.covariances[:] = poses[bad], covariances[bad]
    assert not estimator.estimate()
    assert np.isnan(estimator.pose).all()
    assert estimator.fault_text() == sentence.strip()
    estimator.poses[:], estimator.covariances[:] = poses[0], covariances[0]
    assert estimator.estimate()
    assert estimator.fault_text() == ""


def test_invalid_measurements_are_refused_by_joint(chain: Chain) -> None:
    sound = {joint.name: MeasuredJoint(pin.SE3.Identity(), np.zeros((6, 6))) for joint in chain.joints}
    with pytest.raises(ChainError) as caught:
        chain.estimate({**sound, "elbow": MeasuredJoint(pin.SE3.Identity(), np.full((6, 6), np.nan))})
    assert str(caught.value) == (
        "the chain: elbow has a covariance that is not finite; expected numbers that can be used."
    )
    del sound["elbow"]
    with pytest.raises(
        ChainError, match="joint 'elbow' has no measurement; expected a measurement of each of base_turn, "
    ):
        chain.estimate(sound)


@pytest.mark.parametrize(
    ("name", "shape"),
    [("poses", (3, 5, 7)), ("covariances", (3, 6, 36)), ("stamps_ns", (2,)), ("thetas", (3, 5))],
)
def test_arrays_of_the_wrong_shape_are_refused(chain: Chain, name: str, shape: tuple[int, ...]) -> None:
    shapes: dict[str, tuple[int, ...]] = {
        "poses": (3, JOINTS, 7),
        "covariances": (3, JOINTS, 6, 6),
        "stamps_ns": (3,),
        "thetas": (3, JOINTS),
    }
    expected = shapes[name]
    shapes[name] = shape
    stamps = np.zeros(shapes["stamps_ns"], dtype=np.int64)
    with pytest.raises(ChainError) as caught:
        chain.estimator().estimate_all(
            np.zeros(shapes["poses"]), np.zeros(shapes["covariances"]), stamps, np.zeros(shapes["thetas"])
        )
    assert str(caught.value) == f"the chain: {name} of shape {shape}; expected {expected}."


def test_a_moving_arm_needs_stamps(chain: Chain) -> None:
    with pytest.raises(ChainError, match="the endpoints of an arm in motion need stamps; expected 3 stamps"):
        chain.estimator(WINDOW_S).estimate_all(np.zeros((3, JOINTS, 7)), np.zeros((3, JOINTS, 6, 6)))


def test_no_scans_give_no_endpoints(chain: Chain) -> None:
    found = chain.estimator(WINDOW_S).estimate_all(
        np.zeros((0, 6, 7)), np.zeros((0, 6, 6, 6)), np.zeros(0, dtype=np.int64)
    )
    assert len(found.poses) == len(found.usable) == 0
