# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The chain of uncertain transforms: derivatives against differences, endpoints against those of the chain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.arm_file import load_arm_file
from posor.chain.joint_measurements import MeasuredJoint
from posor_calibration.arm.arm_model import ArmModel, ArmPoses, ArmStates
from posor_calibration.arm.arm_poses import poses_at
from posor_lab.arm_study.shared_arm import write_shared_arm

ARM = Path(__file__).resolve().parents[4] / "src" / "posor_bringup" / "arms" / "five_axis" / "arm.yaml"
T_REFERENCE_BASE = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 2.0), np.array([2.0, 1.0, -0.5]))
STEP = 1e-6
Case = tuple[ArmModel, ArmPoses, ArmStates]


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    arm = load_arm_file(write_shared_arm(load_arm_file(ARM), tmp_path_factory.mktemp("shared")))
    chain, calibrations = arm.chain(), {name: arm.calibration(name) for name in arm.calibrations}
    angles = np.random.default_rng(2).uniform(-0.8, 0.8, (3, len(chain.joints)))
    poses = poses_at(chain, calibrations, angles)
    model = ArmModel(chain, calibrations, poses)
    return model, poses, model.states(poses, model.effects_at(poses))


def test_without_errors_the_endpoints_and_their_covariances_are_those_of_the_chain(case: Case) -> None:
    model, poses, states = case
    motion = model.move(states, np.zeros(len(model.parameters)), pin.SE3.Identity())
    of_arm = motion.by_parameter[:, :, 6:]
    common = of_arm @ model.prior[6:, 6:] @ of_arm.swapaxes(1, 2)
    own = np.einsum("njab,njbc,njdc->nad", motion.by_joint, states.own, motion.by_joint)
    effects = model.effects_at(poses)
    for n, endpoint in enumerate(motion.endpoints):
        parts = zip(poses.transforms[n], poses.random[n], poses.systematic[n], effects, strict=True)
        measured = [
            MeasuredJoint(
                pin.XYZQUATToSE3(T), random, systematic, {name: each[n] for name, each in terms.shared.items()}
            )
            for T, random, systematic, terms in parts
        ]
        found = model.chain.estimate(dict(zip(model.joints, measured, strict=True)))
        np.testing.assert_allclose(endpoint.actInv(found.T_base_endpoint).homogeneous, np.eye(4), atol=1e-12)
        turn = np.kron(np.eye(2), endpoint.rotation)
        whole, stated = turn @ (common + own)[n] @ turn.T, found.covariance()
        np.testing.assert_allclose(
            np.diagonal(whole), np.diagonal(stated), rtol=0.2
        )  # which part of a POSOR's error varies differs from pose to pose


def test_the_derivatives_are_those_of_differences(case: Case) -> None:
    model, _, states = case
    count = len(model.parameters)
    values = 1e-3 * np.random.default_rng(3).normal(size=count)
    motion = model.move(states, values, T_REFERENCE_BASE)
    for k, parameter in enumerate(model.parameters):
        shift = STEP * np.eye(count)[k]
        ends = [model.move(states, values + sign * shift, T_REFERENCE_BASE).endpoints for sign in (1.0, -1.0)]
        differences = [pin.log6(b.actInv(a)).vector / (2.0 * STEP) for a, b in zip(*ends, strict=True)]
        np.testing.assert_allclose(motion.by_parameter[:, :, k], differences, atol=2e-9, err_msg=parameter.name)
