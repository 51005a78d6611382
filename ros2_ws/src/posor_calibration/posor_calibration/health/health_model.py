# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What each part of an arm, if it alone changes, does to a health test; and what the stated uncertainties do.

The observations of a test are the places of the balls, then the redundancy of each joint at each pose: what its
residuals are in parity space, whose noise is white. An error of a reading acts on both. A part is a few columns: a
reading (a constant error), a beam (six freedoms of its end), the base against the artefact, a ball in the endpoint.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from posor.model.scan import Scans
from posor.uncertainty.budget_poses import scan_at
from posor.uncertainty.reading_sensitivity import sensitivity_at
from scipy.linalg import block_diag, null_space

from posor_calibration.arm.arm_model import UNITS, ArmModel
from posor_calibration.arm.arm_poses import poses_at
from posor_calibration.data_checks import POSE_AXES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from posor.chain.measuring_beam import MeasuringBeam
    from posor.estimation.posor import Posor
    from posor.numerics.array_types import FloatArray, IntArray

    from posor_calibration.health.health_test import HealthArm, HealthTest

PLACE = 3


@dataclass(frozen=True)
class Part:
    """A part of the arm that may have changed alone, with k freedoms."""

    name: str  # such as "gap_2 of elbow", "beam forearm"
    remedy: str  # what to do if it has changed
    axes: tuple[str, ...]
    units: tuple[str, ...]
    columns: FloatArray  # what one unit of each does to the observations, (m, k)
    stated: FloatArray  # its stated standard uncertainties, (k,); NaN: not stated


class _JointAt(NamedTuple):
    """A joint at a pose, with r readings."""

    gain: FloatArray  # of the transform by errors of the readings, (6, r)
    parity: FloatArray  # of the redundancy, (r - 6, r)
    stated: FloatArray  # errors of the readings by the causes that the calibration states, (r, q); shared terms last


class HealthModel:
    """The m observations of a test and what moves them.

    Attributes:
        parts: All parts of the arm.
        stated: Effects of what calibrations and beams file state, one standard deviation each, (m, q).

    """

    def __init__(self, arm: HealthArm, test: HealthTest, T_artefact_base: pin.SE3) -> None:
        """Compute the effects at the postures of a test. Raises ChainError: a POSOR has no pose at an angle."""
        poses = poses_at(arm.chain, arm.calibrations, test.angles)
        model = ArmModel(arm.chain, arm.calibrations, poses)
        motion = model.move(
            model.states(poses, model.effects_at(poses)), np.zeros(len(model.parameters)), T_artefact_base
        )
        self._is_seat = np.array([part in arm.balls for _, part, _ in test.keys])
        self._seats = [(pose - 1, part) for pose, part, axis in test.keys if part in arm.balls and axis == "x"]
        at = [
            [_joint_at(posor, pin.XYZQUATToSE3(T)) for posor, T in zip(arm.posors.values(), row, strict=True)]
            for row in poses.transforms
        ]
        self._parity = block_diag(*(each.parity for row in at for each in row))
        places = np.zeros((PLACE * len(self._seats), self._parity.shape[1]))
        firsts = np.cumsum([0, *(each.gain.shape[1] for row in at for each in row)]).reshape(-1)
        shifts = []
        for s, (n, ball) in enumerate(self._seats):
            turn = motion.endpoints[n].rotation @ np.hstack([np.eye(PLACE), -pin.skew(arm.balls[ball])])
            shifts.append(turn @ motion.by_parameter[n])
            for j, each in enumerate(at[n]):
                first = firsts[n * len(at[n]) + j]
                own = slice(first, first + each.gain.shape[1])
                places[PLACE * s : PLACE * s + PLACE, own] = turn @ motion.by_joint[n, j] @ each.gain
        self._by_reading = np.vstack([places, self._parity])
        self._by_parameter = np.vstack([*shifts, np.zeros((len(self._parity), len(model.parameters)))])
        self._rotations = [motion.endpoints[n].rotation for n, _ in self._seats]
        of_joint = {  # which readings are of a joint, pose after pose
            name: np.concatenate(
                [np.arange(*firsts[n * len(row) + j : n * len(row) + j + 2]) for n, row in enumerate(at)]
            )
            for j, name in enumerate(arm.posors)
        }
        effects = {name: np.vstack([row[j].stated for row in at]) for j, name in enumerate(arm.posors)}
        self.parts = [*self._readings(arm, of_joint, effects), *self._beams(model), *self._mounting()]
        self.stated = self._all_stated(arm, model, of_joint, effects)

    def observe(self, test: HealthTest) -> FloatArray:
        """Return the observations of a test, (m,)."""
        return np.concatenate([test.values[self._is_seat], self._parity @ test.values[~self._is_seat]])

    def noise(self, test: HealthTest) -> FloatArray:
        """Return the covariance of the observations by the noise of a test, (m, m)."""
        by_reading = self._by_reading * test.sigmas[~self._is_seat]
        covariance: FloatArray = by_reading @ by_reading.T
        seats = np.arange(self._is_seat.sum())
        covariance[seats, seats] += np.square(test.sigmas[self._is_seat])
        return covariance

    def _readings(
        self, arm: HealthArm, of_joint: dict[str, IntArray], effects: dict[str, FloatArray]
    ) -> Iterator[Part]:
        for joint, posor in arm.posors.items():
            count = posor.stack.readings
            for k, name in enumerate(posor.stack.reading_names):
                column = self._by_reading[:, of_joint[joint][k::count]].sum(axis=1, keepdims=True)
                stated = np.sqrt(np.mean(np.sum(np.square(effects[joint][k::count]), axis=1)))
                remedy = f"calibrate the joint {joint} again"
                yield Part(f"{name} of {joint}", remedy, ("",), ("m",), column, np.array([stated]))

    def _beams(self, model: ArmModel) -> Iterator[Part]:
        for number, element in enumerate(model.elements):
            if element.beam is None:
                continue
            own = slice(6 * number, 6 * number + 6)
            stated = np.sqrt(np.diagonal(model.prior[own, own] + _thermal(element.beam) @ _thermal(element.beam).T))
            places = [each.name for each in model.elements if each.joint is not None or each is model.elements[0]]
            before = [each.name for each in model.elements[:number] if each.joint is not None]
            after = [each.name for each in model.elements[number:] if each.joint is not None]
            between = f"between {before[-1] if before else places[0]} and {after[0] if after else 'the endpoint'}"
            remedy = "calibrate the arm again (posor calibrate-arm), or its transform (beam_transform)"
            columns = -self._by_parameter[:, own]  # the files lag behind the part
            yield Part(f"beam {element.name}, {between}", remedy, POSE_AXES, UNITS, columns, stated)

    def _mounting(self) -> Iterator[Part]:
        """Yield base, balls and seats; the balls move in the axes of the endpoint."""
        unknown = np.full(6, np.nan)
        remedy = "look for a loose foot or artefact, then begin a new history"
        yield Part("base or artefact", remedy, POSE_AXES, UNITS, -self._by_parameter[:, :6], unknown)
        for ball in dict.fromkeys(name for _, name in self._seats):
            columns = np.zeros((len(self._by_parameter), PLACE))
            for s, ((_, name), rotation) in enumerate(zip(self._seats, self._rotations, strict=True)):
                columns[PLACE * s : PLACE * s + PLACE] = -rotation if name == ball else 0.0
            remedy = "clean or fasten the ball, then begin a new history"
            yield Part(f"ball {ball}", remedy, POSE_AXES[:PLACE], UNITS[:PLACE], columns, unknown[:PLACE])
        for s, (n, ball) in enumerate(self._seats):
            columns = np.zeros((len(self._by_parameter), PLACE))
            columns[PLACE * s : PLACE * s + PLACE] = -np.eye(PLACE)
            remedy = "clean the seat and repeat the test"
            yield Part(
                f"seat of {ball} at dwell {n + 1}", remedy, POSE_AXES[:PLACE], UNITS[:PLACE], columns, unknown[:PLACE]
            )

    def _all_stated(
        self, arm: HealthArm, model: ArmModel, of_joint: dict[str, IntArray], effects: dict[str, FloatArray]
    ) -> FloatArray:
        columns: list[FloatArray] = []
        names = [parameter.name for parameter in model.parameters]
        shared = {name: self._by_parameter[:, n].copy() for n, name in enumerate(names) if name.startswith("shared: ")}
        seats = PLACE * len(self._seats)
        for joint, posor in arm.posors.items():
            terms = tuple(posor.calibration.shared)
            own = self._by_reading[:, of_joint[joint]] @ effects[joint]
            columns.append(own[:, : own.shape[1] - len(terms)])
            for term, effect in zip(terms, own.T[own.shape[1] - len(terms) :], strict=True):
                shared[f"shared: {term}"][seats:] += effect[seats:]  # the places of the balls have it already
        for number, element in enumerate(model.elements):
            if element.beam is not None:
                block = slice(6 * number, 6 * number + 6)
                root = np.hstack([np.linalg.cholesky(model.prior[block, block]), _thermal(element.beam)])
                columns.append(self._by_parameter[:, block] @ root)
        columns += [self._by_parameter[:, n : n + 1] * model.parameters[n].sigma for n in model.sags.values()]
        return np.hstack([*columns, *(effect[:, None] for effect in shared.values())])


def _joint_at(posor: Posor, T: pin.SE3) -> _JointAt:
    scan, rotation, translation = scan_at(posor, T), T.rotation.copy(), T.translation.copy()
    read = posor.stack.linearise(Scans.of([scan]))
    jacobian = posor.stack.evaluate(read.selected[0], rotation, translation)[1]
    noise = np.sqrt(read.variances[0])
    parity = null_space((jacobian / noise[:, None]).T).T / noise
    by_parameter = posor.stack.residual_jacobian(scan, rotation, translation) @ posor.parameter_square_root
    surroundings = posor.model.workspace[0]["sensitivities"][: len(noise)] * posor.settings["spreads"]
    return _JointAt(sensitivity_at(posor, scan, T).gain, parity, np.hstack([surroundings, by_parameter]))


def _thermal(beam: MeasuringBeam) -> FloatArray:
    """Return changes of a beam's end by its temperature, one standard deviation each, axes of the end, (6, n)."""
    rectangular = np.concatenate([beam.expansion, np.zeros(3)]) / np.sqrt(3.0)
    effects = beam.thermal if len(beam.thermal) else rectangular[None]
    return np.asarray(np.kron(np.eye(2), beam.T_start_end.rotation).T @ effects.T)
