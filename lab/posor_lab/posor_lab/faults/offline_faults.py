# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faults without nodes: faults that no reading shows, and slips of light sources, in simulated scans. No ROS.

A case of a hidden fault is one scan of a joint at a random pose, with sensors drawn within the uncertainties of their
calibration and one gap probe that is off. It is covered if the error of the pose is within the protection level along
and about every axis, or if there is no pose. The row of the measuring beams is about the endpoint of the whole arm.
``inject`` of a row: ``volts``, or the share of the minimal detectable bias ``detectable``, or the warming ``beams``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from posor.calibration.designs import sized_design
from posor.chain.arm_file import load_arm_file
from posor.errors import PosorError
from posor.estimation.posor import Posor
from posor.model.fault import USABLE_STATES, Fault, State
from posor.model.scan import NO_SOURCE
from posor.numerics.stamps import NS
from posor.numerics.vector import thetas_of
from posor.sensors.diodes import DiodesCalibration
from posor.uncertainty.protection_level import joint_protection_levels
from posor.uncertainty.reliability import joint_reliability
from posor_drivers.simulator.pose_array import PoseArray

from posor_lab.faults.cause_injection import draw_sensors
from posor_lab.faults.fault_table import RowResult
from posor_lab.faults.pose_judge import SIGMAS, estimated_poses, small_errors, wrong_poses
from posor_lab.independent.true_arm import TrueArm
from posor_lab.true_scans import TruePosor

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

    from posor_lab.faults.fault_table import FaultRow

CASES, MOST_BEAM_CASES = 300, 50
JOINT = "elbow"
AXES = ("x", "y", "z", "about X", "about Y", "about Z")
GAP = np.array([0.0, 0.0, 0.735e-3])  # origin of a target plate at home [m]
EXPANSION = 23e-6  # thermal expansion of aluminium [1/K]
SLIP_SCANS, SLIP_RATE = 12, 500
AMBIENT_SCANS = 60
LATER = 6  # scan at which the later slips begin


def run_hidden(row: FaultRow, seed: int, cases: int = CASES) -> RowResult:
    """Return the result of a hidden fault: share of its cases that are covered, wrong poses published as valid."""
    random = np.random.default_rng(seed)
    if "beams" in row.inject:
        lost, found = 0, _warm_beam_cases(row.inject["beams"], min(cases, MOST_BEAM_CASES), random)
    else:
        lost, found = _probe_cases(row, cases, random)
    errors, levels, sigmas = found
    wrong = int(np.count_nonzero(np.any(errors > SIGMAS * sigmas, axis=1)))
    share = (lost + np.count_nonzero(np.all(errors <= levels, axis=1))) / (lost + len(errors))
    seen = [f"{100.0 * share:.1f} % covered"]
    seen += [f"{lost} of {cases} lost"] if "beams" not in row.inject else []
    seen += [describe_levels(errors, levels)] if len(errors) else []
    return RowResult(row, "; ".join(seen), None, wrong, covered=share)


def _probe_cases(
    row: FaultRow, cases: int, random: np.random.Generator
) -> tuple[int, tuple[FloatArray, FloatArray, FloatArray]]:
    """Return the number of cases without a pose; errors, protection levels and standard deviations of the others."""
    posor = Posor(load_arm_file(row.arm).calibration(JOINT))
    real = TruePosor(posor.calibration)
    truth = draw_joint_poses(cases, random)
    gap_sensor: Any = posor.calibration.sensors[0]
    slopes = [abs(float(probe.volts_to_gap.array[1])) for probe in gap_sensor.probes]
    found = np.zeros((cases, 3, 6))
    has_pose = np.ones(cases, dtype=bool)
    for n in range(cases):
        stack = draw_sensors(posor, random)
        true = truth.select(np.array([n]))
        scan = real.scans_at(stack, true.rotations, true.translations, np.zeros(1, dtype=np.int64), noise=random)
        reliability = joint_reliability(posor, scan[0], true[0])
        channel = int(random.integers(len(slopes)))
        volts, share = scan.gap_voltages.copy(), row.inject.get("detectable")
        detectable = 0.0 if share is None else share * reliability.biases[channel] / slopes[channel]
        volts[0, channel] += row.inject["volts"] if share is None else random.uniform(-detectable, detectable)
        changed = scan.with_fields({"gap_voltages": volts})
        thetas = thetas_of(true.rotations) if posor.counts_bumps else None
        estimates = posor.estimate_each(changed, thetas, fault_effects=True)
        has_pose[n] = estimates.states[0] in USABLE_STATES
        poses, covariances = estimated_poses(estimates)
        level = joint_protection_levels(posor, estimates).levels[0]
        found[n] = np.abs(small_errors(poses, true)[0]), level, np.sqrt(np.diagonal(covariances[0]))
    errors, levels, sigmas = found[has_pose].transpose(1, 0, 2)
    return int(np.count_nonzero(~has_pose)), (errors, levels, sigmas)


def draw_joint_poses(count: int, random: np.random.Generator) -> PoseArray:
    """Return random poses of a target plate near home."""
    leans = np.column_stack([random.uniform(-1e-4, 1e-4, (count, 2)), np.zeros(count)])
    offsets = GAP + random.uniform(-2e-5, 2e-5, (count, 3))
    turned = PoseArray.from_axis_angles(2, random.uniform(-0.02, 0.02, count))
    return PoseArray.from_rotation_vectors(offsets, leans) @ turned


def _warm_beam_cases(
    kelvin: float, cases: int, random: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return errors, protection levels and standard deviations of the endpoint with measuring beams that are warmer.

    The joints are taken as exact: the error of the endpoint comes from the beams alone.
    """
    arm = load_arm_file("six_axis")
    chain = arm.chain()
    posors = {joint.name: Posor(arm.calibration(joint.name)) for joint in chain.joints}
    estimator = chain.estimator()
    estimator.use_causes([posor.hypotheses.joint_causes() for posor in posors.values()])
    scale, links = 1.0 + EXPANSION * kelvin, [each.before * each.end * each.after for each in TrueArm(arm.path).links]
    reals = {joint: TruePosor(posor.calibration) for joint, posor in posors.items()}
    errors, levels, sigmas = np.zeros((3, cases, 6))
    for n in range(cases):
        poses, joints = {}, []
        for joint, posor in posors.items():
            pose = draw_joint_poses(1, random)
            stamps = np.zeros(1, dtype=np.int64)
            scan = reals[joint].scans_at(posor.stack, pose.rotations, pose.translations, stamps)
            found = posor.estimate_each(scan, fault_effects=True)
            if found.states[0] != State.OK:
                raise PosorError(f"joint {joint} has no pose in a simulated case", where="offline_faults")
            poses[joint] = pose[0]
            joints.append(found)
        packed = np.array([[pin.SE3ToXYZQUAT(pose) for pose in poses.values()]])
        parts = [[each.covariances_random for each in joints], [each.covariances_systematic for each in joints]]
        endpoints = estimator.estimate_all(packed, *np.swapaxes(parts, 1, 2))
        effects = np.stack([each.fault_effects for each in joints], axis=1)
        levels[n] = estimator.bound_all(endpoints, packed, effects).levels[0]
        sigmas[n] = np.sqrt(np.diagonal(endpoints.covariances()[0]))
        warm = cold = links[0]
        for pose, link in zip(poses.values(), links[1:], strict=True):
            longer = pin.SE3(link.rotation, scale * link.translation)
            warm, cold = warm * pose * longer, cold * pose * link
        errors[n, :3] = np.abs(warm.translation - cold.translation)
    return errors, levels, sigmas


def describe_levels(errors: FloatArray, levels: FloatArray) -> str:
    """Return a sentence on the protection levels (n, 6) and the errors (n, 6)."""
    greatest = list(zip(AXES, levels.max(axis=0), errors.max(axis=0), strict=True))
    bounded = [
        f"{axis} {1e6 * level:.1f} (error {1e6 * error:.1f})" for axis, level, error in greatest if level < np.inf
    ]
    open_axes = [axis for axis, level, _ in greatest if math.isinf(level)]
    parts = [f"protection level in um, urad: {', '.join(bounded)}"] if bounded else []
    parts += [f"not bounded: {', '.join(open_axes)}"] if open_axes else []
    return "; ".join(parts)


def run_ambient(row: FaultRow, seed: int, positions: int = 12) -> RowResult:
    """Return the result of ambient light from the first scan on, in shares of a source's light, at random angles."""
    calibration, random = load_arm_file(row.arm).calibration(JOINT), np.random.default_rng(seed)
    wrong, named, poses = 0, list[bool](), 0
    for theta in random.uniform(-math.pi, math.pi, positions):
        truth = PoseArray.from_axis_angles(2, theta + 1e-3 * np.arange(AMBIENT_SCANS) / SLIP_SCANS)
        truth = PoseArray(truth.rotations, truth.translations + GAP)
        posor, stamps = Posor(calibration), np.arange(1, AMBIENT_SCANS + 1, dtype=np.int64) * (NS // SLIP_RATE)
        sound = (
            TruePosor(calibration)
            .scans_at(draw_sensors(posor, random), truth.rotations, truth.translations, stamps, noise=random)
            .editable()
        )
        sound.statuses[:] = 0
        light = 0.25 * sound.diode_currents.sum(axis=2).mean()
        dark = AMBIENT_SCANS // 2
        sound.lit_sources[dark] = NO_SOURCE
        noise = float(posor.settings["dark_noise"])
        sound.diode_currents[dark] = noise * random.normal(size=sound.diode_currents[dark].shape)
        for share in row.inject["shares"]:
            found = Posor(calibration).estimate_all(
                sound.with_fields({"diode_currents": sound.diode_currents + share * light})
            )
            valid = np.isin(found.states, USABLE_STATES)
            wrong += int(np.count_nonzero(valid & wrong_poses(*estimated_poses(found), truth)))
            named.append(bool(np.all(found.faults[:dark] & int(Fault.AMBIENT))))
            poses += int(np.count_nonzero(found.states[dark + 1 :] == State.OK))
    seen = (
        f"{sum(named)} of {len(named)} named; afterwards {poses} of {len(named) * (AMBIENT_SCANS - dark - 1)} scans OK"
    )
    return RowResult(row, seen, 0.0 if all(named) and poses else None, wrong)


def run_slips(row: FaultRow, seed: int, positions: int = 12) -> RowResult:
    """Return the result of slips of a coded ring at random angles: by every number, on both diodes, early and late."""
    calibration = sized_design("quad_light_ring", 0.2032, frames=("receiving", "target"), title="slips")
    posor = Posor(calibration)
    real = TruePosor(calibration)
    sources = next(len(each.light_sources) for each in calibration.sensors if isinstance(each, DiodesCalibration))
    random = np.random.default_rng(seed)
    wrong, namings = 0, list[int]()
    for theta in random.uniform(-math.pi, math.pi, positions):
        truth = PoseArray.from_axis_angles(2, theta + 1e-3 * np.arange(SLIP_SCANS) / SLIP_SCANS)
        truth = PoseArray(truth.rotations, truth.translations + GAP)
        stack = draw_sensors(posor, random)
        stamps = np.arange(1, SLIP_SCANS + 1, dtype=np.int64) * (NS // SLIP_RATE)
        sound = real.scans_at(stack, truth.rotations, truth.translations, stamps, noise=random)
        for begin in (0, LATER):
            for slip in range(1, sources):
                lit = sound.lit_sources.copy()
                lit[begin:] = (lit[begin:] + slip) % sources
                posor.reset()
                found = posor.estimate_all(sound.with_fields({"lit_sources": lit}))
                valid = np.isin(found.states, USABLE_STATES)
                wrong += int(np.count_nonzero(valid & wrong_poses(*estimated_poses(found), truth)))
                named = np.flatnonzero(found.faults[begin:] & int(Fault.RESIDUAL | Fault.SOURCE))
                namings.append(int(named[0]) if named.size else SLIP_SCANS)
    flagged, slowest = sum(each < SLIP_SCANS for each in namings), max(namings)
    seen = f"{flagged} of {len(namings)} slips named, the slowest after {slowest} scans; {sources} sources"
    return RowResult(row, seen, slowest / SLIP_RATE if flagged == len(namings) else None, wrong)
