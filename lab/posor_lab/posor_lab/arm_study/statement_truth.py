# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Statements against the independent truth: arms drawn within their files, measured by the estimator.

Of each drawn arm the parameters of all POSORs, the noise of their readings, supply voltage and temperature of their
electronics, the placement, the sag and the temperature of the beams, and shared terms are drawn. Geometry, sag and
readings are those of the independent truth. Poses and endpoint are estimated as by the nodes from the files alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
import pinocchio as pin
from posor.chain.arm_file import load_arm_file
from posor.errors import ChainError
from posor.estimation.forward import empty_scans
from posor.estimation.posor import Posor
from posor.model.fault import USABLE_STATES
from posor.numerics.stamps import NS
from posor_bringup.new_arm import Axis, Sensors, arm_texts, new_joints, write_arm
from posor_design.arm_uncertainty import ArmUncertainty, EndpointUncertainty

from posor_lab.arm_study.arm_record import pose_array, pose_errors
from posor_lab.arm_study.endpoint_monte_carlo import disturbed
from posor_lab.arm_study.filter_runs import FALSE_ALARM, estimate_run
from posor_lab.arm_study.shared_arm import write_shared_arm
from posor_lab.independent.true_arm import TrueArm
from posor_lab.true_scans import with_noise

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray

THETA_SIGMA = 1e-4  # with which the count of each POSOR is confirmed [rad]
STEP_NS = NS // 200  # between drawn POSORs, so short that the count is kept
REACH = 1.0  # joint angles are drawn within this of zero [rad]
AXES: tuple[Axis, ...] = ("z", "y", "y", "x")
SENSORS: tuple[Sensors, ...] = ("light_ring", "bumpy_ring", "light_ring", "bumpy_ring")
SURROUNDINGS: tuple[Literal["supply"], Literal["temperature"]] = ("supply", "temperature")
LENGTH = 0.3  # of the beams of an arm of four joints [m]


def write_four_joint_arm(folder: Path) -> Path:
    """Write an arm as ``posor arm new`` does, with the errors of one laboratory stated; return its arm file."""
    joints = new_joints([f"joint{n}" for n in range(1, 5)], AXES, [LENGTH] * 4, SENSORS)
    own = folder / "new"
    write_arm(own, arm_texts("four_joint", joints, str(own)))
    return write_shared_arm(load_arm_file(own / "arm.yaml"), folder / "shared")


class DrawnArm(NamedTuple):
    """An arm at p poses."""

    measured: FloatArray  # transforms of the joints by the estimator, (p, j, 7)
    endpoints: list[pin.SE3]  # by the truth, in the base


@dataclass(frozen=True)
class Drawn:
    """Stated uncertainties at p poses, and the errors of n drawn arms there."""

    stated: list[EndpointUncertainty]
    errors: FloatArray  # ROS order, axes of the base, (n, p, 6)

    def ratios(self) -> FloatArray:
        """Return drawn over stated standard uncertainty along and about each axis, (p, 6)."""
        drawn = np.sqrt(np.mean(np.square(self.errors), axis=0))
        return np.asarray(drawn / [each.standard for each in self.stated])

    def largest_ratios(self) -> FloatArray:
        """Return drawn over stated U along the direction in which it is largest, (p,)."""
        positions = self.errors[..., :3]
        covariances = np.einsum("npi,npj->pij", positions, positions) / len(positions)
        drawn = np.sqrt(np.linalg.eigvalsh(covariances)[:, -1])
        return np.asarray(
            [each.factors[:3].max() * sigma / each.largest for each, sigma in zip(self.stated, drawn, strict=True)]
        )

    def coverage(self) -> FloatArray:
        """Return the share of errors within U along and about each axis, (p, 6)."""
        return np.asarray(np.mean(np.abs(self.errors) <= [each.expanded for each in self.stated], axis=0))


class StatementTruth:
    """An arm at p poses by its files, and drawn arms there.

    Attributes:
        model: The arm by its files.
        angles: Of the joints at the poses [rad], (p, j).
        stated: Its uncertainty there.

    """

    def __init__(self, path: Path, poses: int, seed: int, *, deviation: float | None = None) -> None:
        """Read the files and draw the poses; ``deviation``: of the beams' temperature [K], see ``ArmUncertainty``."""
        self.model = ArmUncertainty(load_arm_file(path), deviation=deviation)
        joints = self.model.joints
        self.angles = np.random.default_rng([seed, 0]).uniform(-REACH, REACH, (poses, len(joints)))
        self.stated = self.model.at(self.angles)
        self._truth = TrueArm(path)
        self._posors = {name: Posor(self.model.calibrations[name], false_alarm=FALSE_ALARM) for name in joints}
        transforms = [
            [self.model.chain.nominal_joint(name, angle) for name, angle in zip(joints, row, strict=True)]
            for row in self.angles
        ]
        self._rotations, self._translations = (
            np.array([[getattr(each, what) for each in row] for row in transforms])
            for what in ("rotation", "translation")
        )

    def errors(self, draws: range) -> FloatArray:
        """Return the errors of the drawn arms of these numbers, (n, p, 6)."""
        drawn = list(self.draw(draws))
        zero = np.zeros((len(self.angles), len(self.model.joints), 6, 6))
        errors = np.empty((len(drawn), len(self.angles), 6))
        for n, arm in enumerate(drawn):
            found = self.model.chain.estimate_all(arm.measured, zero, zero).poses
            errors[n] = pose_errors(pose_array([pin.XYZQUATToSE3(pose) for pose in found]), pose_array(arm.endpoints))
        return errors

    def draw(self, draws: range) -> Iterator[DrawnArm]:
        """Yield the drawn arms of these numbers."""
        randoms = [np.random.default_rng([draw, 1]) for draw in draws]
        terms = [{name: random.normal() for name in self._term_names()} for random in randoms]
        joints = self.model.joints
        measured = np.stack([self._estimate(name, j, randoms, terms) for j, name in enumerate(joints)], axis=2)
        for random, common, own in zip(randoms, terms, measured, strict=True):
            true = self._drawn_arm(random, common).endpoints(self._rotations, self._translations)
            yield DrawnArm(own, [pin.SE3(rotation, translation) for rotation, translation in zip(*true, strict=True)])

    def _term_names(self) -> list[str]:
        shared = [self.model.chain.shared, *(each.shared for each in self.model.calibrations.values())]
        return list(dict.fromkeys(name for terms in shared for name in terms))

    def _estimate(
        self, joint: str, j: int, randoms: list[np.random.Generator], terms: list[dict[str, float]]
    ) -> FloatArray:
        """Return the estimated poses of a joint, (n, p, 7): at each place, the drawn POSORs one after the other."""
        calibration, posor = self.model.calibrations[joint], self._posors[joint]
        stack, places = posor.stack, (self._rotations[:, j], self._translations[:, j])
        fields: dict[str, list[FloatArray]] = {}
        for random, common in zip(randoms, terms, strict=True):
            wrong = stack.parameter_sigmas * random.normal(size=stack.parameters)
            if calibration.shared:
                wrong += posor.shared_effects @ [common[name] for name in calibration.shared]
            true = self._truth.joint(joint, dict(zip(stack.parameter_names, wrong.tolist(), strict=True)))
            supply, warmth = (surroundings_of(calibration, what, len(self.angles), random) for what in SURROUNDINGS)
            for name, values in true.readings(*places, supply, warmth).items():
                fields.setdefault(name, []).append(values)
        count, size = len(randoms), len(self.angles)
        stamps_ns = np.repeat(np.arange(1, count + 1) * STEP_NS, size)
        scans = empty_scans(stamps_ns).with_fields({name: np.concatenate(values) for name, values in fields.items()})
        scans = with_noise(scans, stack, randoms[0])
        poses = np.empty((count, size, 7))
        for k in range(size):
            estimates = estimate_run(posor, scans.select(slice(k, None, size)), self._rotations[k, j], THETA_SIGMA)
            if not np.isin(estimates.states, USABLE_STATES).all():
                raise ChainError(f"a drawn POSOR has no pose: {estimates.lost_reasons()}", where=f"joint '{joint}'")
            poses[:, k] = estimates.poses
        return poses

    def _drawn_arm(self, random: np.random.Generator, terms: Mapping[str, float]) -> TrueArm:
        """Return the truth with errors of its beams."""
        warm = random.uniform(-1.0, 1.0)
        links = list(self._truth.links)
        for n, (link, known) in enumerate(zip(self._truth.links, self.model.chain.links, strict=True)):
            beam = known.beam
            if beam is None:
                continue
            error = np.sqrt(np.diagonal(beam.covariance)) * random.normal(size=6)
            factor = 1.0 + beam.sag_sigma * random.normal()
            for name, effect in beam.shared_effects.items():
                error += terms[name] * effect
                factor += terms[name] * beam.shared_sags[name]
            error[:3] += 0.0 if len(beam.thermal) else warm * beam.expansion
            error += random.normal(size=len(beam.thermal)) @ beam.thermal
            end = disturbed(link.end, error)
            links[n] = replace(link, end=end, start_gain=factor * link.start_gain, end_gain=factor * link.end_gain)
        return self._truth.with_links(links)


def surroundings_of(
    calibration: Calibration, what: Literal["supply", "temperature"], count: int, random: np.random.Generator
) -> FloatArray | None:
    """Draw the supply voltage or temperature of probes that no scan measures, (count,); None: at the reference."""
    spread = getattr(calibration.environment, what, None)
    probes = [probe for sensor in calibration.sensors for probe in getattr(sensor, "probes", ())]
    references = {getattr(probe, what).reference.number for probe in probes if getattr(probe, what) is not None}
    if spread is None or len(references) != 1:
        return None
    return np.full(count, references.pop() + spread.spread.number * random.normal())
