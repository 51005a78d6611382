# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Shared terms along the chain: effects of joints and beams are added before they are squared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.arm_file import load_arm_file
from posor.chain.beams_file import BeamsFile, load_beams
from posor.chain.joint_measurements import SHARED_TOO_LARGE, JointRowLayout, MeasuredJoint
from posor.chain.kinematic_chain import Chain
from posor.model.native_coordinates import native_from_rotation
from posor.numerics.array_types import FloatArray

from .six_axis_arm import FOLDER, JOINTS, assert_bits

SCALE, HEAVIER = 1e-3, 1e-2  # relative standard uncertainties of the beams' lengths and of gravity
ARM = load_arm_file(FOLDER / "arm.yaml")


def chain_with(*, terms: bool, gravity: float = 1.0, sag: bool = True) -> Chain:
    """Return the six-axis arm; ``terms``: with a common scale of all beams, and a common change of their sag."""
    assert ARM.beams is not None
    content: dict[str, Any] = load_beams(ARM.beams).model_dump(mode="json")
    content["gravity"]["value"] = [gravity * g for g in content["gravity"]["value"]]
    names = [beam["joint"] for beam in content["beams"]]
    bent = [beam["joint"] for beam in content["beams"] if beam["sag"]]
    if not sag:
        content["beams"] = [{**beam, "sag": None} for beam in content["beams"]]
    one = {"value": 1.0, "unit": "1"}
    if terms:
        content["shared"] = {
            "scale": {"uncertainty": {"value": SCALE, "unit": "1"}, "relative": {f"{n}.position": one for n in names}}
        }
    if terms and sag:
        weight = {"uncertainty": {"value": HEAVIER, "unit": "1"}, "relative": {f"{n}.sag": one for n in bent}}
        content["shared"]["weight"] = weight
    return Chain(ARM.urdf.read_text(encoding="utf-8"), "endpoint", BeamsFile.model_validate(content))


@pytest.fixture
def measured(rng: np.random.Generator) -> dict[str, MeasuredJoint]:
    """Joints at angles of their own, each with the term ``scale`` and some with one of their own kind."""
    joints = {}
    for n, joint in enumerate(chain_with(terms=False).joints):
        pose = chain_with(terms=False).nominal_joint(joint.name, float(rng.uniform(-1.0, 1.0)))
        effects = {"bench": 1e-6 * rng.normal(size=6)} if n % 2 else {}
        effects["scale"] = 1e-6 * rng.normal(size=6)
        root = 1e-6 * rng.normal(size=(6, 6))
        systematic = root @ root.T + sum(np.outer(each, each) for each in effects.values())
        joints[joint.name] = MeasuredJoint(pose, 0.5 * root @ root.T, systematic, effects)
    return joints


def moved(joint: MeasuredJoint, effect: FloatArray) -> MeasuredJoint:
    T = joint.T_parent_child
    return MeasuredJoint(pin.SE3(pin.exp3(effect[3:]) @ T.rotation, T.translation + effect[:3]))


def endpoint_of_links(chain: Chain, measured: Mapping[str, MeasuredJoint], scale: float) -> pin.SE3:
    """Return the endpoint by links whose beams are longer by a relative ``scale``, without sag."""
    pose = pin.SE3.Identity()
    poses = [joint.T_parent_child for joint in measured.values()]
    for link, own in zip(chain.links, [*poses, pin.SE3.Identity()], strict=True):
        beam = pin.SE3.Identity() if link.beam is None else link.beam.T_start_end
        pose = pose * link.before * pin.SE3(beam.rotation, (1.0 + scale) * beam.translation) * link.after * own
    return pose


def difference(above: pin.SE3, below: pin.SE3, steps: float) -> FloatArray:
    turn = pin.log3(above.rotation @ below.rotation.T)
    return np.concatenate([above.translation - below.translation, turn]) / steps


def test_the_effects_are_those_of_one_error_in_all_joints_and_beams(measured: dict[str, MeasuredJoint]) -> None:
    """Against chains whose joints are displaced, whose beams are longer, and whose gravity is stronger."""
    for sag in (False, True):
        chain = chain_with(terms=True, sag=sag)
        found = chain.estimate(measured).shared_effects
        assert set(found) == {"scale", "bench", *(["weight"] if sag else [])}
        for term, scale in (("bench", 0.0), ("scale", SCALE)):
            above, below = (
                {
                    name: moved(each, step * each.shared_effects.get(term, np.zeros(6)))
                    for name, each in measured.items()
                }
                for step in (0.5, -0.5)
            )
            ends = endpoint_of_links(chain, above, 0.5 * scale), endpoint_of_links(chain, below, -0.5 * scale)
            expected = difference(*ends, 1.0)
            np.testing.assert_allclose(found[term], expected, rtol=2e-3 if sag else 1e-6, atol=1e-9)
        if sag:
            heavy, light = (chain_with(terms=False, gravity=g).estimate(measured) for g in (1.001, 0.999))
            expected = HEAVIER * difference(heavy.T_base_endpoint, light.T_base_endpoint, 2e-3)
            np.testing.assert_allclose(found["weight"], expected, atol=1e-3 * np.abs(expected).max())


def test_the_covariance_contains_the_square_of_each_sum(measured: dict[str, MeasuredJoint]) -> None:
    chain, without = chain_with(terms=True), chain_with(terms=False)
    found = chain.estimate(measured)
    own = {}
    for name, each in measured.items():
        squares = sum(np.outer(effect, effect) for effect in each.shared_effects.values())
        own[name] = MeasuredJoint(each.T_parent_child, each.covariance_random, each.covariance_systematic - squares)
    alone = without.estimate(own)
    sums = np.array(list(found.shared_effects.values()))
    expected = alone.covariance_systematic + sums.T @ sums
    np.testing.assert_allclose(found.covariance_systematic, expected, atol=1e-12 * np.abs(expected).max())
    assert_bits(found.covariance_random, alone.covariance_random)
    assert_bits(pin.SE3ToXYZQUAT(found.T_base_endpoint), pin.SE3ToXYZQUAT(alone.T_base_endpoint))
    # Taken as independent, the joints' terms are smaller or larger: the sum is what counts.
    independent = without.estimate({name: replace(each, shared_effects={}) for name, each in measured.items()})
    assert np.abs(found.covariance_systematic / independent.covariance_systematic - 1.0).max() > 0.1


def test_one_scan_many_scans_rows_and_axes_at_home_give_the_same(measured: dict[str, MeasuredJoint]) -> None:
    layouts = [
        JointRowLayout(8, 64, 112, 400, shared=688, effects=0, stamp_shift=1072, state=3, size=1120)
        for _ in range(JOINTS)
    ]
    chain = chain_with(terms=True)
    one, rows = (chain.estimator(row_layouts=layouts) for _ in range(2))
    one.set_measurements(measured)
    assert one.estimate()
    terms = [tuple(each.shared_effects) for each in measured.values()]
    rows.use_terms(terms)
    effects = np.zeros((1, JOINTS, 2, 6))
    for j, each in enumerate(measured.values()):
        numbers, own_pose = rows.rows[j].view(np.float64), each.T_parent_child
        numbers[1:8] = one.poses[j]
        numbers[8:14] = *own_pose.translation, *native_from_rotation(own_pose.rotation)
        numbers[14:50], numbers[50:86] = each.covariance_random.ravel(), each.covariance_systematic.ravel()
        own = np.array(list(each.shared_effects.values()))
        numbers[86 : 86 + own.size], effects[0, j, : len(own)] = own.ravel(), own
    assert rows.estimate_rows(0) == 0
    many = chain.estimator()
    many.use_terms(terms)
    parts = one.poses[None], one.covariances_random[None], one.covariances_systematic[None]
    found = many.estimate_all(*parts, shared_effects=effects)
    for other in (rows.covariance_systematic, found.covariances_systematic[0]):
        assert_bits(other, one.covariance_systematic)
    assert_bits(list(rows.shared_effects.values()), list(one.shared_effects.values()))
    assert_bits(found.shared_effects[0], list(one.shared_effects.values()))
    one.estimate_relative_to(one.pose)
    back = np.kron(np.eye(2), pin.XYZQUATToSE3(one.pose).rotation.T)
    expected = back @ one.covariance_systematic @ back.T
    np.testing.assert_allclose(one.relative_covariance_systematic, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("factor", [2.0, np.nan])
def test_effects_that_exceed_the_covariance_are_refused(factor: float, measured: dict[str, MeasuredJoint]) -> None:
    name, joint = next(iter(measured.items()))
    effects = {"scale": factor * np.sqrt(np.diagonal(joint.covariance_systematic))}
    estimator = chain_with(terms=True).estimator()
    estimator.set_measurements({**measured, name: replace(joint, shared_effects=effects)})
    assert not estimator.estimate()
    assert estimator.faults.tolist() == [SHARED_TOO_LARGE] + [0] * (JOINTS - 1)
