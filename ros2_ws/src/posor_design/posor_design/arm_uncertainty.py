# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of an arm's endpoint at any joint angles, from the files of the arm."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from GTC import dof, reporting, ureal
from posor.calibration.quantity import Quantity
from posor.calibration.shared_terms import check_same_terms
from posor.chain.beams_file import load_beams
from posor.chain.kinematic_chain import Chain
from posor.errors import ChainError, ParameterError
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor.uncertainty.budget_poses import estimates_at, require_poses
from scipy.special import chdtri, fdtri

from posor_design.endpoint_components import ArmPropagation, Component, JointCovariance, total_covariance

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pinocchio as pin
    from posor.calibration.calibration_file import Calibration
    from posor.chain.arm_file import ArmFile
    from posor.estimation.estimate import Estimates
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

COVERAGE = 0.95
DIMENSIONS = 3  # of the position


@dataclass(frozen=True)
class EndpointUncertainty:
    """Uncertainty of the endpoint at one pose, ROS order, axes of the base."""

    angles: Mapping[str, float]  # of the joints [rad], by name
    T_base_endpoint: pin.SE3
    components: tuple[Component, ...]  # those that are not zero
    standard: FloatArray  # standard uncertainties along and about each axis, (6,) [m], [rad]
    freedoms: FloatArray  # effective degrees of freedom, (6,)
    factors: FloatArray  # coverage factors, (6,)
    ellipsoid_factor: float  # coverage factor of the ellipsoid of the position
    ellipsoid_axes: FloatArray  # directions of its semi-axes, the columns, the longest first, (3, 3)
    ellipsoid: FloatArray  # lengths of its semi-axes [m], the longest first, (3,)

    @property
    def expanded(self) -> FloatArray:
        """Expanded uncertainties along and about each axis, (6,) [m], [rad]."""
        return np.asarray(self.factors * self.standard)

    @property
    def largest(self) -> float:
        """Expanded uncertainty of the position along the direction in which it is largest [m]."""
        return float(self.factors[:DIMENSIONS].max() * self.ellipsoid[0] / self.ellipsoid_factor)

    def shares(self) -> FloatArray:
        """Return the share of each component in the variance along and about each axis, (components, 6); sums are 1."""
        variances = np.array([np.diagonal(each.covariance) for each in self.components]).reshape(-1, 6)
        total = variances.sum(axis=0)
        return np.asarray(np.divide(variances, total, out=np.zeros_like(variances), where=total > 0.0))

    def position_shares(self) -> FloatArray:
        """Return the share of each component in the summed variances of x, y and z, (components,); their sum is 1."""
        traces = np.array([np.trace(each.covariance[:3, :3]) for each in self.components])
        return np.asarray(traces / traces.sum())

    @staticmethod
    def of(angles: Mapping[str, float], T: pin.SE3, components: Sequence[Component]) -> EndpointUncertainty:
        """Combine components; GTC finds the effective degrees of freedom (Welch-Satterthwaite, JCGM 100, G.4.1)."""
        present = tuple(each for each in components if np.any(each.covariance))
        covariance = total_covariance(present)
        standard = np.sqrt(np.diagonal(covariance))
        freedoms = np.array([_effective_freedoms(present, axis) for axis in range(6)])
        factors = np.array([reporting.k_factor(number, 100.0 * COVERAGE) for number in freedoms])
        variances, axes = np.linalg.eigh(covariance[:3, :3])
        factor = region_factor(float(freedoms[:DIMENSIONS].min()))
        lengths = factor * np.sqrt(np.maximum(variances[::-1], 0.0))
        return EndpointUncertainty(angles, T, present, standard, freedoms, factors, factor, axes[:, ::-1], lengths)


def _effective_freedoms(components: Sequence[Component], axis: int) -> float:
    parts = [(math.sqrt(each.covariance[axis, axis]), each.freedoms) for each in components]
    if all(math.isinf(freedoms) or sigma == 0.0 for sigma, freedoms in parts):
        return math.inf
    return float(dof(sum(ureal(0.0, sigma, df=freedoms) for sigma, freedoms in parts if sigma > 0.0)))


def region_factor(freedoms: float) -> float:
    """Return the coverage factor of the ellipsoid of the position.

    Source: JCGM 102:2011, 6.5.2, for infinite degrees of freedom; with fewer, Hotelling's T-squared. Infinite for less
    than three.
    """
    if math.isinf(freedoms):
        return math.sqrt(chdtri(DIMENSIONS, 1.0 - COVERAGE))
    left = freedoms - DIMENSIONS + 1.0
    if left <= 0.0:
        return math.inf
    return math.sqrt(DIMENSIONS * freedoms / left * fdtri(DIMENSIONS, left, COVERAGE))


class _JointEstimates(NamedTuple):
    """Estimates of a joint at m different angles [rad], and which of them each of n poses has."""

    angles: FloatArray  # (m,)
    estimates: Estimates  # (m,)
    places: IntArray  # (n,)


class ArmUncertainty:
    """The files of an arm, read once.

    Attributes:
        chain: The kinematic chain, with the stated or given range of the temperature of its beams.
        posors: By joint.
        calibrations: By joint, the sessions applied.
        joints: Names of the joints between base and endpoint, in this order.

    """

    def __init__(self, arm: ArmFile, *, deviation: float | None = None) -> None:
        """Read the files.

        ``deviation``: largest deviation of the beams from the temperature of the URDF [K]; None: as the beams file
        states. Raises PosorError: a file is invalid, or the files do not fit together.
        """
        self.chain = chain_at(arm, deviation)
        self.calibrations: dict[str, Calibration] = {
            joint.name: arm.calibration(joint.name) for joint in self.chain.joints
        }
        self.posors = {name: Posor(calibration) for name, calibration in self.calibrations.items()}
        self.joints = tuple(joint.name for joint in self.chain.path_joints)
        for joint in self.chain.joints:
            frames = self.calibrations[joint.name].frames
            if (frames.parent, frames.child) != (joint.parent, joint.child):
                what = f"measures '{frames.child}' in '{frames.parent}'"
                where = f"{arm.calibrations[joint.name]}, calibration of joint '{joint.name}'"
                raise ChainError(what, where=where, expected=f"'{joint.child}' in '{joint.parent}', as in {arm.urdf}")
        files = {f"calibration '{name}'": each.shared for name, each in self.calibrations.items()}
        check_same_terms({"the beams file": self.chain.shared, **files})

    def reachable(self, angles: FloatArray) -> BoolArray:
        """Return at which of n sets of angles (n, j) [rad] all POSORs have a valid pose, (n,)."""
        reached = [(each.estimates.states == State.OK)[each.places] for each in self._estimates(angles).values()]
        return np.asarray(np.all(reached, axis=0))

    def _estimates(self, angles: FloatArray) -> dict[str, _JointEstimates]:
        """Return the estimates at the different angles of each joint: a grid repeats them."""
        found = {}
        for name, own in zip(self.joints, angles.T, strict=True):
            values, places = np.unique(own, return_inverse=True)
            found[name] = _JointEstimates(values, estimates_at(self.posors[name], self.chain, name, values), places)
        return found

    def at(
        self,
        angles: FloatArray,
        *,
        scans: int = 1,
        observed: Mapping[str, tuple[FloatArray, float]] | None = None,
        stamp_shifts: FloatArray | None = None,
    ) -> list[EndpointUncertainty]:
        """Return the uncertainty at n poses of the arm.

        ``angles``: of ``joints`` [rad], (n, j). ``scans``: number of scans whose mean is the result; stated noise is
        independent. ``observed``: by joint, in place of the noise that the calibration states: observed covariance of
        the result, (6, 6), and its degrees of freedom; None: as stated. ``stamp_shifts``: largest errors by errors of
        the stamps, (n, 6), of an arm in motion; None: at rest. Raises ChainError: a POSOR has no valid pose at its
        angle.
        """
        estimates = self._estimates(angles)
        for name, each in estimates.items():
            require_poses(each.estimates, name, each.angles)
        freedoms = {name: calibration_freedoms(self.calibrations[name]) for name in self.joints}
        found = []
        for n, row in enumerate(angles):
            given = dict(zip(self.joints, map(float, row), strict=True))
            measured = {}
            for name, joint in estimates.items():
                own, k = joint.estimates, int(joint.places[n])
                random, of_random = (observed or {}).get(name, (own.covariances_random[k] / scans, math.inf))
                shared = dict(zip(self.calibrations[name].shared, own.shared_effects[k], strict=False))
                parts = random, own.covariances_systematic[k], shared
                measured[name] = JointCovariance(*parts, of_random, freedoms[name])
            arm = ArmPropagation(
                self.chain, {name: self.chain.nominal_joint(name, given[name]) for name in self.joints}
            )
            components = arm.components(measured, None if stamp_shifts is None else stamp_shifts[n])
            found.append(EndpointUncertainty.of(given, arm.T_base_endpoint, components))
        return found


def calibration_freedoms(calibration: Calibration) -> float:
    """Return the degrees of freedom of a calibration: the fewest of its fits, infinite without fits.

    A stated value without a fit is a type B evaluation whose uncertainty is taken as known (JCGM 100, G.4.3).
    """
    residuals = [each for fit in calibration.fits for each in fit.residuals.values()]
    return min((float(each.freedoms) for each in residuals if each.freedoms), default=math.inf)


def chain_at(arm: ArmFile, deviation: float | None) -> Chain:
    """Return the chain; its beams with a stated temperature deviate by at most ``deviation`` [K]; None: as stated.

    Raises PosorError: the URDF or the beams file is invalid, or a deviation has no effect.
    """
    chain = arm.chain()
    if deviation is None:
        return chain
    beams = None if arm.beams is None else load_beams(arm.beams)
    if beams is None or not any(beam.temperature for beam in beams.beams):
        if deviation == 0.0:
            return chain
        what, where = "no beam of the arm states how it expands", "option --temperature-deviation"
        expected = f"'temperature' with a coefficient in {arm.beams or 'a beams file'}"
        raise ParameterError(what, where=where, expected=expected)
    stated = Quantity(value=deviation, unit="K")
    given = {"deviation": stated, "spread": None, "thermometer": None}
    entries = [
        beam.model_copy(update={"temperature": beam.temperature and beam.temperature.model_copy(update=given)})
        for beam in beams.beams
    ]
    changed = beams.model_copy(update={"beams": entries})
    return Chain(chain.urdf, arm.endpoint_frame, changed, source=f"URDF {arm.urdf}", beams_source=str(arm.beams))
