# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Joints estimated block after block: each joint's numbers are those of its scans one by one."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin
import pytest
import yaml
from posor import load_arm, simulate
from posor.bags.arm_estimator import ArmEstimator, EndpointPipeline
from posor.bags.reprocess_task import JointSettings, Settings
from posor.calibration.calibration_file import Calibration
from posor.calibration.designs import DesignName, design
from posor.estimation.estimate import Estimates
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.messages.estimate_arrays import estimate_joint
from posor.messages.joint_transform import TransformConstants
from posor.messages.raw_scan import RecordedScans
from posor.model.fault import Fault, State
from posor.model.native_coordinates import rotation_from_native
from posor.node_parameters import ChainParameters
from posor.numerics.stamps import NS
from posor_lab.harness.endpoint_effects import endpoint_effects

ARMS = Path(__file__).resolve().parents[3] / "posor_bringup" / "arms"
DESIGNS: tuple[DesignName, ...] = ("triad_diodes", "triad_bumpy_ring", "triad_diodes")


def recorded_scans(calibration: Calibration, begin: int, count: int) -> RecordedScans:
    """Return scans of a target that turns, recorded a millisecond apart."""
    ticks = np.arange(begin + 1, begin + count + 1)
    rotations = np.array([rotation_from_native(1e-4, -2e-4, 1e-4 * tick) for tick in ticks])
    translations = np.tile([2e-5, 1e-5, 0.7e-3], (count, 1))
    scans = scans_at(Posor(calibration).stack, rotations, translations, ticks * 1_000_000)
    stamps = np.column_stack(np.divmod(scans.stamps_ns, NS))
    return RecordedScans(ticks, ticks, scans, stamps, np.zeros(count, dtype=np.int64), calibration.frames.parent)


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    joints = {}
    for n, name in enumerate(DESIGNS):
        path = tmp_path / f"joint_{n}.yaml"
        path.write_text(yaml.safe_dump(design(name).model_dump(mode="json", exclude_defaults=True)), encoding="utf-8")
        joints[f"joint_{n}"] = JointSettings(path)
    return Settings(joints)


def test_each_joint_gets_the_poses_of_its_scans_one_by_one(settings: Settings) -> None:
    estimator = ArmEstimator(settings)
    posors = {name: Posor(joint.load()) for name, joint in settings.joints.items()}
    for block in range(3):
        begin = 40 * block
        # The first joint has fewer scans, the second has scans in three parts, the third none for a while.
        bounds = {
            "joint_0": [begin, begin + 37],
            "joint_1": [begin, begin + 20, begin + 21, begin + 40],
            "joint_2": [begin] if block == 1 else [begin, begin + 40],
        }
        scans = {
            name: [recorded_scans(posors[name].calibration, a, b - a) for a, b in pairwise(cuts)]
            for name, cuts in bounds.items()
        }
        found = estimator.estimate_block(scans)
        assert len(found.endpoint) == 0
        for name, posor in posors.items():
            expected = [posor.estimate(part.scans[n]) for part in scans[name] for n in range(len(part))]
            joint = found.joints[name]
            assert joint.states.tolist() == [each.state for each in expected]
            assert joint.numbers.tolist() == [each.number for each in expected]
            for n, each in enumerate(expected):
                assert joint.covariances()[n].tobytes() == each.covariance().tobytes()
                np.testing.assert_allclose(joint.natives[n], each.native, rtol=0.0, atol=1e-14)
                assert joint.residuals[n] == each.residual or np.isnan(each.residual)
    summary, endpoint = estimator.summarise()
    assert endpoint is None
    assert [joint.scans for joint in summary.values()] == [111, 120, 80]


def test_limits_of_the_stamps_reach_the_endpoint() -> None:
    """The endpoint's bound is the sum of the joints' effects, but for the sag of the beams."""
    arm = load_arm(ARMS / "six_axis" / "arm.yaml")
    chain, count = arm.chain(), 40
    numbers = np.arange(count)
    poses, thetas = np.zeros((count, 7)), 2e-3 * numbers
    poses[:, 2], poses[:, 5], poses[:, 6] = 0.735e-3, np.sin(0.5 * thetas), np.cos(0.5 * thetas)
    fields = {"stamps_ns": NS + 5_000_000 * numbers, "numbers": numbers.astype(np.uint64)}
    joints, transforms, orders = {}, {}, {}
    for n, name in enumerate(arm.calibrations):
        calibration = arm.calibration(name)
        limits = {"stamp_limits": np.full(count, n * 1e-3)}  # of the first joint, none
        joints[name] = Posor(calibration).estimate_all(
            simulate(calibration, poses, seed=n).with_fields(fields | limits)
        )
        frames = calibration.frames
        transforms[name], orders[name] = TransformConstants(frames.parent, frames.child), numbers
    parameters = ChainParameters(urdf=str(arm.urdf), endpoint_frame=arm.endpoint_frame)
    found = EndpointPipeline(chain, parameters, transforms).estimate(joints, orders)
    assert len(found) > 0.9 * count
    n = int(np.searchsorted(fields["stamps_ns"], found.stamps_ns[-1]))
    transforms = {name: pin.XYZQUATToSE3(each.poses[n]) for name, each in joints.items()}
    effects = endpoint_effects(chain, transforms)
    expected = sum(np.abs(effects[name]) @ each.stamp_shifts[n] for name, each in joints.items())
    assert (found.stamp_shifts[-1] >= expected).all()
    np.testing.assert_allclose(found.stamp_shifts[-1], expected, rtol=0.1)  # with the turns on one another
    assert found.stamp_shifts[-1].min() > 0.0


@pytest.mark.parametrize(("reference", "first", "degraded"), [("home", 1, 20), ("home", 0, 0), ("absolute", 1, 1)])
def test_poses_relative_to_a_degraded_home_are_degraded(
    reference: Literal["absolute", "home"], first: int, degraded: int
) -> None:
    arm, count = load_arm(ARMS / "test_rig" / "arm.yaml"), 20
    (name,) = arm.calibrations
    calibration, poses = arm.calibration(name), np.tile([0.0, 0.0, 0.735e-3, 0.0, 0.0, 0.0, 1.0], (count, 1))
    found = Posor(calibration).estimate_all(simulate(calibration, poses, rate=100.0, seed=1))
    found._records = found._records.copy()
    found._records["state"] = np.where(np.arange(count) < first, int(State.DEGRADED), int(State.OK))
    transforms = {name: TransformConstants(calibration.frames.parent, calibration.frames.child)}
    parameters = ChainParameters(urdf=str(arm.urdf), endpoint_frame=arm.endpoint_frame, reference=reference)
    pipeline = EndpointPipeline(arm.chain(), parameters, transforms)
    marked: list[bool] = []
    for part in (slice(0, 5), slice(5, count)):
        marked += pipeline.estimate({name: found.select(part)}, {name: np.arange(count)[part]}).degraded.tolist()
    assert marked == [n < degraded for n in range(count)]
    assert (pipeline.poses, pipeline.degraded) == (count, degraded)
    homes = sum(n for reason, n in pipeline.affected_by_beams.items() if reason.startswith("home was taken"))
    assert homes == (count if reference == "home" and first else 0)


def test_scans_of_another_frame_or_without_a_stamp_are_lost_and_the_others_are_as_without_them() -> None:
    calibration = design("triad_diodes")
    scans = recorded_scans(calibration, 0, 30)
    spoilt = recorded_scans(calibration, 0, 30)
    without = np.zeros(30, dtype=np.bool_)
    without[[0, 7, 8]] = True
    stamps_ns = np.where(without, 0, spoilt.scans.stamps_ns)
    spoilt = replace(spoilt, scans=spoilt.scans.with_fields({"stamps_ns": stamps_ns}))
    found = estimate_joint(Posor(calibration), spoilt)
    expected = estimate_joint(Posor(calibration), scans.select(~without))
    kept = found.select(~without)
    assert kept.poses.tobytes() == expected.poses.tobytes()
    assert kept.covariances().tobytes() == expected.covariances().tobytes()
    lost = found.select(without)
    assert set(lost.states) == {State.LOST}
    assert set(lost.faults) == {Fault.BAD_READING}
    assert np.isnan(lost.poses).all()
    assert np.isnan(lost.covariances()).all()
    assert found.lost_reasons() == {
        "scan 0: the stamp is zero, or its nanoseconds are a second or more; expected the time of exposure.": 3
    }
    elsewhere = estimate_joint(Posor(calibration), replace(scans, frame="elsewhere"))
    assert elsewhere.lost_reasons() == {"scan 0: comes from another frame than that of the calibration.": 30}


def test_estimates_in_parts_are_those_of_the_whole() -> None:
    found = estimate_joint(Posor(design("triad_diodes")), recorded_scans(design("triad_diodes"), 0, 9))
    again = Estimates.concatenate([found.select(slice(4)), found.select(np.arange(4, 9))])
    for name in ("numbers", "poses", "log_times_ns", "header_stamps", "statuses", "standard_uncertainties"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))
        assert not getattr(again, name).flags.writeable or name == "standard_uncertainties"
    assert len(Estimates.concatenate([found.select(slice(0)), found.select(slice(0))])) == 0
