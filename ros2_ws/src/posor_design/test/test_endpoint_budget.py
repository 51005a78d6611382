# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The endpoint's error budget: against sums by hand, against drawn errors, and what it refuses."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from posor.calibration.designs import design, sized_design
from posor.calibration.quantity import Quantity
from posor.calibration.shared_terms import SharedTerm
from posor.chain.beams_file import BeamsFile
from posor.chain.kinematic_chain import Chain
from posor.errors import CalibrationError, ChainError
from posor.uncertainty.budget_poses import model_covariances
from posor_design.endpoint_budget import BEAMS, SHARED, Spread, configurations, endpoint_budget
from posor_lab.arm_study.endpoint_monte_carlo import disturbed, monte_carlo
from posor_lab.harness.beams import beams_file, quantity, tube, uncertainty
from posor_lab.harness.case_tables import refusal

INCH = 0.0254
DRAWS = 4_000
# Two joints, about Z and about Y of the base, with arms of 2 m and 0.5 m to the tip when extended along X.
TWO_JOINTS = """<robot name="two">
  <link name="base"/><link name="turn_r"/><link name="turn_t"/><link name="lift_r"/><link name="lift_t"/>
  <link name="tip"/>
  <joint name="mount" type="fixed"><parent link="base"/><child link="turn_r"/><origin xyz="0 0 0.4"/></joint>
  <joint name="turn" type="floating"><parent link="turn_r"/><child link="turn_t"/><origin xyz="0 0 0.000735"/></joint>
  <joint name="beam" type="fixed"><parent link="turn_t"/><child link="lift_r"/>
    <origin xyz="1.5 0 0" rpy="-1.5707963267948966 0 0"/></joint>
  <joint name="lift" type="floating"><parent link="lift_r"/><child link="lift_t"/><origin xyz="0 0 0.000735"/></joint>
  <joint name="hand" type="fixed"><parent link="lift_t"/><child link="tip"/><origin xyz="0.5 0 0"/></joint>
</robot>
"""
BEND = {"tube": tube(0.05, 0.04), "gimbals": quantity([0.3, 1.2], "m"), "uncertainty": quantity(0.3, "1")}
BEAM_SIGMA, BEAM_LEAN = 2e-6, 3e-6
STILL = {"turn": 0.0, "lift": 0.0}


def beams(*, bend: bool) -> BeamsFile:
    known = {"uncertainty": uncertainty([BEAM_SIGMA] * 3, [BEAM_LEAN] * 3)}
    return beams_file({"joint": "beam", **known, **({"sag": BEND} if bend else {})}, {"joint": "hand", **known})


@pytest.fixture
def straight() -> Chain:
    return Chain(TWO_JOINTS, "tip")


@pytest.fixture
def accuracies() -> dict[str, np.ndarray]:
    """About X, Y and Z: POSORs of 8 in and 6 in, by section 9.3.1 of the thesis."""
    return {
        name: np.diag(np.square([0.0, 0.0, 0.0, small, small, large]))
        for name, small, large in (("turn", 0.952e-6, 1.667e-6), ("lift", 1.333e-6, 2.5e-6))
    }


def test_the_budget_of_an_extended_arm_is_as_by_hand(straight: Chain, accuracies: dict[str, np.ndarray]) -> None:
    spread = endpoint_budget(straight, STILL, accuracies).spread
    turn_small, turn_large = np.sqrt(np.diagonal(accuracies["turn"]))[[3, 5]]
    lift_small, lift_large = np.sqrt(np.diagonal(accuracies["lift"]))[[3, 5]]
    rss = math.hypot
    np.testing.assert_allclose(
        spread.orientation, [rss(turn_small, lift_small), rss(turn_small, lift_large), rss(turn_large, lift_small)]
    )
    # 0.735 mm, the distance of the second target plate before its receiving plate, is all that is left along X.
    assert spread.displacement[0] < 1e-3 * 2.5e-6
    np.testing.assert_allclose(
        spread.displacement[1:],
        [rss(2.0 * turn_large, 0.5 * lift_small), rss(2.0 * turn_small, 0.5 * lift_large)],
        rtol=1e-6,
    )
    assert spread.total == pytest.approx(float(np.linalg.norm(spread.displacement)))


def test_the_contributions_add_up_and_the_largest_comes_first(accuracies: dict[str, np.ndarray]) -> None:
    chain = Chain(TWO_JOINTS, "tip", beams(bend=True))
    budget = endpoint_budget(chain, {"turn": 0.4, "lift": -0.7}, accuracies)
    assert sorted(part.name for part in budget.contributions) == sorted([BEAMS, "turn", "lift"])
    for figure in ("orientation", "displacement"):
        squares = sum(np.square(getattr(part.spread, figure)) for part in budget.contributions)
        np.testing.assert_allclose(np.square(getattr(budget.spread, figure)), squares, rtol=1e-9)
    totals = [part.spread.total for part in budget.contributions]
    assert totals == sorted(totals, reverse=True)


def test_a_shared_term_is_one_contribution_of_joints_and_beams(accuracies: dict[str, np.ndarray]) -> None:
    """Both beams are 1.5 m and 0.5 m along X of the extended arm: a common scale moves the tip by the sum."""
    chain = Chain(TWO_JOINTS, "tip", common_beams())
    effects = {name: {"scale": np.array([1e-6, 0.0, 0.0, 0.0, 0.0, 0.0])} for name in STILL}
    budget = endpoint_budget(chain, STILL, accuracies, effects)
    parts = {part.name: part.spread for part in budget.contributions}
    assert set(parts) == {"turn", "lift", BEAMS, f"{SHARED}scale"}
    assert parts[f"{SHARED}scale"].displacement[0] == pytest.approx(2e-6 + (1.5 + 0.5) * 1e-6, rel=1e-3)
    squares = sum(np.square(part.displacement) for part in parts.values())
    np.testing.assert_allclose(np.square(budget.spread.displacement), squares, rtol=1e-9)
    drawn = monte_carlo(chain, STILL, accuracies, DRAWS // 4, 7, effects)
    np.testing.assert_allclose(drawn.displacement, budget.spread.displacement, rtol=0.1)


def common_beams() -> BeamsFile:
    one, names = {"value": 1.0, "unit": "1"}, [beam.joint for beam in beams(bend=False).beams]
    term = {"uncertainty": {"value": 1e-6, "unit": "1"}, "relative": {f"{name}.position": one for name in names}}
    return BeamsFile.model_validate(
        {**beams(bend=False).model_dump(mode="json"), "version": 2, "shared": {"scale": term}}
    )


def test_exact_beams_do_not_contribute(straight: Chain, accuracies: dict[str, np.ndarray]) -> None:
    assert [part.name for part in endpoint_budget(straight, STILL, accuracies).contributions] == ["turn", "lift"]


def test_the_contribution_of_beams_agrees_with_a_hand_calculation() -> None:
    chain = Chain(TWO_JOINTS, "tip", beams(bend=False))
    [part] = [
        part
        for part in endpoint_budget(chain, STILL, dict.fromkeys(STILL, np.zeros((6, 6)))).contributions
        if part.name == BEAMS
    ]
    shift, lean = math.sqrt(2.0) * BEAM_SIGMA, math.sqrt(2.0) * BEAM_LEAN
    np.testing.assert_allclose(part.spread.orientation, lean)
    np.testing.assert_allclose(part.spread.displacement[1:], math.hypot(shift, 0.5 * BEAM_LEAN), rtol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("angles", [STILL, {"turn": 0.4, "lift": -1.2}], ids=["extended", "bent"])
@pytest.mark.parametrize("kind", ["exact", "uncertain", "sagging"])
def test_monte_carlo_agrees_with_the_budget(
    kind: str, angles: dict[str, float], accuracies: dict[str, np.ndarray]
) -> None:
    """JCGM 101 beside JCGM 100: 4000 draws know a spread to 1.1 %; 5 % are allowed, the figures near zero left out."""
    chain = Chain(TWO_JOINTS, "tip", None if kind == "exact" else beams(bend=kind == "sagging"))
    linear = endpoint_budget(chain, angles, accuracies).spread
    drawn = monte_carlo(chain, angles, accuracies, DRAWS, 7)
    np.testing.assert_allclose(drawn.orientation, linear.orientation, rtol=0.05)
    np.testing.assert_allclose(drawn.displacement, linear.displacement, rtol=0.05, atol=1e-8)
    assert drawn.total == pytest.approx(linear.total, rel=0.05)


def test_the_same_seed_draws_the_same(straight: Chain, accuracies: dict[str, np.ndarray]) -> None:
    first, again, other = (monte_carlo(straight, STILL, accuracies, 50, seed).total for seed in (3, 3, 4))
    assert first == again != other


def test_errors_are_in_the_axes_of_the_parent() -> None:
    pose = pin.SE3(pin.utils.rotate("z", 0.5 * math.pi), np.array([1.0, 2.0, 3.0]))
    moved = disturbed(pose, np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.2]))
    np.testing.assert_allclose(moved.translation, [1.1, 2.0, 3.0])
    np.testing.assert_allclose(moved.rotation, pin.utils.rotate("z", 0.5 * math.pi + 0.2), atol=1e-15)


def test_a_spread_is_the_square_root_of_the_diagonal() -> None:
    spread = Spread.of(np.diag([1.0, 4.0, 4.0, 9.0, 16.0, 25.0]))
    assert (spread.displacement.tolist(), spread.orientation.tolist()) == ([1.0, 2.0, 2.0], [3.0, 4.0, 5.0])
    assert spread.total == 3.0


def test_the_configurations_are_extended_and_bent_at_the_last_joint() -> None:
    assert configurations(["turn", "lift"]) == {"extended": STILL, "bent": {"turn": 0.0, "lift": 0.5 * math.pi}}


def test_model_covariances_are_split_into_noise_and_calibration(straight: Chain) -> None:
    calibrations = {
        name: sized_design("triad_bumpy_ring", 6.0 * INCH, frames=(f"{name}_r", f"{name}_t"), title=name)
        for name in STILL
    }
    random, systematic, _ = model_covariances(calibrations, straight, {"turn": 2.0, "lift": -1.0})
    assert set(random) == set(systematic) == set(STILL)
    for covariance in (*random.values(), *systematic.values()):
        assert np.all(np.linalg.eigvalsh(covariance) > 0.0)
        assert np.all(np.sqrt(np.diagonal(covariance)) < 10e-6)


def test_calibrations_of_one_name_may_not_contradict_one_another(straight: Chain) -> None:
    calibrations = {
        name: sized_design("triad_bumpy_ring", 6.0 * INCH, frames=(f"{name}_r", f"{name}_t"), title="same").model_copy(
            update={
                "shared": {
                    "scale": SharedTerm(
                        uncertainty=Quantity(value=size, unit="1"),
                        relative={"sensors.0.gap": Quantity(value=1.0, unit="1")},
                    )
                }
            }
        )
        for name, size in zip(STILL, (1e-4, 5e-4), strict=True)
    }
    error = refusal(CalibrationError, model_covariances, calibrations, straight, STILL)
    assert (error.where, error.expected) == ("calibration of lift", "0.0001 1, as in calibration of turn")


def test_a_joint_without_a_valid_pose_is_named(straight: Chain) -> None:
    calibrations = {
        "turn": sized_design("triad_bumpy_ring", 6.0 * INCH, frames=("turn_r", "turn_t"), title="turn"),
        "lift": design("triad_diodes", frames=("lift_r", "lift_t")),
    }
    model_covariances(calibrations, straight, STILL)
    with pytest.raises(ChainError, match=r"^joint 'lift': has no valid pose at 90 degrees .*of its sensors\.$"):
        model_covariances(calibrations, straight, {"turn": 0.0, "lift": 0.5 * math.pi})
