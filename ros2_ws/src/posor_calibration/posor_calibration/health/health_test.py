# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""One health test: places of balls by the arm less those of the artefact, and residuals of all readings, at dwells."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from posor.bags.recording import POINT
from posor.errors import TrackError
from posor.estimation.corrected_scans import corrected_scans
from posor.estimation.posor import Posor
from posor.model.fault import USABLE_STATES
from posor.numerics.stamps import NS
from scipy.spatial.transform import Rotation

from posor_calibration.arm.arm_poses import recorded_poses
from posor_calibration.arm.endpoint_references import check_references

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from posor.calibration.calibration_file import Calibration
    from posor.chain.kinematic_chain import Chain
    from posor.estimation.estimate import Estimates
    from posor.messages.estimate_arrays import ArmEstimates
    from posor.numerics.array_types import FloatArray

    from posor_calibration.arm.endpoint_references import EndpointReferences

LEAST_POSES = 4
SPREAD = 0.02  # of the seats in two directions [m], from which they show how the artefact is turned
LARGEST_MISFIT = 0.01  # of a ball in the first test from its seat, with the artefact as the test places it [m]
ANGLE = "angle"


def date_text(stamp_ns: int) -> str:
    """Return a stamp as date and time, UTC."""
    return f"{np.datetime64(stamp_ns, 'ns').astype('datetime64[s]')}Z"


class Number(NamedTuple):
    """A number of a test."""

    pose: int  # number of the dwell, from 1
    part: str  # a ball, or a joint
    quantity: str  # x, y, z of a ball; the angle of a joint, or the name of a reading whose residual it is
    unit: str
    value: float
    sigma: float  # standard uncertainty by noise; of a ball, that of its seat alone


@dataclass(frozen=True)
class HealthTest:
    """A test."""

    stamp_ns: int  # of its first dwell
    numbers: tuple[Number, ...]

    @property
    def keys(self) -> list[tuple[int, str, str]]:
        """Pose, part and quantity of each number but the angles."""
        return [number[:3] for number in self.numbers if number.quantity != ANGLE]

    @property
    def angles(self) -> FloatArray:
        """Of the joints at the poses [rad], (n, j)."""
        own = [number for number in self.numbers if number.quantity == ANGLE]
        return np.array([number.value for number in own]).reshape(own[-1].pose, -1)

    @property
    def values(self) -> FloatArray:
        """Of the numbers but the angles [m], (m,)."""
        return np.array([number.value for number in self.numbers if number.quantity != ANGLE])

    @property
    def sigmas(self) -> FloatArray:
        """Their standard uncertainties by noise [m], (m,)."""
        return np.array([number.sigma for number in self.numbers if number.quantity != ANGLE])


class HealthArm:
    """An arm by its files, and its balls.

    Attributes:
        chain: The chain.
        posors: Of the joints, from the base.
        balls: Place of each ball in the endpoint [m], (3,).

    """

    def __init__(self, chain: Chain, calibrations: Mapping[str, Calibration], balls: Mapping[str, FloatArray]) -> None:
        """Build the POSORs; the charts judge their residuals: the test of single scans rejects none.

        ``calibrations``: of all joints, by name.
        """
        self.chain, self.balls = chain, balls
        self.posors = {joint.name: Posor(calibrations[joint.name], false_alarm=0.0) for joint in chain.path_joints}

    @property
    def calibrations(self) -> dict[str, Calibration]:
        """Of the joints, from the base."""
        return {name: posor.calibration for name, posor in self.posors.items()}

    def measure(
        self,
        estimates: ArmEstimates,
        references: EndpointReferences,
        window_s: float,
        where: str,
        T_artefact_base: pin.SE3 | None = None,
    ) -> tuple[HealthTest, pin.SE3]:
        """Return the test that a recording holds, and the base in the frame of the artefact.

        ``references``: seats of the balls at the dwells; ``window_s``: scans this long about each are averaged [s];
        ``where``: the bag, in errors; ``T_artefact_base``: of the first test; None: this is the first one. Raises
        TrackError: a reference is no point, there are too few dwells, or the seats of the first test are not where the
        arm finds the balls; BagError: a joint moves or has no usable scan.
        """
        other = [name for name, kind in references.reflectors.items() if kind != "point"]
        if other:
            raise TrackError("has no position", where=f"reference '{other[0]}'", expected="x, y, z of a seat")
        stamps_ns, rows = references.stamps_ns, references.rows
        if len(rows) < LEAST_POSES:
            expected = f"at least {LEAST_POSES} in postures that differ, better 8"
            raise TrackError(f"{len(rows)} dwells", where="health", expected=expected)
        poses = recorded_poses(estimates, self.chain, stamps_ns, rows, window_s, where)
        found = self.chain.estimate_all(poses.transforms, poses.random, poses.systematic).poses
        endpoints = [pin.XYZQUATToSE3(pose) for pose in found]
        by_arm = np.array([endpoints[each.pose].act(self.balls[each.reflector]) for each in references.readings])
        T = T_artefact_base
        if T is None:
            tools = {name: pin.SE3(np.eye(POINT), place) for name, place in self.balls.items()}
            check_references(references, endpoints, tools, where)
            T = _place_base(by_arm, references, where)
        numbers: list[Number] = []
        for n, stamp_ns in enumerate(stamps_ns.tolist()):
            for name, angle in zip(self.posors, poses.angles[n].tolist(), strict=True):
                numbers.append(Number(n + 1, name, ANGLE, "rad", angle, 0.0))
            for each, place in zip(references.readings, by_arm, strict=True):
                if each.pose == n:
                    parts = zip("xyz", (T.act(place) - each.values).tolist(), each.sigmas.tolist(), strict=True)
                    numbers += [Number(n + 1, each.reflector, *axis[:1], "m", *axis[1:]) for axis in parts]
            for (name, posor), pose in zip(self.posors.items(), poses.transforms[n], strict=True):
                own = _mean_residuals(posor, estimates.joints[name], pin.XYZQUATToSE3(pose), stamp_ns, window_s)
                numbers += [Number(n + 1, name, *reading[:1], "m", *reading[1:]) for reading in own]
        return HealthTest(int(stamps_ns.min()), tuple(numbers)), T


def _place_base(by_arm: FloatArray, references: EndpointReferences, where: str) -> pin.SE3:
    """Return the base in the frame of the seats, where the arm has the balls (n, 3) [m]: turned only if seats spread.

    Raises TrackError: a ball is far from its seat, however the artefact is turned.
    """
    seats = np.array([each.values for each in references.readings])
    arm_mean, seat_mean = by_arm.mean(axis=0), seats.mean(axis=0)
    with warnings.catch_warnings(action="ignore"):  # seats on one line show no turn about it: any of them will do
        turn = Rotation.align_vectors(seats - seat_mean, by_arm - arm_mean)[0].as_matrix()
    misfits = np.linalg.norm(seats - seat_mean - (by_arm - arm_mean) @ turn.T, axis=1)
    worst = int(np.argmax(misfits))
    if misfits[worst] > LARGEST_MISFIT:
        what = f"the ball is {misfits[worst]:.3g} m from its seat"
        expected = f"at most {LARGEST_MISFIT:g} m: perhaps rows, seats or --tool are exchanged or in another unit"
        raise TrackError(what, where=f"{where}, {references.readings[worst].name}", expected=expected)
    if np.linalg.svd(seats - seat_mean, compute_uv=False)[1] <= SPREAD * np.sqrt(len(seats)):
        turn = np.eye(POINT)
    return pin.SE3(turn, seat_mean - turn @ arm_mean)


def _mean_residuals(
    posor: Posor, estimates: Estimates, T: pin.SE3, stamp_ns: int, window_s: float
) -> Iterator[tuple[str, float, float]]:
    """Yield name, mean residual and its noise [m] of each reading of a joint at its mean pose."""
    usable = estimates.stamps_ns[np.isin(estimates.states, USABLE_STATES)]
    near = usable[np.abs(usable - stamp_ns) <= round(window_s * NS)]
    scans = corrected_scans(estimates.scans, posor.calibration)
    read = posor.stack.linearise(scans.select(np.isin(scans.stamps_ns, near)))
    alike = (read.selected == read.selected[len(read.selected) // 2]).all(axis=1)
    predicted, jacobian = posor.stack.evaluate(read.selected[alike][0], T.rotation.copy(), T.translation.copy())
    variances = read.variances[alike].mean(axis=0)
    weighted = jacobian / variances[:, None]
    misclosure = read.values[alike].mean(axis=0) - predicted
    residuals = misclosure - jacobian @ np.linalg.solve(jacobian.T @ weighted, weighted.T @ misclosure)
    sigmas = np.sqrt(variances / np.count_nonzero(alike))
    return zip(posor.stack.reading_names, residuals.tolist(), sigmas.tolist(), strict=True)
