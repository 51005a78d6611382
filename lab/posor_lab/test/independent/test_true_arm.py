# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The independent model of an arm: finite elements against textbook cases, pinocchio's kinematics, the simulator."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from posor.chain.arm_file import load_arm_file
from posor.errors import CalibrationError
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.beam_heat import BeamHeat
from posor_drivers.simulator.imperfections import Imperfections
from posor_lab.faults.fault_table import write_fault_arm
from posor_lab.harness.beams import quantity
from posor_lab.independent.finite_elements import end_motions, sag_gains
from posor_lab.independent.true_arm import TrueArm
from posor_lab.mutations.model_checks import ARMS
from posor_lab.shop.shop_arm import write_shop_arm

LENGTH, OVERHANG, MASS = 1.0, 0.2, 2.0
OUTER, INNER, MODULUS, DENSITY = 0.05, 0.04, 70e9, 2700.0
STIFFNESS = MODULUS * np.pi * (OUTER**4 - INNER**4) / 64.0
PER_LENGTH = DENSITY * np.pi * (OUTER**2 - INNER**2) / 4.0


def sag(gimbals: list[float], density: float, masses: list[float]) -> dict[str, Any]:
    """Return the entry of a beam with masses at its ends."""
    tube = {"outer_diameter": quantity(OUTER, "m"), "inner_diameter": quantity(INNER, "m")}
    plates = [
        {"at": quantity(at, "m"), "mass": quantity(mass, "kg")} for at, mass in zip((0.0, LENGTH), masses, strict=True)
    ]
    material = {"modulus": quantity(MODULUS, "Pa"), "density": quantity(density, "kg/m^3")}
    return {"tube": tube | material, "gimbals": quantity(gimbals, "m"), "plates": plates}


def test_a_beam_on_its_ends_has_the_slope_of_the_textbook() -> None:
    slope = PER_LENGTH * LENGTH**3 / (24.0 * STIFFNESS)
    expected = [[0.0, slope], [0.0, -slope]]
    np.testing.assert_allclose(end_motions(LENGTH, sag([0.0, LENGTH], DENSITY, [0.0, 0.0])), expected, atol=1e-12)


def test_masses_on_both_overhangs_bend_the_beam_as_in_the_textbook() -> None:
    a, between = OVERHANG, LENGTH - 2.0 * OVERHANG
    deflection = MASS * a**2 * (3.0 * between + 2.0 * a) / (6.0 * STIFFNESS)
    slope = MASS * a * (between + a) / (2.0 * STIFFNESS)
    found = end_motions(LENGTH, sag([a, LENGTH - a], 1e-9, [MASS, MASS]))
    np.testing.assert_allclose(found, [[deflection, -slope], [deflection, slope]], rtol=1e-8)


def test_only_the_field_across_the_beam_bends_it_and_the_tangent_leans_toward_the_field() -> None:
    start, end = sag_gains(np.array([0.0, 0.0, LENGTH]), sag([0.2, 0.8], 1e-9, [MASS, MASS]))
    for gain in (start, end):
        np.testing.assert_array_equal(gain[:, 2], 0.0)
    deflection, slope = end_motions(LENGTH, sag([0.2, 0.8], 1e-9, [MASS, MASS]))[1]
    # A beam along Z under a field along X: its end moves along X, and its tangent turns from Z toward X, about Y.
    np.testing.assert_allclose(end[:, 0], [deflection, 0.0, 0.0, 0.0, slope, 0.0])


@pytest.mark.parametrize("name", ARMS)
def test_without_gravity_the_endpoint_is_that_of_pinocchio(name: str) -> None:
    arm = load_arm_file(name)
    truth = TrueArm(arm.path)
    truth.gravity = np.zeros(3)
    model = pin.buildModelFromUrdf(str(arm.urdf))
    data, poses = model.createData(), [pin.SE3.Random() for _ in truth.joints]
    local = [origin.actInv(pose) for origin, pose in zip(truth.origins, poses, strict=True)]
    pin.framesForwardKinematics(model, data, np.concatenate([pin.SE3ToXYZQUAT(pose) for pose in local]))
    expected = data.oMf[model.getFrameId(arm.endpoint_frame)]
    rotations, translations = (np.array([[getattr(p, n) for p in poses]]) for n in ("rotation", "translation"))
    rotation, translation = truth.endpoints(rotations, translations)
    np.testing.assert_allclose(rotation[0], expected.rotation, atol=1e-12)
    np.testing.assert_allclose(translation[0], expected.translation, atol=1e-12)


@pytest.mark.parametrize("name", ["five_axis", "six_axis"])
def test_the_simulator_runs_on_the_independent_truth_of_the_scenario(tmp_path: Path, name: Any) -> None:
    arm, switches = write_fault_arm(name, tmp_path / "arm", 20, 7), Imperfections.only("calibration_errors", "sag")
    real, shared = ArmSimulation(arm, switches), ArmSimulation(arm, switches, truth="shared")
    ticks = np.arange(0, real.scenario.cycle_ticks, 20)
    poses, others = real.truth(ticks).endpoint, shared.truth(ticks).endpoint
    np.testing.assert_allclose(poses.translations, others.translations, atol=1e-12)
    for joint in real.joints:
        found, expected = (each.scans(joint, ticks).scans for each in (real, shared))
        gaps = np.abs(found.gap_voltages - expected.gap_voltages)
        assert 0.0 < gaps.max() < 1e-4, joint  # the area of the probes, less than a tenth of the noise
        np.testing.assert_allclose(found.ring_voltages, expected.ring_voltages, atol=1e-4)
        np.testing.assert_allclose(found.diode_currents, expected.diode_currents, atol=1e-11)


@pytest.mark.parametrize(
    ("file", "change", "sentence"),
    [
        ("scenario.yaml", {"truth": "other"}, r"truth 'other' is unknown; expected one of 'shared', 'independent'\.$"),
        ("calibrations/joint1.yaml", {"tilt_angle": "previous_scan"}, "calibration 'test_rig_joint1': the tilt of the"),
    ],
    ids=["truth", "tilt"],
)
def test_a_truth_that_cannot_be_used_is_named(tmp_path: Path, file: str, change: dict[str, Any], sentence: str) -> None:
    arm = write_fault_arm("test_rig", tmp_path / "arm", 20, 7)
    path = tmp_path / "arm" / file
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | change), encoding="utf-8")
    with pytest.raises(CalibrationError, match=sentence):
        ArmSimulation(arm)


def test_a_warm_beam_grows_and_bends_as_the_simulator_computes(tmp_path: Path) -> None:
    path = write_shop_arm(load_arm_file("five_axis"), tmp_path)
    truth, chain = TrueArm(path), load_arm_file(path).chain()
    kelvins, across = np.array([-10.0, 0.0, 7.0]), np.array([3.0, -2.0])
    beams = [(true, known.beam) for true, known in zip(truth.links, chain.links, strict=True) if known.beam is not None]
    assert len(beams) == len(chain.beams)
    for link, beam in beams:
        for sides in (np.zeros(2), across):
            heat = BeamHeat(kelvins, sides, 0.1, kelvins)
            rotations, translations = link.warm_ends(kelvins, sides, 0.1)
            stretched = heat.ends(beam, None)
            strains = 1.1 * 23e-6 * kelvins
            if not sides.any():
                expected = np.multiply.outer(1.0 + strains, link.end.translation)
                np.testing.assert_allclose(translations, expected, rtol=0.0, atol=1e-15)
                np.testing.assert_allclose(rotations, np.tile(link.end.rotation, (3, 1, 1)), atol=1e-15)
                for found, own in zip(stretched, (rotations, translations), strict=True):
                    np.testing.assert_allclose(found, own, rtol=0.0, atol=1e-15)
                continue
            # The directions across are not the same in both; the amounts are, to first order.
            turns = [pin.log3(rotation @ link.end.rotation.T) for rotation in rotations]
            shifts = translations - np.multiply.outer(1.0 + strains, link.end.translation)
            own_turns = [pin.log3(rotation @ link.end.rotation.T) for rotation in stretched[0]]
            own_shifts = stretched[1] - np.multiply.outer(1.0 + strains, link.end.translation)
            for one, other in ((turns, own_turns), (shifts, own_shifts)):
                amounts = np.linalg.norm(one, axis=1), np.linalg.norm(other, axis=1)
                np.testing.assert_allclose(*amounts, rtol=1e-3)
            for turn, shift in zip(turns, shifts, strict=True):  # the beam bends in one plane
                np.testing.assert_allclose(np.cross(turn, link.end.translation) * 0.5, shift, rtol=0.0, atol=1e-6)
