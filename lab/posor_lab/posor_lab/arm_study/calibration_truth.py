# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibration of whole arms against the independent truth: drawn arms, a simulated tracker, poses that are not used.

The files state beams as assembled, and errors of one laboratory that all joints and beams share. A tracker sees
reflectors at the endpoint of the drawn arm; its noise is independent along each axis.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from posor.calibration.edit import edit_document
from posor.calibration.yaml_document import read_text
from posor.chain.beams_file import FILE_KIND, load_beams
from posor.output_files import write_files
from posor_calibration.arm.arm_fit import ArmProblem, Tool, calibrate_arm
from posor_calibration.arm.arm_model import ArmModel, ArmPoses
from posor_calibration.arm.arm_poses import poses_at
from posor_calibration.arm.endpoint_references import EndpointReferences, Reading
from scipy.special import chdtri

from posor_lab.accuracy.consistency import normalised_squares
from posor_lab.arm_study.shared_arm import write_shared_arm
from posor_lab.arm_study.statement_truth import DrawnArm, StatementTruth
from posor_lab.harness.beams import quantity

if TYPE_CHECKING:
    from pathlib import Path

    from posor.chain.arm_file import ArmFile
    from posor.numerics.array_types import FloatArray
    from posor_calibration.arm.arm_fit import ArmCalibration
    from posor_calibration.arm.arm_model import ArmStates

ASSEMBLED = 50e-6  # standard uncertainty of the beams before the calibration [m], [rad]
TRACKER, PER_METRE = 15e-6, 6e-6  # standard uncertainty along each axis [m], and per metre of distance
TOOL_SIGMA = 1e-3  # of the reflectors in the endpoint as drawn [m]
T_TRACKER_BASE = pin.SE3(pin.rpy.rpyToMatrix(0.03, -0.02, 2.1), np.array([2.4, 0.9, -0.7]))
REFLECTORS = {"smr1": (0.0, 0.0, 0.05), "smr2": (0.0, 0.08, 0.0), "smr3": (0.1, 0.0, 0.02)}
DIMENSIONS = 6


def write_assembled_arm(arm: ArmFile, folder: Path) -> Path:
    """Write a copy of an arm with shared errors, whose beams are as uncertain as when assembled; return its file."""
    path = write_shared_arm(arm, folder)
    beams = folder / "beams.yaml"
    changes = {
        f"beams[{n}].uncertainty.{name}": quantity([ASSEMBLED] * 3, unit)
        for n in range(len(load_beams(beams).beams))
        for name, unit in (("position", "m"), ("orientation", "rad"))
    }
    write_files({folder / "beams.yaml": edit_document(read_text(beams, FILE_KIND), str(beams), changes)})
    return path


class Outcome(NamedTuple):
    """A calibrated drawn arm at the poses that were not used."""

    calibration: ArmCalibration
    errors: FloatArray  # of the first reflector in the frame of the tracker, its axes, (n, 6) [m], [rad]
    squares: FloatArray  # normalised estimation error squared, (n,); 6 in the mean
    position_squares: FloatArray  # of the position alone, (n,); 3 in the mean
    before: FloatArray  # distances from the truth with base and tool alone fitted, (n,) [m]


class CalibrationTruth:
    """An arm by its files at poses of which the first are used, and drawn arms there."""

    def __init__(self, path: Path, used: int, tested: int, seed: int) -> None:
        """Read the files and draw the poses."""
        self._truth = StatementTruth(path, used + tested, seed, deviation=0.0)
        uncertain = self._truth.model
        self.poses = poses_at(uncertain.chain, uncertain.calibrations, self._truth.angles)
        self._rows = range(used), range(used, used + tested)
        self.model = ArmModel(uncertain.chain, uncertain.calibrations, self.poses.select(self._rows[0]))
        self._effects = [self.model.effects_at(self.poses.select(rows)) for rows in self._rows]

    def readings(self, drawn: DrawnArm, random: np.random.Generator) -> tuple[EndpointReferences, list[pin.SE3]]:
        """Return what the tracker reads of a drawn arm, and where the first reflector is at the tested poses."""
        found: list[Reading] = []
        first: list[pin.SE3] = []
        for name, place in REFLECTORS.items():
            real = pin.SE3(np.eye(3), np.array(place) + TOOL_SIGMA * random.normal(size=3))
            at = [T_TRACKER_BASE * endpoint * real for endpoint in drawn.endpoints]
            first = first or at[len(self._rows[0]) :]
            for pose in self._rows[0]:
                point = at[pose].translation
                sigma = np.full(3, TRACKER + PER_METRE * float(np.linalg.norm(point)))
                label = f"row {pose + 1} of {name}"
                found.append(Reading(label, pose, name, "point", point + sigma * random.normal(size=3), None, sigma))
        stamps = np.arange(len(self._rows[0]))
        return EndpointReferences(stamps, stamps + 1, tuple(found), {}), first

    def measured(self, drawn: DrawnArm, which: int) -> ArmPoses:
        """Return the poses that are used (0) or tested (1) as a drawn arm measures them."""
        rows = list(self._rows[which])
        own = self.poses.select(rows)
        return replace(own, transforms=drawn.measured[rows])

    def states(self, drawn: DrawnArm, which: int) -> ArmStates:
        """Return the poses that are used (0) or tested (1) of a drawn arm, for the model."""
        return self.model.states(self.measured(drawn, which), self._effects[which])

    def draw(self, draws: range) -> list[DrawnArm]:
        """Return the drawn arms of these numbers."""
        return list(self._truth.draw(draws))

    def outcome(self, drawn: DrawnArm, references: EndpointReferences, true: list[pin.SE3]) -> Outcome:
        """Calibrate a drawn arm and compare its first reflector with the truth."""
        used, tested = (self.states(drawn, which) for which in (0, 1))
        tools = {n: Tool(pin.SE3(np.eye(3), np.array(p)), (TOOL_SIGMA, 0.1)) for n, p in REFLECTORS.items()}
        problem = ArmProblem(self.model, used, references, tools)
        found = calibrate_arm(problem, ())
        name = next(iter(REFLECTORS))
        guess = problem.predict(found, tested, name)
        errors = np.array([pin.log6(a.actInv(b)).vector for a, b in zip(guess.places, true, strict=True)])
        squares, of_place = (normalised_squares(errors[:, :k], guess.covariances[:, :k, :k]) for k in (DIMENSIONS, 3))
        mounting = problem.fit(range(len(references.readings)), mounting_only=True)
        alone = replace(found, values=problem.whole(mounting))
        before = problem.predict(alone, tested, name).places
        distances = np.array([np.linalg.norm(a.translation - b.translation) for a, b in zip(before, true, strict=True)])
        return Outcome(found, errors, squares, of_place, distances)

    def outcomes(self, draws: range) -> list[Outcome]:
        """Return the outcomes of the drawn arms of these numbers."""
        found = []
        for draw, drawn in zip(draws, self.draw(draws), strict=True):
            found.append(self.outcome(drawn, *self.readings(drawn, np.random.default_rng([draw, 2]))))
        return found


class Consistency(NamedTuple):
    """Errors of calibrated arms against their stated uncertainty."""

    arms: int
    before_rms: float  # of the position with base and tool alone fitted [m]
    after_rms: float  # [m]
    nees: float  # mean of the normalised estimation errors squared over their six dimensions; 1 if consistent
    band: tuple[float, float]  # in which it lies with a probability of 95 % (poses of one arm as one)
    within_95: float  # share of positions within their 95 % ellipsoid

    @property
    def in_band(self) -> bool:
        """Whether the errors are of the stated size."""
        return self.band[0] <= self.nees <= self.band[1]

    @staticmethod
    def of(outcomes: list[Outcome]) -> Consistency:
        """Return the consistency of drawn arms."""
        freedoms = DIMENSIONS * len(outcomes)
        lengths = [np.linalg.norm(each.errors[:, :3], axis=1) for each in outcomes]
        before, after = (float(np.sqrt(np.mean(np.square(each)))) for each in ([o.before for o in outcomes], lengths))
        nees = float(np.mean([each.squares for each in outcomes])) / DIMENSIONS
        limits = (float(chdtri(freedoms, tail)) / freedoms for tail in (0.975, 0.025))
        within = float(np.mean([each.position_squares <= chdtri(3, 0.05) for each in outcomes]))
        low, high = limits
        return Consistency(len(outcomes), before, after, nees, (low, high), within)
