# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Health tests of drawn arms over months, by the independent truth: sound, with a creeping probe, with a bumped beam.

The errors of the calibrations and beams are those of one arm and stay. New in each test are the noise of all readings,
the temperature of each beam, supply voltage and temperature of the electronics, and how the ball rests in its seats.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.chain.arm_file import load_arm_file
from posor.estimation.estimate import Estimates
from posor.estimation.forward import empty_scans
from posor.messages.estimate_arrays import ArmEstimates, EndpointEstimates
from posor.numerics.stamps import NS
from posor_calibration.arm.endpoint_references import EndpointReferences, Reading
from posor_calibration.commissioning.file_checks import arm_identity
from posor_calibration.health.health_history import HealthHistory
from posor_calibration.health.health_model import HealthModel
from posor_calibration.health.health_report import MONTH_NS
from posor_calibration.health.health_test import HealthArm
from posor_design.arm_uncertainty import chain_at

from posor_lab.arm_study.endpoint_monte_carlo import disturbed
from posor_lab.arm_study.filter_runs import estimate_run
from posor_lab.arm_study.statement_truth import SURROUNDINGS, THETA_SIGMA, surroundings_of
from posor_lab.independent.true_arm import TrueArm
from posor_lab.true_scans import with_noise

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from posor.numerics.array_types import FloatArray, IntArray
    from posor_calibration.health.health_test import HealthTest

REACH = 0.8  # joint angles are drawn within this of zero [rad]
SCANS = 50  # at each dwell
DWELL_NS, STEP_NS = 10 * NS, NS // 200
BALL, PLACE, SEAT = "ball", np.array([0.0, 0.0, 0.05]), 1e-6
"""The ball, its place in the endpoint [m], and how well it rests in a seat again [m]."""
DEVIATION_K = 0.2  # of each beam from the temperature of the URDF, at most
T_ARTEFACT_BASE = pin.SE3(pin.rpy.rpyToMatrix(0.01, -0.02, 0.7), np.array([1.2, 0.3, -0.4]))
START_NS = 1_767_225_600 * NS  # 2026-01-01


@dataclass(frozen=True)
class Ageing:
    """What happens to an arm from a test on: probes that creep, and a beam that is bumped."""

    test: int = 0  # number of the first test with a change
    creeps: Mapping[tuple[str, int], float] = field(default_factory=dict)  # [m] a month, by joint and reading
    bumps: Mapping[str, FloatArray] = field(default_factory=dict)  # shift of the end of a beam [m], (3,)


class AgeingArm:
    """An arm at the dwells of its health tests.

    Attributes:
        file: Its arm file.
        health: The arm by its files.

    """

    def __init__(self, name: str, poses: int, seed: int) -> None:
        """Read the files of an installed arm and draw the postures."""
        self.file = arm = load_arm_file(name)
        chain = chain_at(arm, DEVIATION_K)
        calibrations = {joint.name: arm.calibration(joint.name) for joint in chain.path_joints}
        self.health = HealthArm(chain, calibrations, {BALL: PLACE})
        self._truth = TrueArm(arm.path)
        angles = np.random.default_rng(seed).uniform(-REACH, REACH, (poses, len(calibrations)))
        nominal = [[chain.nominal_joint(*each) for each in zip(calibrations, row, strict=True)] for row in angles]
        self._rotations, self._translations = (
            np.array([[getattr(each, what) for each in row] for row in nominal]) for what in ("rotation", "translation")
        )

    def model(self, test: HealthTest) -> HealthModel:
        """Return the model of the tests."""
        return HealthModel(self.health, test, T_ARTEFACT_BASE)

    def history(self, tests: Iterable[HealthTest]) -> HealthHistory:
        """Return the history of tests."""
        identity = arm_identity(self.file, self.health.calibrations)
        history = HealthHistory(self.file.name, identity, T_ARTEFACT_BASE, {BALL: PLACE.tolist()})
        for test in tests:
            history = history.with_test(test, self.file.name)
        return history

    def tests(self, seed: int, count: int, ageing: Ageing = Ageing()) -> Iterator[HealthTest]:
        """Yield the monthly tests of a drawn arm."""
        random = np.random.default_rng([seed, 1])
        errors = {
            joint: dict(
                zip(
                    posor.stack.parameter_names,
                    (posor.stack.parameter_sigmas * random.normal(size=posor.stack.parameters)).tolist(),
                    strict=True,
                )
            )
            for joint, posor in self.health.posors.items()
        }
        placements = {
            beam.name: np.sqrt(np.diagonal(beam.covariance)) * random.normal(size=6) for beam in self.health.chain.beams
        }
        for n in range(count):
            months = max(0, n - ageing.test + 1)
            start_ns = START_NS + round(n * MONTH_NS)
            stamps_ns = start_ns + DWELL_NS * np.arange(1, len(self._rotations) + 1)
            joints = {
                joint: self._scan(joint, j, self._aged(joint, own, ageing, months), stamps_ns, random)
                for j, (joint, own) in enumerate(errors.items())
            }
            true = self._bumped(placements, ageing.bumps if months else {}, random)
            readings = []
            for pose, (rotation, place) in enumerate(
                zip(*true.endpoints(self._rotations, self._translations), strict=True)
            ):
                seat = T_ARTEFACT_BASE.act(rotation @ PLACE + place) + SEAT * random.normal(size=3)
                readings.append(Reading(f"row {pose + 1}", pose, BALL, "point", seat, None, np.full(3, SEAT)))
            references = EndpointReferences(stamps_ns, np.arange(len(stamps_ns)) + 1, tuple(readings), {})
            estimates = ArmEstimates(joints, EndpointEstimates.none())
            window_s = SCANS * STEP_NS / NS
            yield self.health.measure(estimates, references, window_s, f"test {n + 1}", T_ARTEFACT_BASE)[0]

    def _aged(self, joint: str, errors: Mapping[str, float], ageing: Ageing, months: int) -> dict[str, float]:
        """Return the errors of a joint whose probes have moved along their axes."""
        found, posor = dict(errors), self.health.posors[joint]
        probes = [
            (type(built).__name__, k, probe)
            for built, sensor in zip(posor.stack.sensors, posor.calibration.sensors, strict=True)
            for k, probe in enumerate(getattr(sensor, "probes", ()))
        ]
        for (name, reading), rate in ageing.creeps.items():
            if name == joint:
                kind, k, probe = probes[reading]
                for c, part in enumerate(probe.axis.array.tolist()):
                    found[f"{kind}.tips[{k},{c}]"] = found.get(f"{kind}.tips[{k},{c}]", 0.0) + rate * months * part
        return found

    def _scan(
        self, joint: str, j: int, errors: Mapping[str, float], stamps_ns: IntArray, random: np.random.Generator
    ) -> Estimates:
        """Return the estimates of a joint at all dwells of a test."""
        posor = self.health.posors[joint]
        supply, warmth = (surroundings_of(posor.calibration, what, len(stamps_ns), random) for what in SURROUNDINGS)
        poses = self._rotations[:, j], self._translations[:, j]
        true = self._truth.joint(joint, errors).readings(*poses, supply, warmth)
        every = (stamps_ns[:, None] + STEP_NS * (np.arange(SCANS) - SCANS // 2)).ravel()
        scans = empty_scans(every).with_fields({name: np.repeat(each, SCANS, axis=0) for name, each in true.items()})
        scans = with_noise(scans, posor.stack, random)
        return Estimates.concatenate(
            [
                estimate_run(posor, scans.select(slice(n * SCANS, (n + 1) * SCANS)), rotation, THETA_SIGMA)
                for n, rotation in enumerate(self._rotations[:, j])
            ]
        )

    def _bumped(
        self, placements: Mapping[str, FloatArray], bumps: Mapping[str, FloatArray], random: np.random.Generator
    ) -> TrueArm:
        """Return the truth with errors, temperatures and bumps of its beams."""
        links = list(self._truth.links)
        for n, (link, known) in enumerate(zip(self._truth.links, self.health.chain.links, strict=True)):
            if (beam := known.beam) is not None:
                error = placements[beam.name].copy()
                error[:3] = error[:3] + random.uniform(-1.0, 1.0) * beam.expansion + bumps.get(beam.name, 0.0)
                links[n] = replace(link, end=disturbed(link.end, error))
        return self._truth.with_links(links)
