# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Loads of joints: statics by hand."""

from __future__ import annotations

import pytest
from posor_design.joint_loads import bearing_pair, chain_drive, gear_drive, joint_moment


def test_moments_add_up_with_their_signs() -> None:
    found = joint_moment((2.0, 0.5, -1.0), (10.0, 4.0, 6.0))
    assert found.force == 20.0
    assert found.moment == pytest.approx(20.0 + 2.0 - 6.0)


def test_two_bearings_hold_a_moment_as_a_couple() -> None:
    force = bearing_pair(30.0, 0.2).radial_force
    assert 2.0 * force * 0.1 == pytest.approx(30.0)


def test_a_gear_transmits_power_and_force() -> None:
    found = gear_drive(300.0, pinion_diameter=0.1, gear_diameter=0.4)
    assert found.ratio == pytest.approx(4.0)
    assert found.pinion_torque == pytest.approx(75.0)
    assert found.tooth_force * 0.2 == pytest.approx(300.0)
    assert found.tooth_force * 0.05 == pytest.approx(found.pinion_torque)


def test_a_chain_does_the_work_of_its_piston() -> None:
    found = chain_drive(300.0, sprocket_diameter=0.1, piston_area=6e-4, stroke=0.2)
    assert found.travel == pytest.approx(4.0)
    assert found.pressure * 6e-4 * 0.2 == pytest.approx(300.0 * found.travel)
