# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Endpoint between scans: kinematics, covariance, gaps, and encoders that do not belong to their joint."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.encoder_filter import DISAGREES, HELD_TOO_LONG, JUMPED, OFFSET, TOO_OLD, USED, WAITS
from posor.chain.endpoint_predictor import EndpointPredictor
from posor.chain.kinematic_chain import Chain
from posor.errors import ParameterError
from posor.node_parameters import EncodersParameters
from posor.numerics.array_types import FloatArray

URDF = """<robot name="arm"><link name="base"/><link name="a"/><link name="b"/><link name="endpoint"/>
<joint name="first" type="floating"><parent link="base"/><child link="a"/>
<origin xyz="0.1 0 0.3" rpy="0 0.4 0"/></joint>
<joint name="second" type="floating"><parent link="a"/><child link="b"/>
<origin xyz="0.7 0 0" rpy="1.5 0 0.2"/></joint>
<joint name="tool" type="fixed"><parent link="b"/><child link="endpoint"/><origin xyz="0.5 0.1 0"/></joint></robot>"""
MS = 1_000_000
NOISE, READING = 2e-6, 1e-6  # standard deviations of transforms [m], [rad], and of readings [rad]
RANDOM = np.diag([1e-14] * 3 + [NOISE**2] * 3)
SYSTEMATIC = np.diag([4e-14] * 3 + [9e-12] * 3)


def parameters(**changes: object) -> EncodersParameters:
    return EncodersParameters(**{"topic": "encoders", "sigma": (READING,), "slope": 0.0, **changes})  # type: ignore[arg-type]


class Arm:
    """A predictor of an arm of two joints, with a transform every 5 ms that arrives 2 ms later."""

    def __init__(self, seed: int = 1, **changes: object) -> None:
        self.chain = Chain(URDF, "endpoint")
        self.predictor = EndpointPredictor(self.chain, parameters(**changes))
        self.random = np.random.default_rng(seed)
        self.results: list[int] = []

    def joints(self, angles: FloatArray) -> list[pin.SE3]:
        names = ("first", "second")
        return [self.chain.nominal_joint(name, float(angle)) for name, angle in zip(names, angles, strict=True)]

    def endpoint(self, angles: FloatArray) -> pin.SE3:
        return self.chain.nominal_endpoint(dict(zip(("first", "second"), map(float, angles), strict=True)))

    def use(self, ms: int, angles: FloatArray, which: tuple[int, ...] = (0, 1), *, noise: bool = True) -> None:
        measured = self.predictor.measurements
        for j in which:
            error = self.random.normal(size=6) * np.sqrt(np.diagonal(RANDOM)) * noise
            plate = self.joints(angles)[j]
            plate = pin.SE3(pin.exp3(error[3:]) @ plate.rotation, plate.translation + error[:3])
            measured.poses[0, j] = pin.SE3ToXYZQUAT(plate)
            measured.covariances_random[0, j], measured.covariances_systematic[0, j] = RANDOM, SYSTEMATIC
            measured.thetas[0, j] = math.nan
            self.results.append(self.predictor.use_transform(j, ms * MS))

    def move(
        self,
        path: Callable[[float], FloatArray],
        begin: int,
        end: int,
        *,
        read: Callable[[FloatArray], FloatArray] = lambda angles: angles,
        which: tuple[int, ...] = (0, 1),
        noise: bool = True,
    ) -> bool:
        """Read the encoders each millisecond of a path of the time [s]; return whether the last one is usable."""
        usable = False
        for ms in range(begin, end):
            error = READING * self.random.normal(size=2) * noise
            usable = self.predictor.read(ms * MS, read(path(1e-3 * ms)) + error)
            if ms % 5 == 2 and ms - 2 >= begin:
                self.use(ms - 2, path(1e-3 * (ms - 2)), which, noise=noise)
        return usable

    def error(self, pose: FloatArray, angles: FloatArray) -> FloatArray:
        found, true = pin.XYZQUATToSE3(pose), self.endpoint(angles)
        return np.concatenate([found.translation - true.translation, pin.log3(found.rotation @ true.rotation.T)])


def swing(seconds: float) -> FloatArray:
    return np.array([0.3 * math.sin(2.0 * seconds), 0.5 - 0.3 * math.sin(1.5 * seconds)])


def test_between_scans_the_endpoint_follows_the_encoders() -> None:
    arm = Arm(lead_time=0.01)
    assert arm.move(swing, 1, 505, noise=False)
    assert arm.results == [USED] * len(arm.results)
    assert np.abs(arm.error(arm.predictor.present.pose, swing(0.504))).max() < 1e-9
    assert np.abs(arm.error(arm.predictor.ahead.pose, swing(0.514))).max() < 5e-6
    step = 1e-6
    T, T_after = (arm.endpoint(swing(0.504 + s)) for s in (0.0, step))
    np.testing.assert_allclose(arm.predictor.twist.twist, pin.log6(T.actInv(T_after)).vector / step, atol=2e-3)


def test_the_covariances_are_those_of_the_errors() -> None:
    squares, rates = [], []
    arm = Arm(lead_time=0.01, max_jerk=3.0)
    for n in range(60):
        arm.move(swing, 100 * n + 1, 100 * n + 100)
        end = 0.1 * n + 0.099
        for own, seconds in ((arm.predictor.present, end), (arm.predictor.ahead, end + 0.01)):
            error = arm.error(own.pose, swing(seconds))
            squares.append(error @ np.linalg.solve(own.covariance_random, error))
        rate = (arm.endpoint(swing(end)).actInv(arm.endpoint(swing(end + 1e-5)))).translation * 1e5
        rates.append((arm.predictor.twist.twist[:3] - rate) / np.sqrt(np.diagonal(arm.predictor.twist.covariance)[:3]))
    assert 2.0 < np.mean(squares[::2]) < 7.0  # the true axis is the nominal one
    assert 2.0 < np.mean(squares[1::2]) < 9.0
    assert 0.2 < np.mean(np.square(rates)) < 2.0


def corners(seconds: float) -> FloatArray:
    return np.array([np.interp(seconds % 1.0, [0.0, 0.2, 0.7, 1.0], [0.0, 0.0, 0.4, 0.0]), 0.5])


@pytest.mark.parametrize(("period_ms", "path"), [(5, corners), (90, lambda seconds: swing(3.0 * seconds))])
def test_the_covariance_contains_what_happens_between_slow_readings(
    period_ms: int, path: Callable[[float], FloatArray]
) -> None:
    """Scans lie between the readings, whose tracked rates lag where the motion changes."""
    arm, squares = Arm(), []
    for ms in range(6, 2000):
        if ms % period_ms == 0:
            reading = path(1e-3 * ms) + READING * arm.random.normal(size=2)
            if arm.predictor.read(ms * MS, reading) and ms > 300:
                own, error = arm.predictor.present, arm.error(arm.predictor.present.pose, path(1e-3 * ms))
                squares.append(error @ np.linalg.solve(own.covariance_random, error))
        if ms % 5 == 2:
            arm.use(ms - 4, path(1e-3 * (ms - 4)))
    assert len(squares) > 10
    assert np.mean(squares) < 9.0


def test_the_random_covariance_is_below_that_of_a_scan_and_the_systematic_one_stays_whole() -> None:
    arm, angles = Arm(), np.array([0.2, 0.4])
    arm.move(lambda _: angles, 1, 300)
    estimator = arm.chain.estimator()
    estimator.poses[:] = [pin.SE3ToXYZQUAT(plate) for plate in arm.joints(angles)]
    estimator.covariances_random[:], estimator.covariances_systematic[:] = RANDOM, SYSTEMATIC
    assert estimator.estimate()
    whole = estimator.covariance_systematic
    np.testing.assert_allclose(arm.predictor.present.covariance_systematic, whole, rtol=1e-4, atol=1e-17)
    ratio = np.trace(arm.predictor.present.covariance_random) / np.trace(estimator.covariance_random)
    assert 0.005 < ratio < 0.2


def skew(vector: FloatArray) -> FloatArray:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def least_squares(
    times: FloatArray, angles: FloatArray, errors: FloatArray, axis: FloatArray, lever: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the mean and the covariance of a plate's error at the last time, from all scans before at once.

    Unknowns: error of the carried plate at each time (6), and that of each reading. ``errors``: of the measured plates,
    (n - 1, 6); ``lever``: of the plate's origin from the axis at angle zero.
    """
    n = len(times)
    rows, values, keep = [], [], np.ones(n)  # weight of what is known at a time, at the last one
    for k in range(n - 1):
        keep[: k + 1] /= 1.0 + (times[k + 1] - times[k]) / 0.5

    def effect(k: int) -> FloatArray:
        return np.concatenate([np.cross(axis, pin.exp3(angles[k] * axis) @ lever), axis])

    def add(block: FloatArray, first: int, covariance: FloatArray, value: FloatArray, weight: float) -> None:
        row = np.zeros((len(block), 7 * n))
        row[:, first : first + block.shape[1]] = block
        white = math.sqrt(weight) * np.linalg.inv(np.linalg.cholesky(covariance))
        rows.append(white @ row)
        values.append(white @ value)

    for k in range(n):
        weight = keep[k]
        add(np.c_[np.zeros((1, 6)), np.eye(1)], 7 * k, READING**2 * np.eye(1), np.zeros(1), weight)
        if k < n - 1:
            add(np.c_[np.eye(6), effect(k)], 7 * k, RANDOM, errors[k], weight)
            turn = pin.exp3((angles[k + 1] - angles[k]) * axis)
            spread = 5e-5**2 * (angles[k + 1] - angles[k]) ** 2 * np.eye(6)
            step = np.zeros((6, 14))
            step[:3, :3] = step[3:, 3:6] = -turn
            step[:, 7:13] = np.eye(6)
            add(step, 7 * k, spread, np.zeros(6), keep[k + 1])
    J, y = np.vstack(rows), np.concatenate(values)
    covariance = np.linalg.inv(J.T @ J)
    final = np.c_[np.eye(6), effect(n - 1)]
    return final @ (covariance @ J.T @ y)[-7:], final @ covariance[-7:, -7:] @ final.T


def test_the_filter_agrees_with_least_squares_over_all_scans() -> None:
    arm, rate, offset = Arm(stamp_sigma=0.0), np.array([0.5, -0.4]), np.array([3e-3, -2e-3, 1e-3])
    joint = arm.chain.joints[0].T_parent_joint
    axis, lever = joint.rotation[:, 2], joint.rotation @ offset
    measured, measurements = arm.predictor.measurements, []

    def true_plate(ms: int) -> pin.SE3:
        plate = arm.joints(1e-3 * ms * rate)[0]
        return pin.SE3(plate.rotation, plate.translation + plate.rotation @ offset)

    scans = range(5, 60, 5)
    for ms in range(1, 64):
        arm.predictor.read(ms * MS, 1e-3 * ms * rate + READING * arm.random.normal(size=2))
        if ms in scans:
            arm.use(ms, 1e-3 * ms * rate, which=(1,))
            error, true = arm.random.normal(size=6) * np.sqrt(np.diagonal(RANDOM)), true_plate(ms)
            measured.poses[0, 0] = pin.SE3ToXYZQUAT(
                pin.SE3(pin.exp3(error[3:]) @ true.rotation, true.translation + error[:3])
            )
            measured.covariances_random[0, 0], measured.covariances_systematic[0, 0] = RANDOM, SYSTEMATIC
            assert arm.predictor.use_transform(0, ms * MS) == USED
            measurements.append((ms, error))
    present = arm.predictor.present.workspace[2]
    history = arm.predictor._filter.history[0, :, 0]
    times = np.array([*scans, 63])
    angles = history[times - 1]
    # the errors of the readings move the true plates seen from the plates of the readings
    errors = np.array([error for _, error in measurements])
    carried = np.array([1e-3 * t * rate[0] for t in times]) - angles
    effects = [np.r_[np.cross(axis, pin.exp3(angle * axis) @ lever), axis] for angle in angles]
    errors += carried[:-1, None] * np.array(effects[:-1])
    mean, covariance = least_squares(1e-3 * times, angles, errors, axis, lever)
    mean -= carried[-1] * effects[-1]
    found, true = pin.XYZQUATToSE3(present.poses[0, 0]), true_plate(63)
    error = np.r_[found.translation - true.translation, pin.log3(found.rotation @ true.rotation.T)]
    sigmas = np.sqrt(np.diagonal(covariance))
    np.testing.assert_allclose(error / sigmas, mean / sigmas, atol=1e-3)
    np.testing.assert_allclose(
        present.covariances_random[0, 0] / np.outer(sigmas, sigmas), covariance / np.outer(sigmas, sigmas), atol=1e-3
    )


def test_a_gap_of_a_joint_is_carried_on_and_then_ends() -> None:
    arm = Arm(gap=0.02, max_holdover=0.1)
    arm.move(swing, 1, 300)
    before = np.trace(arm.predictor.present.covariance_random)
    assert not arm.predictor.held.any()
    assert arm.move(swing, 300, 360, which=(0,))
    assert arm.predictor.held_joints == ("second",)
    error = arm.error(arm.predictor.present.pose, swing(0.359))
    assert error @ np.linalg.solve(arm.predictor.present.covariance_random, error) < 25.0
    assert np.trace(arm.predictor.present.covariance_random) > before
    assert not arm.move(swing, 360, 420, which=(0,))
    assert arm.predictor.faults.tolist() == [0, HELD_TOO_LONG]
    assert np.isnan(arm.predictor.present.pose).all()
    assert np.isnan(arm.predictor.present.covariance_random).all()
    assert arm.predictor.reasons() == {"second": "has no transform for more than 0.1 s"}
    assert arm.move(swing, 420, 440)


WRONG = {  # what is done to the readings of the first encoder, and what the sentence says of it
    "sign": (lambda a: np.array([-a[0], a[1]]), DISAGREES, "turns against its POSOR: wrong sign"),
    "scale": (lambda a: np.array([2.0 * a[0], a[1]]), DISAGREES, "turns 2 times as far as its POSOR: wrong scale"),
    "degrees": (lambda a: np.degrees(a) * [1.0, 0.0] + a * [0.0, 1.0], DISAGREES, "reads degrees; expected rad"),
    "another joint": (
        lambda a: np.array([a[1], a[1]]),
        DISAGREES,
        "follows the POSOR of 'second': readings of another joint",
    ),
    "one tooth": (
        lambda a: np.add(a, [0.0314, 0.0]),
        OFFSET,
        "expected at most 0.005; another zero, or a slipped tooth",
    ),
}


@pytest.mark.parametrize(("wrong", "fault", "text"), WRONG.values(), ids=WRONG)
def test_the_encoder_of_another_joint_sign_scale_or_zero_is_named(
    wrong: Callable[[FloatArray], FloatArray], fault: int, text: str
) -> None:
    arm = Arm(max_offset=math.inf if fault == DISAGREES else 0.005, max_rate=100.0)
    assert not arm.move(swing, 1, 100, read=wrong)
    assert arm.predictor.faults.tolist() == [fault, 0]
    assert arm.predictor.reasons()["first"].endswith(text)


def test_a_wrong_sign_is_found_before_the_endpoint_is_wrong() -> None:
    arm = Arm()
    still, slow = np.zeros(2), np.array([0.002, 0.0])
    assert arm.move(lambda _: still, 1, 100)
    largest = 0.0
    for ms in range(100, 200):
        angles = slow * (1e-3 * (ms - 100)) ** 2 * 100.0
        if arm.predictor.read(ms * MS, -angles):
            largest = max(largest, float(np.abs(arm.error(arm.predictor.present.pose, angles)[5])))
        if ms % 5 == 0:
            arm.use(ms, angles)
    assert arm.predictor.faults.tolist() == [DISAGREES, 0]
    assert largest < 5e-5


def test_a_slipped_tooth_in_motion_is_named_and_the_joint_returns_once_it_has_moved() -> None:
    arm = Arm(max_offset=0.1)
    assert arm.move(swing, 1, 200)

    def slipped(angles: FloatArray) -> FloatArray:
        return np.add(angles, [0.0, 0.005])

    assert not arm.move(swing, 200, 210, read=slipped)
    assert "has jumped by +0.0050" in arm.predictor.reasons()["second"]
    assert "a lost count or a slipped tooth" in arm.predictor.reasons()["second"]
    assert arm.move(swing, 210, 260, read=slipped)
    assert np.abs(arm.error(arm.predictor.present.pose, swing(0.259))).max() < 3e-5


def test_a_single_wrong_reading_costs_the_readings_until_the_next_scan() -> None:
    arm = Arm(max_rate=5.0)
    assert arm.move(swing, 1, 200)
    assert not arm.predictor.read(200 * MS, swing(0.2) + 0.1)
    assert arm.predictor.faults.tolist() == [JUMPED, JUMPED]
    assert arm.predictor.reasons()["first"] == "has an encoder that moved faster than 5 rad/s"
    assert arm.move(swing, 201, 216)


def test_a_transform_waits_for_the_encoder_and_one_before_its_readings_is_not_used() -> None:
    arm = Arm()
    arm.use(10, swing(0.01))
    arm.predictor.read(11 * MS, swing(0.011))
    arm.use(12, swing(0.012))
    arm.use(10, swing(0.01))
    arm.use(11, swing(0.011))
    arm.use(11, swing(0.011))
    assert arm.results == [WAITS] * 4 + [TOO_OLD] * 2 + [USED] * 2 + [TOO_OLD] * 2


def test_ahead_of_a_rate_that_is_not_known_yet_the_covariance_is_large() -> None:
    arm = Arm(lead_time=0.01)
    for ms in range(1, 40):
        angles = np.array([0.5, -0.3]) * 1e-3 * ms
        if arm.predictor.read(ms * MS, angles):
            error = arm.error(arm.predictor.ahead.pose, np.array([0.5, -0.3]) * (1e-3 * ms + 0.01))
            assert error @ np.linalg.solve(arm.predictor.ahead.covariance_random, error) < 30.0
        arm.use(ms, angles)
    assert np.abs(error).max() < 1e-4


def test_backlash_is_part_of_the_uncertainty_at_a_reversal_only() -> None:
    arm = Arm(backlash=(4e-4,))

    def read(angles: FloatArray) -> FloatArray:
        return angles + 2e-4  # in contact

    forward = np.array([0.3, 0.2])
    arm.move(lambda s: forward * s, 1, 300, read=read)
    before = np.trace(arm.predictor.present.covariance_random)
    arm.predictor.read(300 * MS, read(forward * 0.299) - 2e-4)
    assert np.trace(arm.predictor.present.covariance_random) > 10.0 * before
    error = arm.error(arm.predictor.present.pose, forward * 0.299)
    assert error @ np.linalg.solve(arm.predictor.present.covariance_random, error) < 25.0


@pytest.mark.parametrize(
    ("changes", "place"),
    [({"sigma": (1e-6, 1e-6, 1e-6)}, "sigma"), ({"backlash": ()}, "backlash"), ({"names": ("a", "a")}, "names")],
)
def test_parameters_that_do_not_fit_the_joints_are_refused(changes: dict[str, object], place: str) -> None:
    with pytest.raises(ParameterError, match=f"encoders.{place}"):
        EndpointPredictor(Chain(URDF, "endpoint"), parameters(**changes))
