# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""An arm as a chain of uncertain transforms: base, beams and POSORs, and the derivatives of its endpoint by all errors.

Each element of the chain is a free joint of a pinocchio model. With its placement P and its measured motion M it is
P exp(v) M, where v is its error [m, rad] in the axes of P: at the end of a beam, or at the target plate's mean origin
in the axes of the receiving plate. The errors of all elements at a pose are linear in the parameters: v = A parameters.
The derivatives by v are those of ``pinocchio.computeJointKinematicRegressor``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from posor.calibration.shared_terms import check_same_terms
from posor.errors import ChainError
from posor.estimation.posor import Posor
from posor.uncertainty.budget_poses import scan_at
from posor.uncertainty.reading_sensitivity import sensitivity_at
from scipy.linalg import block_diag

from posor_calibration.data_checks import POSE_AXES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.chain.kinematic_chain import Chain
    from posor.chain.measuring_beam import MeasuringBeam
    from posor.numerics.array_types import FloatArray

UNITS = ("m", "m", "m", "rad", "rad", "rad")
BASE = "base"
BASE_SIGMAS = (1.0, 1.0)
"""Prior standard uncertainty of the base in the frame of the references [m], [rad]: not known beforehand."""
EXACT = 1e-9  # standard uncertainty [m], [rad] of what the files state as exact


class Parameter(NamedTuple):
    """A parameter, which is zero before the calibration."""

    name: str  # such as "forearm x"
    unit: str
    sigma: float  # prior standard uncertainty


@dataclass(frozen=True)
class ArmPoses:
    """What the POSORs measure at n poses of an arm at rest."""

    names: tuple[str, ...]  # of the poses, (n,)
    angles: FloatArray  # of the joints [rad], (n, j)
    transforms: FloatArray  # target plate in receiving plate, x, y, z [m] and unit quaternion x, y, z, w, (n, j, 7)
    random: FloatArray  # covariance by noise, ROS order, axes of the receiving plate, (n, j, 6, 6)
    systematic: FloatArray  # covariance by calibration, surroundings and shared terms, likewise
    kelvins: FloatArray  # temperatures of the beams [K], (n, b); NaN: that of the URDF

    def select(self, rows: Sequence[int]) -> ArmPoses:
        """Return some of the poses."""
        arrays = (getattr(self, name)[list(rows)] for name in _ARRAYS)
        return ArmPoses(tuple(self.names[row] for row in rows), *arrays)

    def at_reference(self) -> ArmPoses:
        """Return the same with all beams at the temperature of the URDF."""
        return replace(self, kelvins=np.full_like(self.kelvins, math.nan))


_ARRAYS = ("angles", "transforms", "random", "systematic", "kelvins")


class JointEffects(NamedTuple):
    """Changes of a joint's transform by one standard uncertainty of its causes at n poses, ROS order."""

    own: FloatArray  # of q independent causes of its own, (n, 6, q)
    shared: Mapping[str, FloatArray]  # of shared terms, by name, (n, 6)
    rest: FloatArray  # covariance of its surroundings that are not measured, (6, 6)


def joint_effects(posor: Posor, transforms: FloatArray, systematic: FloatArray) -> JointEffects:
    """Return the effects at transforms (n, 7) whose systematic covariances (n, 6, 6) the estimator has stated.

    Raises ParameterError: a sensor has no forward model, or is out of range.
    """
    root, terms = posor.parameter_square_root, tuple(posor.calibration.shared)
    effects = np.empty((len(transforms), 6, root.shape[1]))
    for n, T in enumerate(map(pin.XYZQUATToSE3, transforms)):
        scan = scan_at(posor, T)
        by_parameter = posor.stack.residual_jacobian(scan, T.rotation.copy(), T.translation.copy())
        effects[n] = sensitivity_at(posor, scan, T).gain @ by_parameter @ root
    rest = _nearest_covariance(np.mean(systematic - np.einsum("nap,nbp->nab", effects, effects), axis=0))
    own = root.shape[1] - len(terms)
    return JointEffects(effects[:, :, :own], {t: effects[:, :, own + k] for k, t in enumerate(terms)}, rest)


def _nearest_covariance(matrix: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors * np.maximum(values, 0.0) @ vectors.T)


@dataclass(frozen=True)
class Element:
    """A free joint of the model: base, beam or POSOR."""

    name: str
    index: int  # in the model
    beam: MeasuringBeam | None
    joint: int | None  # number of the POSOR


class Motion(NamedTuple):
    """Endpoints in the frame of the references at n poses, and their derivatives."""

    endpoints: list[pin.SE3]
    by_parameter: FloatArray  # in the axes of the endpoint, (n, 6, p)
    by_joint: FloatArray  # by a small motion of each POSOR's transform, ROS order, (n, j, 6, 6)


class ArmStates(NamedTuple):
    """Poses as the model needs them."""

    motions: FloatArray  # of the elements, x, y, z [m] and quaternion, (n, e, 7)
    errors: FloatArray  # of the elements by the parameters, (n, e, 6, p)
    own: FloatArray  # covariances of the POSORs' transforms that are new at each pose: noise, varying, (n, j, 6, 6)


class ArmModel:
    """The arm, its parameters, and the effects of its POSORs' calibrations.

    Attributes:
        chain: The chain before the calibration.
        joints: Names of the POSORs from base to endpoint.
        elements: Base, beams and POSORs, from the base.
        parameters: Errors of base, beams and POSORs, of the sag, and shared terms; the tool's are not among them.
        origins: Mean place of each target plate in its receiving plate [m], (j, 3).
        sags: Which of them is the error of the sag, by beam.
        prior: Their covariance before the calibration, (p, p).

    """

    def __init__(self, chain: Chain, calibrations: Mapping[str, Calibration], poses: ArmPoses) -> None:
        """Build the model; prior uncertainties are those of the beams file and, at these poses, of the calibrations.

        Raises ChainError: a POSOR does not move the endpoint; CalibrationError: a shared term has two uncertainties;
        ParameterError: as ``joint_effects``.
        """
        files = {f"calibration '{name}'": each.shared for name, each in calibrations.items()}
        check_same_terms({"the beams file": chain.shared, **files})
        if len(chain.joints) != len(chain.path_joints):
            others = ", ".join(joint.name for joint in chain.joints if joint not in chain.path_joints)
            what = f"POSOR {others} does not move the endpoint"
            raise ChainError(what, where="the URDF", expected="POSORs between base and endpoint only")
        self.chain = chain
        self.joints = tuple(joint.name for joint in chain.path_joints)
        self._posors = [Posor(calibrations[name]) for name in self.joints]
        effects = self.effects_at(poses)
        self._means = [each.own.mean(axis=0) for each in effects]
        self._numbers = {beam.name: number for number, beam in enumerate(chain.beams)}
        self.origins = poses.transforms[:, :, :3].mean(axis=0)
        self._model, self.elements, self._T_last_endpoint = self._build()
        covariances = [self._prior_of(element, effects) + EXACT**2 * np.eye(6) for element in self.elements]
        names = [
            (f"{element.name} {axis}", unit)
            for element in self.elements
            for axis, unit in zip(POSE_AXES, UNITS, strict=True)
        ]
        sags = {e.name: e.beam.sag_sigma for e in self.elements if e.beam is not None and e.beam.sag_sigma}
        self.sags = {name: len(names) + k for k, name in enumerate(sags)}
        terms = dict.fromkeys([*chain.shared, *(term for each in calibrations.values() for term in each.shared)])
        self._terms = {term: len(names) + len(sags) + k for k, term in enumerate(terms)}
        names += [*((f"{name} sag", "1") for name in sags), *((f"shared: {term}", "1") for term in terms)]
        self.prior: FloatArray = block_diag(*covariances, np.diag(np.square([*sags.values(), *(1.0 for _ in terms)])))
        self.parameters = [
            Parameter(*name, float(sigma)) for name, sigma in zip(names, np.sqrt(np.diagonal(self.prior)), strict=True)
        ]

    def effects_at(self, poses: ArmPoses) -> list[JointEffects]:
        """Return the effects of the calibrations at poses, by joint; raises ParameterError as ``joint_effects``."""
        parts = zip(self._posors, np.swapaxes(poses.transforms, 0, 1), np.swapaxes(poses.systematic, 0, 1), strict=True)
        return [joint_effects(*part) for part in parts]

    def _build(self) -> tuple[pin.Model, list[Element], pin.SE3]:
        """Return the model, its elements, and the endpoint in the last of them."""
        model = pin.Model()
        elements = [Element(BASE, model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), BASE), None, None)]

        def add(placement: pin.SE3, name: str, beam: MeasuringBeam | None, joint: int | None) -> None:
            index = model.addJoint(elements[-1].index, pin.JointModelFreeFlyer(), placement, name)
            elements.append(Element(name, index, beam, joint))

        before = pin.SE3.Identity()
        for number, link in enumerate(self.chain.links):
            before = link.before * link.after
            if link.beam is not None:
                add(link.before * link.beam.T_start_end, link.beam.name, link.beam, None)
                before = link.after
            if number < len(self.joints):
                add(before * pin.SE3(np.eye(3), self.origins[number]), self.joints[number], None, number)
        return model, elements, before

    def _prior_of(self, element: Element, effects: Sequence[JointEffects]) -> FloatArray:
        if element.joint is not None:
            mean = self._means[element.joint]
            return np.asarray(mean @ mean.T + effects[element.joint].rest)
        if element.beam is not None:
            turn = np.kron(np.eye(2), element.beam.T_start_end.rotation)
            return np.asarray(turn.T @ element.beam.covariance @ turn)
        return np.diag(np.square(np.repeat(BASE_SIGMAS, 3)))

    def varying(self, effects: Sequence[JointEffects]) -> FloatArray:
        """Return what the errors of the POSORs' transforms vary from pose to pose, covariances (n, j, 6, 6)."""
        differences = [each.own - mean for each, mean in zip(effects, self._means, strict=True)]
        return np.stack([np.einsum("nap,nbp->nab", each, each) for each in differences], axis=1)

    def states(self, poses: ArmPoses, effects: Sequence[JointEffects]) -> ArmStates:
        """Return what the model needs of poses, whose effects are those of ``effects_at``."""
        count, places = len(poses.transforms), len(self.elements)
        motions = np.zeros((count, places, 7))
        motions[..., 6] = 1.0
        errors = np.zeros((count, places, 6, len(self.parameters)))
        for e in range(places):
            errors[:, e, :, 6 * e : 6 * e + 6] = np.eye(6)
        for n, row in enumerate(poses.transforms):
            unbent = np.eye(3)
            for e, element in enumerate(self.elements):
                unbent = unbent @ self._model.jointPlacements[element.index].rotation
                if element.beam is not None:
                    straight = element.beam.T_start_end
                    force = straight.rotation @ unbent.T @ self.chain.gravity
                    turn = np.kron(np.eye(2), straight.rotation).T
                    kelvin = float(poses.kelvins[n, self._numbers[element.name]])
                    beam = element.beam if math.isnan(kelvin) else element.beam.at_temperature(kelvin)
                    motions[n, e] = pin.SE3ToXYZQUAT(straight.actInv(beam.T_under(force)))
                    if element.name in self.sags:
                        errors[n, e, :, self.sags[element.name]] = turn @ beam.sag_gain @ force
                    for term, effect in beam.shared_effects_under(force).items():
                        errors[n, e, :, self._terms[term]] = turn @ effect
                elif element.joint is not None:
                    T = pin.XYZQUATToSE3(row[element.joint])
                    unbent = unbent @ T.rotation
                    T.translation = T.translation - self.origins[element.joint]
                    motions[n, e] = pin.SE3ToXYZQUAT(T)
                    for term, effect in effects[element.joint].shared.items():
                        errors[n, e, :, self._terms[term]] = effect[n]
        return ArmStates(motions, errors, poses.random + self.varying(effects))

    def with_mean_effects(self, states: ArmStates) -> ArmStates:
        """Return the same with effects of parameters that are alike at all poses, but for those of the sag."""
        errors = np.broadcast_to(states.errors.mean(axis=0), states.errors.shape).copy()
        errors[..., list(self.sags.values())] = states.errors[..., list(self.sags.values())]
        return states._replace(errors=errors)

    def move(self, states: ArmStates, values: FloatArray, T_reference_base: pin.SE3) -> Motion:
        """Return the endpoints for parameters (p,) or more, and their derivatives by the first p.

        ``T_reference_base``: the base in the frame of the references, where its parameters are zero.
        """
        data, count = self._model.createData(), len(self.parameters)
        placements = [placement.copy() for placement in self._model.jointPlacements]
        placements[self.elements[0].index] = T_reference_base
        last, joints = self.elements[-1].index, [e for e in self.elements if e.joint is not None]
        endpoints, by_parameter = [], np.empty((len(states.motions), 6, count))
        by_joint = np.empty((len(states.motions), len(joints), 6, 6))
        model = self._model.copy()
        errors = states.errors @ values[:count]
        for n, motions in enumerate(states.motions):
            for element, error in zip(self.elements, errors[n], strict=True):
                model.jointPlacements[element.index] = placements[element.index] * pin.exp6(error)
            pin.forwardKinematics(model, data, motions.ravel())
            regressor = pin.computeJointKinematicRegressor(
                model, data, last, pin.ReferenceFrame.LOCAL, self._T_last_endpoint
            )
            blocks = regressor.reshape(6, len(self.elements), 6).swapaxes(0, 1)
            exact = np.array([block @ pin.Jexp6(error) for block, error in zip(blocks, errors[n], strict=True)])
            by_parameter[n] = np.einsum("eab,ebp->ap", exact, states.errors[n])
            by_joint[n] = blocks[[e.index - 1 for e in joints]]
            endpoints.append(data.oMi[last] * self._T_last_endpoint)
        return Motion(endpoints, by_parameter, by_joint)
