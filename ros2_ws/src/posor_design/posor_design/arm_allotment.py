# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Allot the required uncertainty of an arm's endpoint to its POSORs and measuring beams.

Each POSOR has two unknown standard uncertainties, of its angles and of its translations, and each beam two, of the
orientation and of the position of its end. The variance of the endpoint along and about each axis of the base is a sum
of their squares with constant weights: squares of levers, and ones. The weights come from the endpoint budget, one part
at a time. Of all allotments within the requirement in every posture, the one with the least effort is taken, the sum of

    present uncertainty / allotted uncertainty

over all parts. In the logarithms of the variances this is a convex problem (``scipy.optimize``, SLSQP). Sag of the
beams is not allotted: its uncertainty is a fixed part of the endpoint's.

Source of the budget: thesis 9.3.1, JCGM 100. Cost as the reciprocal of a tolerance: K. W. Chase, W. H. Greenwood,
*Design issues in mechanical tolerance analysis*, Manufacturing Review 1(1), 1988.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.chain.beams_file import load_beams
from posor.chain.kinematic_chain import Chain
from posor.errors import DesignError, FitError, ParameterError
from posor.uncertainty.budget_poses import model_covariances
from posor.uncertainty.common_errors import CommonErrors
from scipy.optimize import NonlinearConstraint, minimize

from posor_design.endpoint_budget import BEAMS, SHARED, endpoint_budget
from posor_design.reliability_report import AXES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.chain.arm_file import ArmFile
    from posor.chain.beam_entries import BeamFile
    from posor.chain.beams_file import BeamsFile
    from posor.numerics.array_types import FloatArray

    from posor_design.endpoint_budget import Spread


LARGEST_IMPROVEMENT, LARGEST_RELAXATION = 10.0, 100.0
"""Present over allotted uncertainty of a part at most, and allotted over present."""
_UNIT = 1e-6  # standard uncertainty for which the weights are computed [m], [rad]; the budget is linear in its square
_MICRO = 1e6
NO_COMMON_ERRORS = CommonErrors()


class Group(NamedTuple):
    """Uncertainties of a part that are allotted as one: ``what`` is angles or translations, ``beam``: not a joint."""

    part: str
    what: str
    beam: bool

    @property
    def unit(self) -> str:
        """SI unit."""
        return "rad" if self.what == "angles" else "m"


@dataclass(frozen=True)
class Allotment:
    """Uncertainties of all groups that together meet the requirement."""

    groups: tuple[Group, ...]  # the g groups: of each joint from the base on, then of each beam
    # present standard uncertainty of each group [m, rad], (g,): the largest of three axes in all postures
    present: FloatArray
    allotted: FloatArray  # allotted standard uncertainty, (g,)
    postures: tuple[Mapping[str, float], ...]  # angles of the joints [rad], by name, of each posture
    required: FloatArray  # largest standard uncertainty of the endpoint, (6,) [m, rad]
    endpoint: FloatArray  # its standard uncertainty with the allotment, (postures, 6)
    before: FloatArray  # with the present covariances of the joints and the present beams, (postures, 6)
    # part of each group in the variance of the axis that uses most of its requirement, (g,); what is missing from 1 is
    # the sag of the beams and shared terms
    shares: FloatArray
    errors: CommonErrors  # of the calibrating laboratory, which no part can reduce


class EndpointWeights:
    """Weights of all groups in the variances of an arm's endpoint."""

    def __init__(
        self, arm: ArmFile, postures: Sequence[Mapping[str, float]], errors: CommonErrors = NO_COMMON_ERRORS
    ) -> None:
        """Compute the weights from the endpoint budget; ``errors``: see ``allot``.

        Raises PosorError: a file of the arm is invalid, or a POSOR has no pose at an angle.
        """
        self._arm, self._postures = arm, postures
        self._beams = None if arm.beams is None else errors.beams_with(load_beams(arm.beams))
        chain = Chain(arm.chain().urdf, arm.endpoint_frame, self._beams)
        self._joints = [joint.name for joint in chain.joints]
        self._exact = Chain(chain.urdf, arm.endpoint_frame)
        listed = [] if self._beams is None else [beam for beam in self._beams.beams if _is_uncertain(beam)]
        self.groups = (
            *(Group(name, what, beam=False) for name in self._joints for what in ("angles", "translations")),
            *(Group(beam.joint, what, beam=True) for beam in listed for what in ("angles", "translations")),
        )
        calibrations = {name: errors.calibration_with(arm.calibration(name)) for name in self._joints}
        models = [model_covariances(calibrations, chain, posture) for posture in postures]
        covariances = [model.own() for model in models]
        budgets = [
            endpoint_budget(chain, posture, own, model.shared)
            for posture, own, model in zip(postures, covariances, models, strict=True)
        ]
        # present standard uncertainty of the endpoint by its budget, axis by axis, (postures, 6)
        self.before = np.sqrt([_variances(budget.spread) for budget in budgets])
        # their present standard uncertainties, (g,): the largest of three axes, as all three are allotted alike
        self.present = np.array([*self._largest(covariances), *(s for beam in listed for s in _present_beam(beam))])
        # variances that are not allotted, sag and shared terms, (postures, 6)
        self.fixed = np.array([self._beam_variances(posture, "", np.zeros(6)) for posture in postures])
        for n, budget in enumerate(budgets):
            for part in budget.contributions:
                self.fixed[n] += _variances(part.spread) if part.name.startswith(SHARED) else 0.0
        # variance of an axis by unit variance of a group, (postures, 6, g)
        self.weights = np.array([self._weights(posture) for posture in postures])

    def _largest(self, covariances: Sequence[Mapping[str, FloatArray]]) -> list[float]:
        """Return the largest uncertainty of each joint over axes and postures: angles and translations in turn."""
        variances = [[np.diagonal(each[name]).reshape(2, 3) for name in self._joints] for each in covariances]
        sigmas = np.sqrt(np.max(variances, axis=(0, 3)))
        return [float(sigma) for translation, angle in sigmas for sigma in (angle, translation)]

    def _weights(self, posture: Mapping[str, float]) -> FloatArray:
        columns = []
        for group in self.groups:
            variances = np.zeros(6)
            variances[3:] = _UNIT**2 if group.what == "angles" else 0.0
            variances[:3] = 0.0 if group.what == "angles" else _UNIT**2
            if group.beam:
                without_sag = self._beam_variances(posture, group.part, variances, sag=False)
            else:
                none = np.zeros((6, 6))
                covariances = {name: np.diag(variances) if name == group.part else none for name in self._joints}
                without_sag = _variances(endpoint_budget(self._exact, posture, covariances).spread)
            columns.append(without_sag / _UNIT**2)
        return np.array(columns).T

    def _beam_variances(
        self, posture: Mapping[str, float], name: str, variances: FloatArray, *, sag: bool = True
    ) -> FloatArray:
        """Return the variances of the endpoint by one beam, all other placements exact; ``sag``: with that of all."""
        if self._beams is None:
            return np.zeros(6)
        values = {beam.joint: variances if beam.joint == name else np.zeros(6) for beam in self._beams.beams}
        beams = beams_with(self._beams, values, sag=sag)
        chain = Chain(self._exact.urdf, self._arm.endpoint_frame, beams)
        budget = endpoint_budget(chain, posture, dict.fromkeys(self._joints, np.zeros((6, 6))))
        return next((_variances(part.spread) for part in budget.contributions if part.name == BEAMS), np.zeros(6))

    def endpoint(self, sigmas: FloatArray) -> FloatArray:
        """Return the standard uncertainty of the endpoint, (postures, 6), for those of the groups, (g,)."""
        return np.asarray(np.sqrt(self.fixed + self.weights @ np.square(sigmas)))


def allot(
    arm: ArmFile, required: FloatArray, postures: Sequence[Mapping[str, float]], errors: CommonErrors = NO_COMMON_ERRORS
) -> Allotment:
    """Return the allotment of least effort.

    ``arm``: the arm; its present POSORs and beams state what accuracy costs the effort 1. ``required``: largest
    standard uncertainty of the endpoint along and about the axes of the base, (6,) [m, rad]. ``postures``: angles of
    the joints [rad], by name, in which the requirement holds. ``errors``: of the laboratory that calibrates all parts,
    which the files state as shared terms. Raises DesignError: the requirement cannot be met; the
    error names the axis and the nearest requirement. Raises FitError: no allotment was found. Raises PosorError: a file
    of the arm is invalid, or a POSOR has no pose at an angle.
    """
    if not postures:
        raise ParameterError("no posture", where=f"arm '{arm.name}'", expected="at least one")
    weights = EndpointWeights(arm, postures, errors)
    _require_feasible(arm, weights, required)
    allotted = _least_effort(weights, required)
    endpoint = weights.endpoint(allotted)
    posture, axis = np.unravel_index(np.argmax(endpoint / required), endpoint.shape)
    own = weights.weights[posture, axis] * np.square(allotted)
    return Allotment(
        weights.groups,
        weights.present,
        allotted,
        tuple(postures),
        required,
        endpoint,
        weights.before,
        np.asarray(own / endpoint[posture, axis] ** 2),
        errors,
    )


def _require_feasible(arm: ArmFile, weights: EndpointWeights, required: FloatArray) -> None:
    """Refuse a requirement below what the best parts reach."""
    best = np.max(weights.endpoint(weights.present / LARGEST_IMPROVEMENT), axis=0)
    used = best / required
    if np.all(used < 1.0):
        return
    axis = int(np.argmax(used))
    unit = "um" if axis < 3 else "urad"  # noqa: PLR2004  translations, then rotations
    sag = np.sqrt(np.max(weights.fixed[:, axis]))
    nearest = ", ".join(
        f"{name} {_MICRO * 1.01 * np.max(best[part]):.3g} {own}"
        for name, part, own in (("--displacement", slice(0, 3), "um"), ("--orientation", slice(3, 6), "urad"))
        if np.any(used[part] >= 1.0)
    )
    asked = _MICRO * required[axis]
    raise DesignError(
        f"{asked:.3g} {unit} is beyond reach {AXES[axis]}: {_MICRO * best[axis]:.3g} {unit} if all "
        f"parts were {LARGEST_IMPROVEMENT:g} times as good, sag and shared terms {_MICRO * sag:.3g} {unit} of it",
        where=f"arm '{arm.name}'",
        expected=f"at least {nearest} (standard uncertainties)",
    )


def _least_effort(weights: EndpointWeights, required: FloatArray) -> FloatArray:
    """Return the allotted standard uncertainties, (g,)."""
    left = np.square(required) - weights.fixed
    shares = (weights.weights * np.square(weights.present) / left[:, :, None]).reshape(-1, len(weights.groups))
    low, high = -2.0 * math.log(LARGEST_IMPROVEMENT), 2.0 * math.log(LARGEST_RELAXATION)
    evenly = min(max(-math.log(np.max(np.sum(shares, axis=1))), low), high)

    def effort(logarithms: FloatArray) -> float:
        return float(np.sum(np.exp(-0.5 * logarithms)))

    def effort_gradient(logarithms: FloatArray) -> FloatArray:
        return np.asarray(-0.5 * np.exp(-0.5 * logarithms))

    found = minimize(
        effort,
        [evenly] * len(weights.groups),
        jac=effort_gradient,
        method="SLSQP",
        bounds=[(low, high)] * len(weights.groups),
        constraints=NonlinearConstraint(
            lambda logarithms: shares @ np.exp(logarithms), -np.inf, 1.0, lambda logarithms: shares * np.exp(logarithms)
        ),
        options={"maxiter": 500, "ftol": 1e-9},
    )
    if not found.success:
        raise FitError(f"no allotment was found: {found.message}", where="the allotment")
    variances = np.exp(found.x)
    variances /= max(1.0, float(np.max(shares @ variances)))  # the solver may exceed a constraint by its tolerance
    return np.asarray(weights.present * np.sqrt(variances))


def beams_with(beams: BeamsFile, variances: Mapping[str, FloatArray], *, sag: bool = True) -> BeamsFile:
    """Return the beams with other uncertainties of their ends.

    ``variances``: of the named beams, (6,): position along, then orientation about the axes of the start. ``sag``:
    whether the beams sag.
    """
    content = beams.model_dump(mode="json")
    for beam in content["beams"]:
        if beam["joint"] in variances:
            sigmas = np.sqrt(variances[beam["joint"]]).tolist()
            beam["uncertainty"]["position"]["value"] = sigmas[:3]
            beam["uncertainty"]["orientation"]["value"] = sigmas[3:]
        if not sag:
            beam["sag"] = None
    return type(beams).model_validate(content)


def _is_uncertain(beam: BeamFile) -> bool:
    return bool(np.all(np.array(_present_beam(beam)) > 0.0))


def _present_beam(beam: BeamFile) -> tuple[float, float]:
    """Return the largest uncertainties of orientation and of position of three axes each."""
    uncertainty = beam.uncertainty
    return float(np.max(uncertainty.orientation.array)), float(np.max(uncertainty.position.array))


def _variances(spread: Spread) -> FloatArray:
    return np.concatenate([np.square(spread.displacement), np.square(spread.orientation)])
