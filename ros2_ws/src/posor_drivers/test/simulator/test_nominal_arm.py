"""Nominal kinematics for many joint angles at once, against the chain and finite differences."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.chain.arm_file import load_arm_file
from posor_drivers.simulator.nominal_arm import NominalArm

from ..three_joint_arm import JOINTS, write_arm

if TYPE_CHECKING:
    from pathlib import Path


def test_nominal_kinematics_of_many_angles_is_that_of_the_chain(tmp_path: Path) -> None:
    chain = load_arm_file(write_arm(tmp_path)).chain()
    many = np.random.default_rng(1).uniform(-2.0, 2.0, size=(20, 3))
    found = NominalArm(chain).endpoint(many)
    for n, row in enumerate(many):
        expected = chain.nominal_endpoint(dict(zip(JOINTS, row, strict=True)))
        assert np.allclose(found[n].homogeneous, expected.homogeneous, rtol=0.0, atol=1e-14)


def test_jacobian_agrees_with_differences(tmp_path: Path) -> None:
    arm = NominalArm(load_arm_file(write_arm(tmp_path)).chain())
    here = np.random.default_rng(2).uniform(-1.0, 1.0, size=(5, 3))
    _, jacobian = arm.jacobian(here)
    for column in range(3):
        step = 1e-6 * np.eye(3)[column]
        difference = arm.endpoint(here + step).translations - arm.endpoint(here - step).translations
        assert np.allclose(jacobian[:, :, column], difference / 2e-6, rtol=0.0, atol=1e-9)
