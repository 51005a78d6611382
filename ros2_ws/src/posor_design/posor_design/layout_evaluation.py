# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a layout achieves over a range of motion: uncertainties and detectable faults, from its calibration.

The covariances are those that the estimator states for simulated scans, the minimal detectable biases those of
``uncertainty.reliability``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor.model.native_coordinates import native_jacobian, rotation_from_native
from posor.uncertainty.budget_poses import scan_at
from posor.uncertainty.reliability import joint_reliability

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

    from posor_design.layout_geometry import LayoutKind
    from posor_design.posor_layout import PosorLayout
    from posor_design.requirement import Requirement

MIDDLES = 8  # poses in the middle of the range
_SEED = 1985
_MOTIONS = 5  # freedoms with a middle: x, y, gap, alpha, beta


@dataclass(frozen=True)
class RangePoses:
    """Poses of a range: native coordinates (n, 6), rotations (n, 3, 3), translations (n, 3) [m], thetas (n,) [rad]."""

    native: FloatArray

    @property
    def rotations(self) -> FloatArray:
        """R_R_T of each pose."""
        return np.array([rotation_from_native(*row[3:]) for row in self.native])

    @property
    def translations(self) -> FloatArray:
        """Origin of T in R of each pose."""
        return np.ascontiguousarray(self.native[:, :3])

    @property
    def thetas(self) -> FloatArray:
        """Theta of each pose."""
        return np.ascontiguousarray(self.native[:, 5])


def extreme_poses(requirement: Requirement, gap: float) -> RangePoses:
    """Return poses at half of the corners of the range and in its middle, theta at random, the same in every call.

    Evenly spread thetas could be at the same phase of all bumps.

    The corners are those of a fractional factorial design of resolution V: every two freedoms have all four pairs of
    ends.

    ``requirement``: for its range. ``gap``: in the middle [m].
    """
    free = np.array(list(product((-1.0, 1.0), repeat=_MOTIONS - 1)))
    corners = np.column_stack([free, np.prod(free, axis=1)])
    shares = np.concatenate([corners, np.zeros((MIDDLES, _MOTIONS))])
    return _poses(requirement, gap, shares, np.random.default_rng(_SEED).uniform(-1.0, 1.0, len(shares)))


def random_poses(requirement: Requirement, gap: float, count: int, random: np.random.Generator) -> RangePoses:
    """Return poses that are uniform over the range; ``gap``: in the middle [m]."""
    shares = random.uniform(-1.0, 1.0, (count, _MOTIONS + 1))
    return _poses(requirement, gap, shares[:, :_MOTIONS], shares[:, _MOTIONS])


def _poses(requirement: Requirement, gap: float, shares: FloatArray, turns: FloatArray) -> RangePoses:
    limits = requirement.range
    runout, tilt = limits.runout.number, limits.tilt.number
    native = np.column_stack([shares * [runout, runout, limits.gap.number, tilt, tilt], turns * requirement.rotation])
    native[:, 2] += gap
    return RangePoses(native)


@dataclass(frozen=True)
class Candidate:
    """A layout and what it achieves."""

    kind: LayoutKind  # its discrete choices
    layout: PosorLayout
    random: FloatArray  # variances of the freedoms by the noise at each pose, (n, 6) [m^2, rad^2]
    systematic: FloatArray  # variances by the calibration, (n, 6)
    fault: float  # largest minimal detectable bias of a reading [m]; infinite: a reading is unchecked
    readable: bool  # whether all sensors give a pose everywhere, and the numbers of the light sources are unambiguous

    @property
    def sigmas(self) -> FloatArray:
        """Largest standard uncertainty of each freedom, (6,)."""
        return np.asarray(np.sqrt(np.max(self.random + self.systematic, axis=0)))

    def largest_noise(self, sigmas: FloatArray) -> float:
        """Return by which factor the noise may grow before an uncertainty exceeds ``sigmas`` (6,); zero: not at all.

        Exact in first order: the weights of the readings do not change if all noises grow alike.
        """
        left = np.square(sigmas) - self.systematic
        ratios = np.divide(left, self.random, out=np.full_like(left, np.inf), where=self.random > 0.0)
        return float(np.sqrt(max(float(np.min(ratios)), 0.0)))


def evaluate(requirement: Requirement, kind: LayoutKind, layout: PosorLayout, poses: RangePoses) -> Candidate:
    """Return what a layout achieves at poses of its range.

    ``requirement``: for the scan rate and the velocity. ``kind``: discrete choices of the layout. ``poses``: as
    ``extreme_poses``; the faults are evaluated at the last one.
    """
    calibration = layout.calibration(requirement)
    posor = Posor(calibration)
    rotations, translations, thetas = poses.rotations, poses.translations, poses.thetas
    scans = scans_at(posor.stack, rotations, translations, np.arange(len(thetas), dtype=np.int64))
    found = posor.estimate_each(scans, thetas)
    readable = bool(np.all(found.states == State.OK)) and not any(sensor.slip_angle for sensor in calibration.sensors)
    fault = np.inf
    if readable:
        pose = pin.SE3(rotations[-1], translations[-1])
        fault = float(np.max(joint_reliability(posor, scan_at(posor, pose), pose).biases))
    return Candidate(
        kind,
        layout,
        _native_variances(rotations, found.covariances_random),
        _native_variances(rotations, found.covariances_systematic),
        fault,
        readable,
    )


def with_noise(requirement: Requirement, candidate: Candidate, noise: float, poses: RangePoses) -> Candidate:
    """Return the candidate evaluated with another noise of its electronics."""
    return evaluate(requirement, candidate.kind, replace(candidate.layout, noise=noise), poses)


def _native_variances(rotations: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return the variances of the native coordinates, (n, 6), from covariances in ROS order, (n, 6, 6)."""
    variances = np.empty(covariances.shape[:2])
    variances[:, :3] = np.diagonal(covariances[:, :3, :3], axis1=1, axis2=2)
    for own, rotation, covariance in zip(variances, rotations, covariances, strict=True):
        jacobian = native_jacobian(rotation)
        own[3:] = np.diagonal(jacobian @ covariance[3:, 3:] @ jacobian.T)
    return variances
