# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Chains whose beams sag and are not exact."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.beam_bending import PointForce, Tube, on_gimbals
from posor.chain.beams_file import BeamsFile
from posor.chain.joint_measurements import MeasuredJoint
from posor.chain.kinematic_chain import Chain
from posor.errors import ChainError, PosorError
from posor.numerics.array_types import FloatArray
from posor_lab.harness.beams import beams_file, plate, quantity, tube, uncertainty
from posor_lab.harness.case_tables import refusal

ARM = Path(__file__).with_name("two_beams.urdf").read_text(encoding="utf-8")
LENGTH = math.hypot(0.8, 0.1)
TUBE = {"outer_diameter": 0.05, "inner_diameter": 0.045, "modulus": 69e9, "density": 2700.0}
GIMBALS = (0.15, 0.7)
MASS = 1.5
FIXED = "mount, upper_arm, forearm"
GRAVITY = 9.80665


def beam(name: str, *, sag: bool, sigma: float = 0.0, sag_sigma: float = 0.0) -> dict[str, Any]:
    known = uncertainty([sigma, 2.0 * sigma, 3.0 * sigma], [sigma, sigma, 2.0 * sigma])
    said: dict[str, Any] = {"joint": name, "uncertainty": known}
    if sag:
        said["sag"] = {
            "tube": tube(TUBE["outer_diameter"], TUBE["inner_diameter"]),
            "gimbals": quantity(list(GIMBALS), "m"),
            "plates": [plate("target", 0.0, MASS), plate("receiving", LENGTH, MASS)],
            "uncertainty": quantity(sag_sigma, "1"),
        }
    return said


def still(rotation: FloatArray | None = None) -> dict[str, MeasuredJoint]:
    """Return the shoulder turned, the elbow not, both exact."""
    shoulder = pin.SE3(np.eye(3) if rotation is None else rotation, np.array([0.0, 0.0, 0.001]))
    return {"shoulder": MeasuredJoint(shoulder), "elbow": MeasuredJoint(pin.SE3.Identity())}


def tangent(moved: pin.SE3, reference: pin.SE3) -> FloatArray:
    """Return the small motion from one pose to another, axes of the base."""
    turn = pin.log3(moved.rotation @ reference.rotation.T)
    return np.concatenate([moved.translation - reference.translation, turn])


def test_a_beam_without_sag_is_that_of_the_urdf() -> None:
    plain = Chain(ARM, "tip").estimate(still()).T_base_endpoint
    with_beams = Chain(ARM, "tip", beams_file(beam("upper_arm", sag=False), beam("forearm", sag=False)))
    np.testing.assert_allclose(
        with_beams.estimate(still()).T_base_endpoint.homogeneous, plain.homogeneous, rtol=0.0, atol=1e-15
    )


def test_a_level_beam_sags_down() -> None:
    """The mount puts Y of the plates up: the beam lies in a vertical plane and dips by 0.1 in 0.8."""
    chain = Chain(ARM, "tip", beams_file(beam("upper_arm", sag=True)))
    sagging = chain.estimate(still()).T_base_endpoint
    straight = Chain(ARM, "tip").estimate(still()).T_base_endpoint
    across = GRAVITY * 0.8 / LENGTH  # gravity across the beam
    section = Tube(**TUBE)
    load = section.mass_per_length * across
    bent = on_gimbals(
        LENGTH,
        section.bending_stiffness,
        load,
        [PointForce(0.0, MASS * across), PointForce(LENGTH, MASS * across)],
        GIMBALS,
    )
    # Seen from the target plate at the beam's start, the other end is lower by both deflections and the start's slope.
    turn = bent.slope(LENGTH) - bent.slope(0.0)
    drop = bent.deflection(LENGTH) - bent.deflection(0.0) - bent.slope(0.0) * LENGTH
    down = np.array([0.1, 0.0, -0.8]) / LENGTH  # across the beam, downward, base axes
    forearm = straight.translation - Chain(ARM, "r2").estimate(still()).T_base_endpoint.translation
    rotation = np.array([0.0, turn, 0.0])  # down is about +Y of the base
    expected = drop * down + np.cross(rotation, forearm)
    found = tangent(sagging, straight)
    assert np.linalg.norm(expected) > 1e-5
    np.testing.assert_allclose(found[3:], rotation, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found[:3], expected, rtol=0.0, atol=1e-8)


def test_a_beam_with_rotated_axes_sags_the_same() -> None:
    """The same arm, but the upper arm's start is turned against the target plate: the same endpoint and covariance."""
    start = pin.utils.rpyToMatrix(0.4, -0.9, 1.7)
    xyz = " ".join(map(str, start.T @ [0.8, 0.1, 0.0]))
    rpy = " ".join(map(str, pin.rpy.matrixToRpy(start.T @ pin.utils.rotate("x", 0.3))))
    turned = ARM.replace(
        '<joint name="upper_arm" type="fixed"><parent link="t1"/>',
        '<link name="clamp"/><joint name="clamping" type="fixed"><parent link="t1"/><child link="clamp"/>'
        '<origin rpy="0.4 -0.9 1.7"/></joint><joint name="upper_arm" type="fixed"><parent link="clamp"/>',
    ).replace('<origin xyz="0.8 0.1 0" rpy="0.3 0 0"/>', f'<origin xyz="{xyz}" rpy="{rpy}"/>')
    said = beams_file(beam("upper_arm", sag=True, sag_sigma=0.2))
    plain, other = (Chain(urdf, "tip", said).estimate(still()) for urdf in (ARM, turned))
    np.testing.assert_allclose(other.T_base_endpoint.homogeneous, plain.T_base_endpoint.homogeneous, atol=1e-14)
    stated = plain.covariance_systematic
    np.testing.assert_allclose(other.covariance_systematic, stated, atol=1e-9 * np.abs(stated).max())


def test_a_hanging_beam_does_not_sag() -> None:
    chain = Chain(ARM, "tip", beams_file(beam("upper_arm", sag=True)))
    down = math.atan2(-1.0, 0.0) - math.atan2(0.1, 0.8)
    hanging = still(pin.utils.rotate("z", down))
    straight = Chain(ARM, "tip").estimate(hanging).T_base_endpoint
    np.testing.assert_allclose(
        chain.estimate(hanging).T_base_endpoint.homogeneous, straight.homogeneous, rtol=0.0, atol=1e-12
    )


def test_acceleration_acts_like_gravity() -> None:
    chain = Chain(ARM, "tip", beams_file(beam("upper_arm", sag=True)))
    straight = Chain(ARM, "tip").estimate(still()).T_base_endpoint
    at_rest = tangent(chain.estimate(still()).T_base_endpoint, straight)
    lifted = chain.estimate(still(), {"upper_arm": np.array([0.0, 0.0, GRAVITY])}).T_base_endpoint
    falling = chain.estimate(still(), {"upper_arm": np.array([0.0, 0.0, -GRAVITY])}).T_base_endpoint
    np.testing.assert_allclose(tangent(lifted, straight), 2.0 * at_rest, rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(tangent(falling, straight), np.zeros(6), rtol=0.0, atol=1e-15)


def test_the_beams_uncertainties_reach_the_endpoint(rng: np.random.Generator) -> None:
    """Monte Carlo: beams drawn from their covariance, the sag from its own, against what the chain states."""
    said = (beam("upper_arm", sag=True, sigma=2e-6, sag_sigma=0.1), beam("forearm", sag=False, sigma=4e-6))
    chain = Chain(ARM, "tip", beams_file(*said))
    joints = still(pin.utils.rotate("z", 0.7))
    endpoint = chain.estimate(joints)
    draws = 8_000
    found = np.empty((draws, 6))
    for n in range(draws):
        pose = chain.links[0].T_nominal
        for index, (name, measured) in enumerate(joints.items()):
            link = chain.links[index + 1]
            assert link.beam is not None
            pose = pose * measured.T_parent_child * link.before
            force = pose.rotation.T @ chain.gravity * (1.0 + link.beam.sag_sigma * rng.normal())
            under = link.beam.T_under(force)
            error = rng.multivariate_normal(np.zeros(6), link.beam.covariance)
            assert name == chain.joints[index].name
            pose = pose * pin.SE3(pin.exp3(error[3:]) @ under.rotation, under.translation + error[:3]) * link.after
        found[n] = tangent(pose, endpoint.T_base_endpoint)
    assert not endpoint.covariance_random.any()  # a beam is common to all scans
    stated = np.sqrt(np.diag(endpoint.covariance_systematic))
    np.testing.assert_allclose(np.sqrt(np.mean(found**2, axis=0)), stated, rtol=0.03)
    assert np.abs(np.mean(found, axis=0)).max() < 0.05 * stated.max()


def test_gravity_of_the_beams_file_is_used() -> None:
    level = {"gravity": {"value": [0.0, 9.0, 0.0], "unit": "m/s^2"}}
    turned = BeamsFile.model_validate({**beams_file(beam("upper_arm", sag=True)).model_dump(), **level})
    chain = Chain(ARM, "tip", turned)
    straight = Chain(ARM, "tip").estimate(still()).T_base_endpoint
    moved = tangent(chain.estimate(still()).T_base_endpoint, straight)
    assert abs(moved[1]) > 1e-5
    assert np.abs(moved[[0, 2]]).max() < 0.2 * abs(moved[1])


def test_links_connect_the_plates() -> None:
    chain = Chain(ARM, "tip", beams_file(beam("forearm", sag=False)))
    assert [link.beam and link.beam.name for link in chain.links] == [None, None, "forearm"]
    pose = chain.links[0].T_nominal
    for joint, link in zip(("shoulder", "elbow"), chain.links[1:], strict=True):
        pose = pose * chain.nominal_joint(joint, 0.3) * link.T_nominal
    nominal = chain.nominal_endpoint({"shoulder": 0.3, "elbow": 0.3})
    np.testing.assert_allclose(nominal.homogeneous, pose.homogeneous, rtol=0.0, atol=1e-15)
    measured = {name: MeasuredJoint(chain.nominal_joint(name, 0.3)) for name in ("shoulder", "elbow")}
    straight = Chain(ARM, "tip").estimate(measured).T_base_endpoint
    np.testing.assert_allclose(nominal.homogeneous, straight.homogeneous, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize(
    ("said", "where", "what"),
    [
        (beam("wrist", sag=False), "arm.urdf", "has no fixed joint 'wrist', which the beams file names"),
        (beam("elbow", sag=False), "arm.urdf", "has no fixed joint 'elbow', which the beams file names"),
        (beam("forearm", sag=True), "beams.yaml, beam 'forearm'", "gimbal at 0.7 m"),
    ],
)
def test_beams_that_do_not_fit_the_urdf_are_refused(said: dict[str, Any], where: str, what: str) -> None:
    if "sag" in said:
        said["sag"]["plates"] = []
    error = refusal(ChainError, Chain, ARM, "tip", beams_file(said), source="arm.urdf", beams_source="beams.yaml")
    expected = f"one of {FIXED}" if where == "arm.urdf" else "0 to 0.5 m, the beam's length"
    assert (error.where, error.what, error.expected) == (where, what, expected)


@pytest.mark.parametrize(("link", "at", "there"), [("t1", 0.3, "0"), ("r2", 0.7, "0.806226"), ("far_plate", 0.7, None)])
def test_a_plate_is_where_the_urdf_has_the_link_of_its_name(link: str, at: float, there: str | None) -> None:
    said = beam("upper_arm", sag=True)
    said["sag"]["plates"] = [plate(link, at, MASS), plate("t1", 0.03, MASS)]  # the second is near enough
    if there is None:
        Chain(ARM, "tip", beams_file(said))
        return
    error = refusal(ChainError, Chain, ARM, "tip", beams_file(said), beams_source="beams.yaml")
    assert str(error) == (
        f"beams.yaml, beam 'upper_arm': plate '{link}' at {at:g} m; expected {there} m, where the URDF has the link of "
        "this name; the gimbals may be wrong, too."
    )


def test_a_beam_beyond_the_linear_theory_is_refused() -> None:
    said = beam("upper_arm", sag=True)
    said["sag"]["tube"]["modulus"]["value"] = 1e8
    error = refusal(ChainError, Chain, ARM, "tip", beams_file(said), beams_source="beams.yaml")
    assert str(error) == (
        "beams.yaml, beam 'upper_arm': sags by 0.0088 m, with a slope of 0.0641 rad, under its weight; expected at "
        "most 0.00806 m and 0.01 rad, as far as the linear theory holds (modulus in GPa, diameters in mm, density in "
        "g/cm^3 or masses in g?)."
    )


def test_a_plate_that_is_too_heavy_for_its_beam_is_refused() -> None:
    said = beam("upper_arm", sag=True)
    said["sag"]["plates"][1]["mass"]["value"] = 150.0
    error = refusal(ChainError, Chain, ARM, "tip", beams_file(said), beams_source="beams.yaml")
    assert str(error) == (
        "beams.yaml, beam 'upper_arm': plate 'receiving' has 150 kg; expected at most 30 times the mass of its tube, "
        "0.812 kg (masses in g, or lengths in mm?)."
    )


def test_two_beams_need_a_posor_between() -> None:
    split = ARM.replace('child link="tip"/><origin xyz="0.5 0 0"/></joint>', 'child link="mid"/></joint>').replace(
        '<link name="tip"/>',
        '<link name="mid"/><link name="tip"/>'
        '<joint name="hand" type="fixed"><parent link="mid"/><child link="tip"/><origin xyz="1 0 0"/></joint>',
    )
    two = beams_file(beam("forearm", sag=False), beam("hand", sag=False))
    assert (
        "'forearm' and 'hand' follow each other without a POSOR between"
        in refusal(PosorError, Chain, split, "tip", two).what
    )
