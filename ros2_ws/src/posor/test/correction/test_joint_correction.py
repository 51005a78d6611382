# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Joint errors of a robot by its endpoint, and the control law on a robot with constant errors and a dead time."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.arm_file import load_arm_file
from posor.correction.joint_correction import AngleHistory, CorrectionLimits, JointCorrection
from posor.correction.nominal_robot import LeastSquares, NominalRobot
from posor.numerics.array_types import FloatArray

RATE = 250
AT = np.array([0.3, -0.6, 0.9, 0.4, 0.7, 0.5])  # not singular
WRONG = 1e-4 * np.array([3.0, -2.0, 4.0, 5.0, -1.0, 2.0])  # errors of the joints [rad]


@pytest.fixture(scope="module")
def robot() -> NominalRobot:
    return NominalRobot(load_arm_file("six_axis").chain())


@pytest.mark.parametrize("arm", ["five_axis", "six_axis", "test_rig"])
def test_endpoint_and_jacobian_are_those_of_the_chain(arm: str) -> None:
    chain = load_arm_file(arm).chain()
    robot = NominalRobot(chain)
    random = np.random.default_rng(3)
    for _ in range(5):
        angles = random.uniform(-1.0, 1.0, len(robot.joints))
        endpoint = robot.endpoint(angles)
        assert endpoint.isApprox(chain.nominal_endpoint(dict(zip(robot.joints, angles.tolist(), strict=True))), 1e-12)
        jacobian, step = robot.jacobian(angles), 1e-6
        for joint, column in enumerate(jacobian.T):
            before, after = (robot.endpoint(angles + sign * step * np.eye(len(angles))[joint]) for sign in (-1.0, 1.0))
            turn = pin.log3(after.rotation @ before.rotation.T)
            moved = np.concatenate([after.translation - before.translation, turn]) / (2.0 * step)
            np.testing.assert_allclose(column, moved, atol=1e-9)


def test_the_error_of_a_single_joint_is_found() -> None:
    rig, at = NominalRobot(load_arm_file("test_rig").chain(), LeastSquares(least_lever=1e-6)), np.array([0.01])
    np.testing.assert_allclose(rig.joint_errors(at, rig.endpoint(at + 1e-4)), [1e-4], rtol=1e-3)


def test_joint_errors_are_found_in_all_six_freedoms_and_bounded_where_the_arm_is_singular(robot: NominalRobot) -> None:
    found = robot.joint_errors(AT, robot.endpoint(AT + WRONG))
    moved = robot.jacobian(AT) @ (found - WRONG)
    assert np.linalg.norm(moved[:3]) < 0.02 * np.linalg.norm((robot.jacobian(AT) @ WRONG)[:3])
    stretched, off = np.zeros(6), pin.SE3(np.eye(3), np.array([3e-4, 0.0, 0.0]))
    assert np.abs(robot.joint_errors(stretched, off * robot.endpoint(stretched))).max() < 3e-4 * 12.0
    exact = NominalRobot(load_arm_file("six_axis").chain(), LeastSquares(least_lever=1e-6))
    np.testing.assert_allclose(exact.joint_errors(AT, robot.endpoint(AT + WRONG)), WRONG, atol=1e-6)


def run_loop(robot: NominalRobot, dead: int, assumed: int | None, limits: CorrectionLimits) -> tuple[FloatArray, str]:
    """Hold a robot with constant joint errors at one pose for 4 s; return position errors [m] and why it stopped.

    ``dead``: ticks from a command to its execution; ``assumed``: the controller's, None: it reads encoders.
    """
    law, executed, errors = JointCorrection(robot, limits), [AT] * (dead + 1), []
    law.start(0.0)
    for tick in range(4 * RATE):
        angles = executed[tick]
        measured = robot.endpoint(angles + WRONG)
        errors.append(np.linalg.norm(measured.translation - robot.endpoint(AT).translation))
        base = angles if assumed is None else executed[max(0, tick + dead - assumed)]
        law.add_endpoint(tick / RATE, base, measured)
        executed.append(AT + law.step((tick + 1) / RATE, 1.0 / RATE))
    return np.array(errors), law.stopped


@pytest.mark.parametrize(("dead", "assumed"), [(1, None), (7, None), (30, None), (30, 30), (30, 27), (30, 33)])
@pytest.mark.parametrize(("constant_s", "lead_s"), [(0.02, 0.0), (0.03, 0.12)])
def test_the_loop_is_stable_for_any_dead_time_whose_error_is_below_the_time_constant(
    robot: NominalRobot, dead: int, assumed: int | None, constant_s: float, lead_s: float
) -> None:
    """With a lead time twice the error must be below it."""
    errors, stopped = run_loop(robot, dead, assumed, CorrectionLimits(time_constant=constant_s, lead_time=lead_s))
    assert not stopped
    assert errors[-RATE:].max() < 0.02 * errors[0]
    assert errors.max() < 1.1 * errors[0]


def test_the_loop_oscillates_where_the_dead_time_is_wrong_by_much_more(robot: NominalRobot) -> None:
    errors, _ = run_loop(robot, 30, 10, CorrectionLimits(time_constant=0.004, max_rate=1.0))
    assert errors[-RATE:].max() > 0.5 * errors[0]


def test_errors_that_change_evenly_are_extrapolated_by_the_lead_time(robot: NominalRobot) -> None:
    rate, lead_s = 5e-4, 0.12
    found = []
    for lead in (0.0, lead_s):
        law = JointCorrection(robot, CorrectionLimits(time_constant=0.0, max_rate=1.0, lead_time=lead))
        law.start(0.0)
        for tick in range(4 * RATE):
            moved = AT + rate * tick / RATE * np.eye(6)[0]
            law.add_endpoint(tick / RATE, AT, robot.endpoint(moved))
            law.step((tick + 1) / RATE, 1.0 / RATE)
        found.append(law.offsets[0])
    assert found[0] - found[1] == pytest.approx(rate * lead_s, rel=0.05)
    law.add_endpoint(4.0, AT, robot.endpoint(AT + 4.9e-3 * np.eye(6)[0]))  # a step: the extrapolation is limited
    law.step(4.01, 0.01)
    assert not law.stopped
    assert law.offsets[0] == -5e-3


def test_offsets_change_at_their_rate_and_stand_after_a_stop(robot: NominalRobot) -> None:
    law = JointCorrection(robot, CorrectionLimits(max_rate=0.01, time_constant=0.0))
    assert law.stopped
    law.start(0.0)
    law.add_endpoint(0.0, AT, robot.endpoint(AT + WRONG))
    rows = np.array([law.step(n / RATE, 1.0 / RATE) for n in range(RATE // 10)])
    assert np.abs(np.diff(rows, axis=0)).max() == pytest.approx(0.01 / RATE)
    assert law.limited > 0
    law.stop("first reason")
    law.stop("second reason")
    law.add_endpoint(0.1, AT, robot.endpoint(AT - WRONG))
    np.testing.assert_array_equal(law.step(1.0, 1.0), rows[-1])
    assert law.stopped == "first reason"
    law.start(2.0)
    law.add_endpoint(2.0, AT, robot.endpoint(AT - WRONG))
    assert np.abs(law.step(2.0 + 1.0 / RATE, 1.0 / RATE) - rows[-1]).max() == pytest.approx(0.01 / RATE)


def test_offsets_do_not_jump_when_a_step_comes_after_a_wait(robot: NominalRobot) -> None:
    law = JointCorrection(robot)
    law.start(0.0)
    for time_s in np.arange(0.0, 10.0, 0.05):
        law.add_endpoint(time_s, AT, robot.endpoint(AT + 1e-3))
    assert np.abs(law.step(10.0, 0.05)).max() == pytest.approx(0.02 * 0.05)
    assert not law.stopped


def test_a_refused_size_and_missing_endpoints_stop_the_correction_with_one_sentence(robot: NominalRobot) -> None:
    law = JointCorrection(robot, CorrectionLimits(max_offset=3e-4))
    law.start(0.0)
    law.add_endpoint(0.01, AT, robot.endpoint(AT + WRONG))
    assert law.stopped.startswith(f"joint {robot.joints[3]} needs an offset of -0.00")
    assert law.stopped.endswith("; limit 0.0003")
    law.start(1.0)
    assert not law.step(1.09, 0.09).any()
    assert len(law.stopped) == 0
    law.refuse_endpoint("elbow is lost")
    law.step(1.11, 0.02)
    assert law.stopped == "no usable endpoint for 0.11 s: elbow is lost"


def test_angles_between_two_samples_and_after_a_step_of_the_clock() -> None:
    history = AngleHistory()
    assert (history.newest_ns, history.at(5)) == (0, None)
    history.add(10, np.array([1.0]))
    history.add(20, np.array([3.0]))
    assert [None if (each := history.at(t)) is None else each.item() for t in (9, 10, 15, 20, 21)] == [
        *(None, 1.0, 2.0, 3.0, None)
    ]
    history.add(12, np.array([7.0]))
    assert history.at(15) is None
