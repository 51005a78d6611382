"""Reliability of a joint from posor_node, and the protection level that chain_node makes of it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from posor.calibration.designs import STANDOFF
from posor.chain.kinematic_chain import load_chain
from posor.estimation.posor import Posor
from posor.model.native_coordinates import rotation_from_native
from posor.numerics.array_types import FloatArray
from posor.uncertainty.budget_poses import scan_at
from posor.uncertainty.protection_level import (
    endpoint_effects,
    endpoint_protection_level,
    expansion_bound,
    expansion_shifts,
)
from posor.uncertainty.reliability import joint_reliability
from posor_lab.harness.graph import Graph, set_stamp
from posor_msgs.msg import EndpointState, JointReliability, JointTransform

from .chain_program import LOSSLESS, PLATES, chain_node, transform_of
from .test_posor_services import NodeRig

pytestmark = pytest.mark.usefixtures("ros_domain")

URDF = Path(__file__).resolve().parents[2] / "posor_bringup" / "urdf" / "slocum1985_rig.urdf"
BEAMS = Path(__file__).with_name("warm_beam.yaml")


def test_posor_node_publishes_what_its_redundancy_detects(tmp_path: Path) -> None:
    with NodeRig(tmp_path) as rig:
        assert rig.graph.node.count_publishers("reliability") == 1
        messages = rig.graph.collect(JointReliability, "reliability")
        _, transform = rig.send(2, (0.0, 0.0, STANDOFF, 0.0, 0.0, 0.0))
        rig.graph.wait_until(lambda: bool(messages), "a reliability")
    posor, native = Posor(rig.calibration), transform.native
    pose = pin.SE3(rotation_from_native(*native[3:]), native[:3])
    expected, found = joint_reliability(posor, scan_at(posor, pose), pose), messages[0]
    frames = rig.calibration.frames
    assert (found.header.frame_id, found.child_frame_id) == (frames.parent, frames.child)
    assert found.header.stamp.nanosec == 2_000_000
    assert (found.false_alarm, found.missed_detection) == pytest.approx((1e-3, 1e-2))
    assert tuple(found.readings) == expected.names
    assert np.isinf(found.detectable_biases[:3]).all()
    np.testing.assert_allclose(found.detectable_biases, expected.biases, rtol=0.01)
    shifts, known = np.reshape(found.undetected_shifts, (-1, 6)), expected.shifts
    bounded = np.isfinite(known).all(axis=1)
    assert bounded.any()
    np.testing.assert_array_equal(np.isinf(shifts[~bounded]).any(axis=1), np.True_)
    scale = np.repeat([np.abs(known[bounded, part]).max() for part in (slice(3), slice(3, 6))], 3)
    np.testing.assert_allclose(shifts[bounded] / scale, known[bounded] / scale, rtol=0.0, atol=0.01)


def reliability_message(shifts: FloatArray, plates: tuple[str, str] = PLATES) -> Any:
    message = set_stamp(JointReliability(child_frame_id=plates[1]), 1)
    message.header.frame_id = plates[0]
    message.readings = [f"reading {n}" for n in range(len(shifts))]
    message.detectable_biases, message.undetected_shifts = [1e-6] * len(shifts), shifts.ravel().tolist()
    return message


def test_chain_node_bounds_the_endpoint_by_the_worst_undetected_shift_and_the_warmest_beam() -> None:
    chain = load_chain(URDF, "endpoint", BEAMS)
    random = np.random.default_rng(16)
    shifts = 1e-6 * random.normal(size=(7, 6))
    with chain_node(urdf=str(URDF), beams=str(BEAMS), **LOSSLESS), Graph() as graph:
        states = graph.collect(EndpointState, "endpoint/state")
        transforms = graph.publisher(JointTransform, "joint1/transform")
        reliabilities = graph.publisher(JointReliability, "joint1/reliability")
        seconds, stamp_shift = 0, np.zeros(6)

        def level_after(message: Any, accepts: Any) -> FloatArray:
            """Return the first protection level that ``accepts`` after a message."""

            def send() -> None:
                nonlocal seconds
                seconds += 1
                transform = transform_of(seconds)
                transform.stamp_shift = stamp_shift
                transforms.publish(transform)

            reliabilities.publish(message)
            graph.wait_until(lambda: bool(states) and accepts(np.array(states[-1].protection_level)), "a level", send)
            return np.array(states[-1].protection_level)

        wrong = reliability_message(shifts, ("elsewhere", "posor_target"))
        level_after(wrong, lambda level: np.isnan(level).all() and seconds > 10)
        too_few = reliability_message(shifts[:5])  # no six freedoms: forged, or of something else
        level_after(too_few, lambda level: np.isnan(level).all() and seconds > 20)
        level_after(b"\x00\x01 no message", lambda level: np.isnan(level).all() and seconds > 30)
        found = level_after(reliability_message(shifts), lambda level: np.isfinite(level).all())
        covariance = np.reshape(states[-1].covariance_random + states[-1].covariance_systematic, (6, 6))
        poses = {"joint1": pin.SE3.Identity()}
        effects, expansions = endpoint_effects(chain, poses)["joint1"], expansion_shifts(chain, poses)
        assert expansion_bound(expansions).max() == pytest.approx(5.0 * 23e-6 * 0.84836)
        expected = endpoint_protection_level([shifts], [effects], covariance, expansions)
        np.testing.assert_allclose(found, expected, rtol=1e-9)
        stamp_shift = np.array([1e-6, 2e-6, 3e-6, 4e-6, 5e-6, math.inf])
        moved = level_after(reliability_message(shifts), lambda level: np.isinf(level).any())
        affected = np.abs(effects[:, 5]) > 0.0
        np.testing.assert_array_equal(np.isinf(moved), affected)
        by_stamp = np.abs(effects[~affected, :5]) @ stamp_shift[:5]
        np.testing.assert_allclose(moved[~affected], expected[~affected] + by_stamp, rtol=1e-9)
        stamp_shift = np.zeros(6)
        other = graph.publisher(JointReliability, "joint1/reliability")
        level_after(reliability_message(shifts), lambda level: np.isnan(level).all())
        graph.node.destroy_publisher(other)
        level_after(reliability_message(shifts), lambda level: np.isfinite(level).all())
        shifts[2, 2] = math.inf
        unbounded = level_after(reliability_message(shifts), lambda level: np.isinf(level).any())
        np.testing.assert_array_equal(np.isinf(unbounded), np.abs(effects[:, 2]) > 1e-9)
