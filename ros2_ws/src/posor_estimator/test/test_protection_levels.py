# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fault effects in the transforms of posor_node, and the protection level that chain_node makes of them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from posor.calibration.designs import STANDOFF
from posor.chain.fault_bounds import COVERAGE_FACTOR
from posor.chain.kinematic_chain import load_chain
from posor.estimation.posor import Posor
from posor.messages.raw_scan import scan_of
from posor.model.scan import Scans
from posor.numerics.array_types import FloatArray
from posor_lab.harness.endpoint_effects import endpoint_effects, expansion_shifts
from posor_lab.harness.graph import Graph
from posor_msgs.msg import JointTransform

from .chain_program import LOSSLESS, URDF, ChainRig, chain_node, transform_of
from .test_posor_services import NodeRig

pytestmark = pytest.mark.usefixtures("ros_domain")

BEAMS = Path(__file__).with_name("warm_beam.yaml")


def test_posor_node_publishes_the_effects_of_faults_with_every_transform(tmp_path: Path) -> None:
    with NodeRig(tmp_path) as rig:
        raw = rig.graph.collect(rig.raw.msg_type, "raw", raw=True)
        rig.send(5, (0.0, 0.0, STANDOFF, 0.0, 0.0, 0.0))
        rig.graph.wait_until(lambda: len(rig.transforms) == len(raw) == 5, "scans and transforms")
    posor = Posor(rig.calibration)
    scans = Scans.of([scan_of(data) for data in raw])
    effects, causes = posor.estimate_all(scans, fault_effects=True).fault_effects, posor.hypotheses.joint_causes()
    for message, expected in zip(rig.transforms, effects, strict=True):
        assert (tuple(message.causes), tuple(message.effect_causes)) == causes[:2]
        assert tuple(message.effect_kinds) == causes.kinds
        np.testing.assert_array_equal(np.reshape(message.effects, expected.shape), expected)
        assert np.isinf(expected[:, 6]).any()  # no other probe checks one of three


def with_effects(message: Any, effects: FloatArray) -> Any:
    """Return a transform with a single fault, a fault of two parameters, and a cause that is always there."""
    message.causes, message.effect_causes = ["alone", "pair", "always"], [0, 1, 1, 2]
    message.effect_kinds = [0, 0, JointTransform.EFFECT_SECOND, JointTransform.EFFECT_ALWAYS]
    message.effects = effects.astype(np.float32).ravel().tolist()
    return message


def test_chain_node_bounds_the_endpoint_by_the_faults_of_the_same_scan() -> None:
    chain = load_chain(URDF, "endpoint", BEAMS)
    effects = np.column_stack([1e-6 * np.random.default_rng(16).normal(size=(4, 6)), np.ones(4)])
    poses = {"joint1": pin.SE3.Identity()}
    matrix, expansion = endpoint_effects(chain, poses)["joint1"], np.abs(expansion_shifts(chain, poses)).sum(axis=0)
    assert expansion.max() == pytest.approx(5.0 * 23e-6 * 0.84836)
    with chain_node(urdf=str(URDF), beams=str(BEAMS), **LOSSLESS), Graph() as graph:
        rig = ChainRig(graph)
        transforms = rig.joint_publisher("joint1")
        seconds = 0

        def answer(change: Any) -> Any:
            """Return the state of a scan whose transform is changed."""
            nonlocal seconds
            seconds += 1
            transform = transform_of(seconds)
            change(transform)

            def has_answer() -> bool:
                return any(each.header.stamp.sec == seconds for each in rig.states)

            transforms.publish(transform)
            graph.wait_until(has_answer, "the state of a scan")
            return next(each for each in rig.states if each.header.stamp.sec == seconds)

        assert np.isnan(answer(lambda _: None).protection_level).all()
        for scale in (1.0, 3.0):  # with each scan, not with an old one
            state = answer(lambda message, scale=scale: with_effects(message, effects * ([scale] * 6 + [1.0])))
            single, first, second, always = np.abs(scale * effects[:, :6] @ matrix.T)
            pair = np.hypot(first, second)
            variances = np.diag(np.reshape(np.add(state.covariance_random, state.covariance_systematic), (6, 6)))
            expected = COVERAGE_FACTOR * np.sqrt(variances) + expansion + np.maximum(single, pair) + always
            np.testing.assert_allclose(state.protection_level, expected, rtol=1e-6)
            causes = [f"joint1: {'alone' if one > two else 'pair'}" for one, two in zip(single, pair, strict=True)]
            assert state.protection_causes == causes
        shift = np.array([1e-6, 2e-6, 3e-6, 4e-6, 5e-6, 6e-6])

        def with_stamp_shift(message: Any) -> None:
            with_effects(message, effects * ([3.0] * 6 + [1.0])).stamp_shift = shift

        state = answer(with_stamp_shift)
        moved, by_stamp = np.array(state.protection_level), np.abs(matrix) @ shift
        first_order = expected + by_stamp
        np.testing.assert_allclose(moved, first_order, rtol=1e-5)  # the level contains the second order too
        assert (moved >= first_order * (1.0 - 1e-6)).all()  # effects have 4 bytes
        does_more = (by_stamp > np.maximum(single, pair)).tolist()
        assert set(does_more) == {True, False}
        assert state.protection_causes == [
            "joint1: stamps" if more else cause for more, cause in zip(does_more, causes, strict=True)
        ]
        open_effects = effects.copy()
        open_effects[0] = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, math.inf]
        state = answer(lambda message: with_effects(message, open_effects))
        np.testing.assert_array_equal(np.isinf(state.protection_level), np.abs(matrix[:, 2]) > 1e-6)
        invalid = effects.copy()
        invalid[2, 6] = -1.0
        assert np.isnan(answer(lambda message: with_effects(message, invalid)).protection_level).all()
