# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Endpoints at servo rate and of recorded scans: one scan at a time or many, by the same compiled kernel."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor.chain.arm_geometry import beam_record
from posor.chain.beam_acceleration import BeamHistory
from posor.chain.fault_bounds import UNKNOWN, ArmCauses, EndpointBounds, bound_endpoints
from posor.chain.forward_kinematics import (
    HISTORY_FULL,
    Endpoints,
    estimate_endpoint_of_rows,
    estimate_endpoints,
    write_relative,
)
from posor.chain.joint_measurements import FAULT_TEXTS, VIBRATION, JointMeasurements, JointRows
from posor.errors import ChainError
from posor.estimation.fault_model import EFFECT, JointCauses
from posor.numerics.compiled import bind, bind_in_parts
from posor.numerics.vector import rotation_of_pose

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from posor.chain.arm_geometry import ArmGeometry
    from posor.chain.joint_measurements import JointRowLayout, MeasuredJoint
    from posor.chain.measuring_beam import MeasuringBeam
    from posor.numerics.array_types import ByteArray, FloatArray, IntArray


class EndpointEstimator:
    """Estimates endpoints scan after scan; ``Chain.estimator`` makes one.

    Fill ``poses``, both covariances and ``thetas`` in place and call ``estimate``, or fill ``rows`` and call
    ``estimate_rows``. All arrays stay the same objects from scan to scan. If a joint is unusable, every number of the
    endpoint is NaN. One scan and many give the same bits; both continue the motion seen before.

    Attributes:
        joints: Names of the joints, in the order of all arrays of joints.
        poses: Target plates in receiving plates, (j, 7): x, y, z [m], unit quaternion x, y, z, w.
        covariances_random: Of the same, (j, 6, 6), as ``MeasuredJoint.covariance_random``.
        covariances_systematic: Of the same, (j, 6, 6), as ``MeasuredJoint.covariance_systematic``.
        thetas: Counted large rotations of the joints [rad], (j,), for ``angles``; NaN: not counted.
        stamp_shifts: Largest errors of the joints' poses by errors of their stamps, (j, 6), as
            ``posor_msgs/JointTransform.stamp_shift``; at first zero.
        beam_transforms: Plates at the beams' ends in the plates at their starts, with the sag of the last scan, (b, 7),
            as ``poses``.
        accelerations: Of the beams [m/s^2], (b, 3), axes of the base: written if there is an acceleration window, read
            if there is none.
        vibrations: Specific forces that bend the beams, (1, b) of ``VIBRATION``, see ``chain.beam_vibration``; (1, 0):
            no beam states its vibration.
        static_forces: Gravity less acceleration in the last scan, (b, 3) [m/s^2], axes of the beams' starts; NaN: no
            beam states its vibration.
        rows: Serialised measurements of one scan, (j, bytes).
        rows_kernel: Estimates the endpoint of ``rows``; another one after the arrays of the kernels have changed.
        pose: Endpoint in the base frame, (7,), as ``poses``.
        covariance_random: Of the same, (6, 6), as ``Endpoint.covariance_random``.
        covariance_systematic: Of the same, (6, 6), as ``Endpoint.covariance_systematic``.
        angles: Joint angles about the nominal axes [rad], (j,).
        faults: Of the joints, (j,): zero, or a key of ``joint_measurements.FAULT_TEXTS``.
        shared_terms: Names of the shared terms of beams and joints, see ``use_terms``.
        stamp_shift: Largest error of the endpoint by errors of the stamps, along and about each axis, (6,) [m], [rad].
        fault_effects: What faults may do to the joints' poses, (j, C, EFFECT), see ``use_causes``; NaN: not known.
        protection_level: Of the endpoint, written by ``bound_error``, (6,) [m], [rad].
        relative_pose: Endpoint in the axes at home, (7,), written by ``estimate_relative_to``.
        relative_covariance_random: Of the same, (6, 6).
        relative_covariance_systematic: Of the same, (6, 6).
        relative_stamp_shift: Of the same, (6,).

    """

    def __init__(
        self,
        arm: ArmGeometry,
        joints: tuple[str, ...],
        acceleration_window: float = 0.0,
        row_layouts: Sequence[JointRowLayout] = (),
        beams: Sequence[MeasuringBeam] = (),
    ) -> None:
        """Allocate all arrays.

        ``joints``: names of its joints; ``acceleration_window``: time over which the accelerations of the beams are
        estimated [s]; zero: they are those in ``accelerations``, at first zero; ``row_layouts``: layouts of the joints'
        rows, for ``estimate_rows``; ``beams``: its measuring beams.
        """
        self.joints = joints
        self._arm = arm._replace(beams=arm.beams.copy())  # ``use_beam`` changes them
        self._history = BeamHistory.allocate(acceleration_window, len(arm.beams))
        self._vibrations_at_rest = _vibrations_at_rest(beams)
        at_rest = self._vibrations_at_rest[None].copy()
        self._measurements = JointMeasurements.allocate(1, len(joints))._replace(vibrations=at_rest)
        self.vibrations = self._measurements.vibrations
        self.static_forces = self._history.static_forces
        self._endpoints = Endpoints.allocate(1, len(joints))
        self._relative = self._endpoints.with_own_poses()
        self._rows = JointRows.allocate(row_layouts)
        self._stamp_ns, *measured = self._measurements[:5]
        self.poses, self.covariances_random, self.covariances_systematic, self.thetas = (array[0] for array in measured)
        self.stamp_shifts = self._measurements.stamp_shifts[0]
        self.accelerations = self._history.accelerations.reshape(-1, 3)
        self.beam_transforms = self._history.transforms
        for row, beam in zip(self.beam_transforms, arm.beams, strict=True):  # without sag; stays of beams off the way
            row[:] = pin.SE3ToXYZQUAT(pin.SE3(beam["rotation"], beam["translation"]))
        self.pose, self.covariance_random, self.covariance_systematic, self.angles, self.faults = (
            array[0] for array in self._endpoints[:5]
        )
        self.stamp_shift = self._endpoints.stamp_shifts[0]
        self.relative_stamp_shift = self._relative.stamp_shifts[0]
        self._bounds = EndpointBounds.allocate(1)
        self.protection_level = self._bounds.levels[0]
        self._axes, self._home_axes = np.eye(3), np.eye(3)
        self._joint_causes = [JointCauses()] * len(joints)
        self.causes, self._arm_causes = ArmCauses.of(self._joint_causes)
        self.relative_pose, self.relative_covariance_random, self.relative_covariance_systematic = (
            array[0] for array in self._relative[:3]
        )
        self._beams = list(beams)
        self._joint_terms: list[tuple[str, ...]] = [()] * len(joints)
        self.shared_terms: tuple[str, ...] = ()
        self._prepare_arguments()
        if any(beam.shared_effects for beam in beams):
            self._set_terms(self._joint_terms)

    @property
    def rows(self) -> ByteArray:
        """See the class."""
        return self._rows.octets

    @property
    def joint_rows(self) -> JointRows:
        """``rows`` as the kernels take them."""
        return self._rows

    def use_rows(self, layouts: Sequence[JointRowLayout]) -> None:
        """Take rows of other layouts, one for each joint, from the next scan on; ``rows`` is then another array."""
        self._rows = JointRows.allocate(layouts)
        self._prepare_arguments()

    def use_terms(self, of_joints: list[tuple[str, ...]]) -> None:
        """Take the names of each joint's shared terms, in the order of its effects, from the next scan on."""
        if of_joints != self._joint_terms:
            self._set_terms(of_joints)

    def _set_terms(self, of_joints: list[tuple[str, ...]]) -> None:
        self._joint_terms = of_joints
        self.shared_terms, self._arm = self._arm.with_terms(self._beams, of_joints)
        most, count = self._arm.joint_terms.shape[1], len(self.shared_terms)
        self._measurements = self._measurements._replace(shared_effects=np.zeros((1, len(of_joints), most, 6)))
        self._endpoints, self._relative = (
            each._replace(shared_effects=np.full((1, count, 6), np.nan)) for each in (self._endpoints, self._relative)
        )
        self._prepare_arguments()

    def use_beam(self, index: int, beam: MeasuringBeam) -> None:
        """Take a beam at another temperature (``MeasuringBeam.at_temperature``) from the next scan on."""
        self._beams[index] = beam
        self._arm.beams[index] = beam_record(beam)
        self.beam_transforms[index] = pin.SE3ToXYZQUAT(beam.T_start_end)
        for k, name in enumerate(self.shared_terms):
            self._arm.beam_effects[k, index] = beam.shared_effects.get(name, 0.0)

    def reset_vibration(self, index: int) -> None:
        """Take a beam as at rest, with the stated spread of its acceleration, from the next scan on."""
        self.vibrations[0, index] = self._vibrations_at_rest[index]

    def use_arm_of(self, other: EndpointEstimator) -> None:
        """Take shared terms, beams at their temperatures and accelerations of another estimator of the same arm."""
        self.use_terms(other._joint_terms)
        self._beams = other._beams
        self.accelerations[:] = other.accelerations
        self._arm.beams[:] = other._arm.beams
        self._arm.beam_effects[:] = other._arm.beam_effects

    @property
    def workspace(self) -> tuple[ArmGeometry, BeamHistory, JointMeasurements, Endpoints]:
        """The arrays of the kernels; other ones after shared terms or causes have changed."""
        return self._arm, self._history, self._measurements, self._endpoints

    def use_causes(self, of_joints: list[JointCauses]) -> None:
        """Take the causes of each joint's faults, in the order of its effects, from the next scan on."""
        if of_joints != self._joint_causes:
            self._joint_causes = of_joints
            self.causes, self._arm_causes = ArmCauses.of(of_joints)
            shape = 1, len(of_joints), self._arm_causes.kinds.shape[1], EFFECT
            self._measurements = self._measurements._replace(fault_effects=np.full(shape, np.nan, dtype=np.float32))
            self._prepare_arguments()

    @property
    def fault_effects(self) -> NDArray[np.float32]:
        """See the class."""
        effects: NDArray[np.float32] = self._measurements.fault_effects[0]
        return effects

    def bound_error(self, *, relative: bool = False) -> tuple[tuple[str, str], ...]:
        """Write the protection level of the endpoint; return joint and cause of its largest part, for each axis.

        ``relative``: in the axes at home, of the last ``estimate_relative_to``. Both names are empty where nothing sets
        the level.
        """
        self._bound_errors[relative]()
        return self.set_by(self._bounds, 0)

    def bound_all(
        self,
        endpoints: Endpoints,
        poses: FloatArray,
        fault_effects: NDArray[np.float32],
        stamp_shifts: FloatArray | None = None,
        home: FloatArray | None = None,
    ) -> EndpointBounds:
        """Return the protection levels of n endpoints of ``estimate_all`` or of ``relative_to``.

        ``poses``: of the joints, (n, j, 7); ``fault_effects``: (n, j, C, EFFECT), as the attribute;
        ``stamp_shifts``: (n, j, 6), likewise; None: zero; ``home``: pose in whose axes the endpoints are, (7,); None:
        in those of the base. Joints and causes of the result index ``joints``
        and ``causes``.
        """
        count, bounds = len(poses), EndpointBounds.allocate(len(poses))
        measurements = JointMeasurements.allocate(count, len(self.joints))._replace(
            poses=np.require(poses, np.float64, ["C", "A", "W"]),
            fault_effects=np.require(fault_effects, np.float32, ["C", "A", "W"]),
        )
        if stamp_shifts is not None:
            measurements = measurements._replace(stamp_shifts=np.require(stamp_shifts, np.float64, ["C", "A", "W"]))
        axes = self._axes if home is None else np.array(rotation_of_pose(home))
        own = Endpoints._make(np.require(array, requirements=["C", "A", "W"]) for array in endpoints)
        bound_endpoints(self._arm, self._arm_causes, measurements, own, axes, bounds)
        return bounds

    def set_by(self, bounds: EndpointBounds, n: int) -> tuple[tuple[str, str], ...]:
        """Return joint and cause that set the level of endpoint n along and about each axis, as ``bound_error``.

        The cause is the name of a fault, or STAMPS.
        """
        found = zip(bounds.joints[n].tolist(), bounds.causes[n].tolist(), strict=True)
        return tuple(("", "") if c == UNKNOWN else (self.joints[j], self.causes[c]) for j, c in found)

    @property
    def shared_effects(self) -> dict[str, FloatArray]:
        """Change of the endpoint by one standard uncertainty of each shared term, by name, (6,), axes of the base."""
        return dict(zip(self.shared_terms, self._endpoints.shared_effects[0].copy(), strict=True))

    def set_measurements(self, measured: Mapping[str, MeasuredJoint]) -> None:
        """Fill ``poses`` and both covariances with measurements by joint name.

        Raises ChainError: the measurement of a joint is missing.
        """
        self.use_terms([tuple(measured[name].shared_effects) if name in measured else () for name in self.joints])
        for number, name in enumerate(self.joints):
            if name not in measured:
                raise ChainError(
                    f"joint '{name}' has no measurement",
                    where="the chain",
                    expected=f"a measurement of each of {', '.join(self.joints)}",
                )
            self.poses[number] = pin.SE3ToXYZQUAT(measured[name].T_parent_child)
            self.covariances_random[number] = measured[name].covariance_random
            self.covariances_systematic[number] = measured[name].covariance_systematic
            for k, effect in enumerate(measured[name].shared_effects.values()):
                self._measurements.shared_effects[0, number, k] = effect

    def estimate(self, stamp_ns: int = 0) -> bool:
        """Estimate the endpoint from ``poses``, both covariances and ``thetas``; return whether there is one.

        ``stamp_ns``: time of the scan, for the accelerations of the beams. If time goes back, their history is emptied.
        """
        self._stamp_ns[0] = stamp_ns
        while self._estimate(0) == 0:
            self._enlarge_history()
        return not math.isnan(self.pose[0])

    def estimate_rows(self, stamp_ns: int) -> int:
        """Estimate the endpoint from ``rows``; return the worst state of the joints, negative without an endpoint."""
        self.rows_kernel.put((stamp_ns,))
        self.rows_kernel.run()
        worst = int(self.rows_kernel.results())
        if worst == HISTORY_FULL:
            self._enlarge_history()
            return self.estimate_rows(stamp_ns)
        return worst

    def estimate_all(
        self,
        poses: FloatArray,
        covariances_random: FloatArray,
        covariances_systematic: FloatArray,
        stamps_ns: IntArray | None = None,
        thetas: FloatArray | None = None,
        shared_effects: FloatArray | None = None,
        stamp_shifts: FloatArray | None = None,
    ) -> Endpoints:
        """Return the endpoints of n scans, bit for bit as ``estimate`` gives them one after the other.

        Of the attributes only ``accelerations`` are used. ``poses``: (n, j, 7), ``covariances_random`` and
        ``covariances_systematic``: (n, j, 6, 6), as the attributes; ``stamps_ns``: times of the scans, (n,); required
        with an acceleration window; ``thetas``: (n, j), as the attribute; None: turns are not counted;
        ``shared_effects``: (n, j, T, 6) for the terms of ``use_terms``, T the largest number of a joint;
        ``stamp_shifts``: (n, j, 6), as the attribute; None: zero. Raises ChainError: an array has the wrong shape, or
        there is an acceleration window but no stamps.
        """
        count, joints = len(poses), len(self.joints)
        if stamps_ns is None:
            if len(self._history.stamps_ns):
                raise ChainError("the endpoints of an arm in motion need stamps", expected=f"{count} stamps")
            stamps_ns = np.zeros(count, dtype=np.int64)
        thetas = np.full((count, joints), np.nan) if thetas is None else thetas
        terms = self._arm.joint_terms.shape[1]
        shared = np.zeros((count, joints, terms, 6)) if shared_effects is None else shared_effects
        stamp_shifts = np.zeros((count, joints, 6)) if stamp_shifts is None else stamp_shifts
        shapes = {
            "stamps_ns": (stamps_ns, (count,)),
            "poses": (poses, (count, joints, 7)),
            "covariances_random": (covariances_random, (count, joints, 6, 6)),
            "covariances_systematic": (covariances_systematic, (count, joints, 6, 6)),
            "thetas": (thetas, (count, joints)),
            "shared_effects": (shared, (count, joints, terms, 6)),
            "stamp_shifts": (stamp_shifts, (count, joints, 6)),
        }
        for name, (array, shape) in shapes.items():
            if array.shape != shape:
                raise ChainError(f"{name} of shape {array.shape}", where="the chain", expected=f"{shape}")
        # The kernel is compiled for exactly these array types; read-only arrays are copied.
        numbers = poses, covariances_random, covariances_systematic, thetas, shared, stamp_shifts
        vibrations = np.tile(self._vibrations_at_rest, (count, 1))
        measurements = JointMeasurements._make(
            (
                np.require(stamps_ns, np.int64, ["C", "A", "W"]),
                *(np.require(array, np.float64, ["C", "A", "W"]) for array in numbers),
                self._measurements.fault_effects,
                vibrations,
            )
        )
        endpoints, done = Endpoints.allocate(count, joints, len(self.shared_terms)), 0
        while (done := estimate_endpoints(self._arm, self._history, measurements, endpoints, done)) < count:
            self._enlarge_history()
        return endpoints

    def estimate_relative_to(self, home: FloatArray) -> None:
        """Write the relative pose and its covariances; ``home``, (7,), is an endpoint taken as exact."""
        self._home_axes[:] = rotation_of_pose(home)
        write_relative(home, self._endpoints, self._relative)

    def covariance(self) -> FloatArray:
        """Return the sum of both covariances of the endpoint, (6, 6)."""
        total: FloatArray = self.covariance_random + self.covariance_systematic
        return total

    def result(self, *, relative: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the arrays of pose, random and systematic covariance, in the base frame or in the axes at home."""
        if relative:
            return self.relative_pose, self.relative_covariance_random, self.relative_covariance_systematic
        return self.pose, self.covariance_random, self.covariance_systematic

    def fault_text(self) -> str:
        """Return why the last scan has no endpoint; empty if it has one."""
        faults = zip(self.joints, self.faults.tolist(), strict=True)
        return "; ".join(f"{name} {FAULT_TEXTS[fault]}" for name, fault in faults if fault)

    def _enlarge_history(self) -> None:
        self._history = self._history.enlarged()
        self._prepare_arguments()

    def _prepare_arguments(self) -> None:
        """Bind the kernels to the arrays, so that a call allocates next to nothing."""
        workspace = self._arm, self._history, self._measurements, self._endpoints
        self._estimate = bind(estimate_endpoints, workspace)
        self.rows_kernel = bind_in_parts(estimate_endpoint_of_rows, (*workspace, self._rows))
        self._bound_errors = tuple(
            bind(bound_endpoints, (self._arm, self._arm_causes, self._measurements, endpoints, axes, self._bounds))
            for endpoints, axes in ((self._endpoints, self._axes), (self._relative, self._home_axes))
        )


def _vibrations_at_rest(beams: Sequence[MeasuringBeam]) -> NDArray[np.void]:
    """Return beams at rest, (b,) of ``VIBRATION``, with the spread of their accelerations; (0,): no beam states it."""
    stated = [beam.entry.vibration for beam in beams]
    if not any(stated):
        return np.zeros(0, dtype=VIBRATION)
    records = np.zeros(len(stated), dtype=VIBRATION)
    records["mean"] = records["difference"] = np.nan
    records["bounded"] = 1
    for name in ("sigma_mean", "sigma_difference"):
        records[name] = [0.0 if entry is None else entry.spread.number for entry in stated]
    return records
