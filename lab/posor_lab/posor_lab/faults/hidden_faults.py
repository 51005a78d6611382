"""Faults that no reading shows: whether the protection level covers them, in simulated cases. No ROS.

A case is one scan of a joint at a random pose, with sensors drawn within the uncertainties of their calibration and one
gap probe that is off. It is covered if the error of the pose is within the protection level along and about every axis,
or if there is no pose. The row of the measuring beams is about the endpoint of the whole arm.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin
from posor.chain.arm_file import load_arm
from posor.errors import PosorError
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.fault import USABLE_STATES, State
from posor.uncertainty.protection_level import (
    endpoint_effects,
    endpoint_protection_level,
    expansion_shifts,
)
from posor.uncertainty.reliability import joint_reliability
from posor_bringup.arms import find_arm
from posor_drivers.simulator.pose_array import PoseArray

from posor_lab.faults.fault_table import FaultRow, RowResult
from posor_lab.faults.pose_judge import SIGMAS, small_errors

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor.numerics.array_types import FloatArray

    from posor_lab.faults.fault_table import Arm

CASES = 300
JOINT = "elbow"
AXES = ("x", "y", "z", "about X", "about Y", "about Z")
EXPANSION = 23e-6
"""Thermal expansion of aluminium [1/K]."""
BEAM_WARMING = 5.0
"""Temperature of the beams above that of the URDF [K]."""


class HiddenFault(NamedTuple):
    """A row, and the function that draws its cases: share covered, wrong and OK, sentence on the levels."""

    row: FaultRow
    run: Callable[[int, np.random.Generator], tuple[float, int, str]]


def _rows() -> tuple[HiddenFault, ...]:
    covered = "not named; within the protection level"
    unbounded = "not named; the protection level is not bounded"

    def row(
        arm: Arm, name: str, expected: str, draw_volts: Callable[[np.random.Generator, float], float]
    ) -> HiddenFault:
        return HiddenFault(
            FaultRow(name, "wrong", arm, expected), lambda cases, random: probe_cases(arm, draw_volts, cases, random)
        )

    return (
        row(
            "six_axis",
            "gap probe off by less than is detectable",
            covered,
            lambda random, detectable: random.uniform(-detectable, detectable),
        ),
        row("six_axis", "gap probe +10 mV", covered, lambda _random, _detectable: 0.01),
        row("six_axis", "dirt of 5 mV on a gap probe", covered, lambda _random, _detectable: 0.005),
        row("six_axis", "dirt of 20 mV on a gap probe", covered, lambda _random, _detectable: 0.02),
        row("five_axis", "dirt of 5 mV on one of three gap probes", unbounded, lambda _random, _detectable: 0.005),
        row("five_axis", "dirt of 20 mV on one of three gap probes", unbounded, lambda _random, _detectable: 0.02),
        row("five_axis", "one of three gap probes +100 mV", unbounded, lambda _random, _detectable: 0.1),
        HiddenFault(
            FaultRow("measuring beams 5 K warmer than the URDF says", "wrong", "six_axis", covered), warm_beam_cases
        ),
    )


def probe_cases(
    arm: Arm, draw_volts: Callable[[np.random.Generator, float], float], cases: int, random: np.random.Generator
) -> tuple[float, int, str]:
    """Return how a gap probe that is off is covered.

    Args:
        arm: Installed arm.
        draw_volts: Returns the error [V], given the random generator and the probe's minimal detectable bias [V].
        cases: Number of cases.
        random: Random generator.

    Returns:
        Share of the cases that are covered, number of wrong poses published as valid, and a sentence on the levels.

    """
    posor = Posor(load_arm(find_arm(arm)).calibration(JOINT))
    truth = draw_joint_poses(cases, random)
    gap_sensor: Any = posor.calibration.sensors[0]
    probes = gap_sensor.probes
    covered, wrong, lost = 0, 0, 0
    errors_seen, levels_seen = np.zeros((cases, 6)), np.zeros((cases, 6))
    for n in range(cases):
        stack = posor.stack
        stack = stack.with_parameter_values(
            stack.parameter_values + stack.parameter_sigmas * random.normal(size=stack.parameters)
        )
        true = truth.select(np.array([n]))
        scan = scans_at(stack, true.rotations, true.translations, np.zeros(1, dtype=np.int64), noise=random)
        reliability = joint_reliability(posor, scan[0], true[0])
        channel = int(random.integers(len(probes)))
        slope = abs(float(probes[channel].volts_to_gap.array[1]))
        volts = scan.gap_voltages.copy()
        volts[0, channel] += draw_volts(random, reliability.biases[channel] / slope)
        theta = math.atan2(-true.rotations[0, 0, 1], true.rotations[0, 1, 1])
        thetas = np.array([theta]) if posor.counts_bumps else None
        found = posor.estimate_each(scan.with_fields({"gap_voltages": volts}), thetas)
        covariance = (found.covariances_random + found.covariances_systematic)[0]
        if found.states[0] not in USABLE_STATES:
            lost += 1
            covered += 1
            continue
        error = np.abs(small_errors(PoseArray(found.rotations, found.translations), true)[0])
        level = endpoint_protection_level([reliability.shifts], [np.eye(6)], covariance)
        covered += bool(np.all(error <= level))
        wrong += bool(np.any(error > SIGMAS * np.sqrt(np.diagonal(covariance))))
        errors_seen[n], levels_seen[n] = error, level
    levels = "" if lost == cases else f"; {describe_levels(errors_seen, levels_seen)}"
    return covered / cases, wrong, f"{lost} of {cases} lost{levels}"


def draw_joint_poses(count: int, random: np.random.Generator) -> PoseArray:
    """Return random poses of a target plate near home."""
    leans = np.column_stack([random.uniform(-1e-4, 1e-4, (count, 2)), np.zeros(count)])
    offsets = np.array([0.0, 0.0, 0.735e-3]) + random.uniform(-2e-5, 2e-5, (count, 3))
    turned = PoseArray.from_axis_angles(2, random.uniform(-0.02, 0.02, count))
    return PoseArray.from_rotation_vectors(offsets, leans) @ turned


def warm_beam_cases(cases: int, random: np.random.Generator) -> tuple[float, int, str]:
    """Return how the endpoint's protection level covers measuring beams that are longer by ``BEAM_WARMING``.

    The joints are taken as exact: the error of the endpoint is that of the beams alone. At most 50 cases.
    """
    arm = load_arm(find_arm("six_axis"))
    chain = arm.chain()
    cases = min(cases, 50)
    posors = {joint.name: Posor(arm.calibration(joint.name)) for joint in chain.joints}
    scale = 1.0 + EXPANSION * BEAM_WARMING
    errors, levels = np.zeros((cases, 6)), np.zeros((cases, 6))
    spreads = np.zeros((cases, 6))
    for n in range(cases):
        poses, shifts, covariances = {}, [], []
        for joint, posor in posors.items():
            pose = draw_joint_poses(1, random)
            scan = scans_at(posor.stack, pose.rotations, pose.translations, np.zeros(1, dtype=np.int64))
            found = posor.estimate_each(scan)
            if found.states[0] != State.OK:
                raise PosorError(f"joint {joint} has no pose in a simulated case", where="hidden_faults")
            poses[joint] = pose[0]
            shifts.append(joint_reliability(posor, scan[0], pose[0]).shifts)
            covariances.append((found.covariances_random + found.covariances_systematic)[0])
        effects = endpoint_effects(chain, poses)
        packed = np.array([[pin.SE3ToXYZQUAT(pose) for pose in poses.values()]])
        endpoint = chain.estimate_all(packed, np.array([covariances]))
        expansions = expansion_shifts(chain, poses)
        levels[n] = endpoint_protection_level(
            shifts, [effects[name] for name in poses], endpoint.covariances[0], expansions
        )
        spreads[n] = np.sqrt(np.diagonal(endpoint.covariances[0]))
        warm = cold = chain.links[0].T_nominal
        for pose, link in zip(poses.values(), chain.links[1:], strict=True):
            longer = pin.SE3(link.T_nominal.rotation, scale * link.T_nominal.translation)
            warm, cold = warm * pose * longer, cold * pose * link.T_nominal
        errors[n, :3] = np.abs(warm.translation - cold.translation)
    share = float(np.mean(np.all(errors <= levels, axis=1)))
    wrong = int(np.count_nonzero(np.any(errors > SIGMAS * spreads, axis=1)))
    return share, wrong, describe_levels(errors, levels)


def describe_levels(errors: FloatArray, levels: FloatArray) -> str:
    """Return a sentence on the protection levels (n, 6) and the errors (n, 6)."""
    level, error = levels.max(axis=0), errors.max(axis=0)
    open_axes = [axis for axis, value in zip(AXES, level, strict=True) if math.isinf(value)]
    bounded = [
        f"{axis} {1e6 * value:.1f} (error {1e6 * most:.1f})"
        for axis, value, most in zip(AXES, level, error, strict=True)
        if math.isfinite(value)
    ]
    parts = [f"protection level in um, urad: {', '.join(bounded)}"] if bounded else []
    parts += [f"not bounded: {', '.join(open_axes)}"] if open_axes else []
    return "; ".join(parts)


HIDDEN_FAULTS = _rows()


def run_hidden(fault: HiddenFault, seed: int, cases: int = CASES) -> RowResult:
    """Return the result of a row."""
    share, wrong, sentence = fault.run(cases, np.random.default_rng(seed))
    return RowResult(fault.row, f"{100.0 * share:.1f} % covered; {sentence}", None, wrong, covered=share)
