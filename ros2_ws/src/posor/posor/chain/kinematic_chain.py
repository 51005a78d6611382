# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The kinematic chain: POSORs as floating joints, measuring beams between them, the endpoint on the last one.

Pinocchio reads the URDF and finds the elements on the way from the base to the endpoint. A beam of the beams file is a
floating joint of its model too: its transform includes the sag under gravity in the present posture, its systematic
covariance is that of the beams file. ``chain.forward_kinematics`` computes the endpoint.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor.chain.arm_geometry import ArmGeometry
from posor.chain.beam_entries import STANDARD_GRAVITY
from posor.chain.beams_file import load_beams
from posor.chain.endpoint_estimator import EndpointEstimator
from posor.chain.measuring_beam import MeasuringBeam, beam_faults
from posor.chain.robot_model import FreeJoint, RobotModel
from posor.chain.urdf_file import read_urdf
from posor.errors import ChainError, sum_up
from posor.input_text import read_input_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from posor.chain.beams_file import BeamsFile
    from posor.chain.forward_kinematics import Endpoints
    from posor.chain.joint_measurements import JointRowLayout, MeasuredJoint
    from posor.numerics.array_types import FloatArray, IntArray


@dataclass(frozen=True)
class Endpoint:
    """The endpoint in the chain's base frame."""

    T_base_endpoint: pin.SE3  # its pose
    # White from scan to scan, (6, 6) of x, y, z [m], about X, Y, Z [rad], axes of the base frame, the small turn
    # applied on the base's side at the endpoint (ROS order, REP-103)
    covariance_random: FloatArray
    covariance_systematic: FloatArray  # the same, from calibrations and beams, common to all scans
    # Change of the endpoint by one standard uncertainty of each shared term, by name, (6,), likewise
    shared_effects: Mapping[str, FloatArray] = field(default_factory=dict)

    def covariance(self) -> FloatArray:
        """Return the sum of both covariances, (6, 6)."""
        return self.covariance_random + self.covariance_systematic


@dataclass(frozen=True)
class FixedLink:
    """Connection of two POSORs: from the target plate of one (or the base) to the receiving plate of the next."""

    before: pin.SE3  # from that plate to the start of the beam
    beam: MeasuringBeam | None  # the measuring beam; None: not in the beams file, straight and exact
    after: pin.SE3  # from the end of the beam to the next plate, or to the endpoint

    @property
    def T_nominal(self) -> pin.SE3:
        """The link without sag."""
        return self.before * self.after if self.beam is None else self.before * self.beam.T_start_end * self.after


class Chain:
    """A URDF whose floating joints are measured by POSORs.

    Attributes:
        base_frame: The URDF's root link.
        joints: The POSORs.
        path_joints: Those between the base and the endpoint, in this order.
        beams: The measuring beams of the beams file, in its order.
        beam_joints: The joints of the URDF that they are, in the same order.
        fixed_transforms: The fixed joints of the URDF that are no beams of the beams file, and the places of inserted
            plates (``chain.urdf_plates``).
        left_out: Names of the URDF's moving joints that are not on the way to the endpoint, such as those of a gripper,
            and of all joints beyond them.
        urdf: The robot description (XML text).
        gravity: [m/s^2], (3,), in the base frame.
        shared: Shared terms of the beams file, by name.
        plates: Thermometers of the plates of POSORs, of the beams file.

    """

    def __init__(
        self,
        urdf: str,
        endpoint_frame: str,
        beams: BeamsFile | None = None,
        *,
        source: str = "the URDF",
        beams_source: str = "the beams file",
    ) -> None:
        """Build the chain.

        ``endpoint_frame``: link of the endpoint; ``beams``: content of the beams file; None: all beams are straight and
        exact; ``source``: name of the URDF in errors, such as its path; ``beams_source``: name of the beams file in
        errors. Raises ChainError: the URDF is invalid, has no floating joint, a moving joint of another type on the way
        to the endpoint, or not this link; a beam is not a fixed joint of the URDF, or has one of ``beam_faults``.
        """
        entries = [] if beams is None else beams.beams
        content, faults = read_urdf(urdf, endpoint_frame, source)
        fixed = [joint.name for joint in content.joints if joint.kind == "fixed"]
        if not faults:
            expected = f"one of {', '.join(fixed) or 'none, there is no fixed joint'}"
            what = "has no fixed joint '{}', which the beams file names"
            missing = [beam.joint for beam in entries if beam.joint not in fixed]
            faults = [ChainError(what.format(name), where=source, expected=expected) for name in missing]
        if faults:
            raise sum_up(faults)
        self._robot = RobotModel(content, endpoint_frame, [beam.joint for beam in entries], source)
        self.left_out = content.left_out
        self.base_frame = self._robot.base_frame
        self.joints = self._robot.joints
        self.path_joints = tuple(joint for joint in self.joints if joint.index in self._robot.path())
        self.urdf = urdf
        self.beam_joints = self._robot.freed
        self.shared = {} if beams is None else beams.shared
        self.plates = () if beams is None else beams.plates
        self.fixed_transforms = self._robot.fixed_transforms()
        names = [joint.name for joint in self.joints]
        for unknown in (plate.joint for plate in self.plates if plate.joint not in names):
            what = f"'{unknown}' is not a POSOR of the arm"
            faults.append(ChainError(what, where=f"{beams_source}, key plates", expected=f"one of {', '.join(names)}"))
        for entry, joint in zip(entries, self.beam_joints, strict=True):
            faults += beam_faults(entry, joint, beams_source)
        if faults:
            raise sum_up(faults)
        self.beams = tuple(
            MeasuringBeam(beam, joint.T_parent_joint, self.shared)
            for beam, joint in zip(entries, self.beam_joints, strict=True)
        )
        self.gravity: FloatArray = np.array([0.0, 0.0, -STANDARD_GRAVITY]) if beams is None else beams.gravity.array
        self.links = self._links(source)
        self._geometry = ArmGeometry.from_model(self._robot, self.beams, self.gravity)
        self._estimator = self.estimator()

    def _links(self, source: str) -> tuple[FixedLink, ...]:
        beams = {joint.index: (beam, joint) for beam, joint in zip(self.beams, self.beam_joints, strict=True)}
        joints = {joint.index: joint for joint in self.joints}
        links: list[FixedLink] = []
        before, beam, after = pin.SE3.Identity(), None, pin.SE3.Identity()
        for index in self._robot.path():
            if index in beams:
                if beam is not None:
                    raise ChainError(
                        f"beams '{beam.name}' and '{beams[index][0].name}' follow each other without a POSOR between",
                        where=source,
                        expected="at most one beam between two POSORs",
                    )
                beam, joint = beams[index]
                before = joint.T_before_parent
                continue
            after = joints[index].T_before_parent
            links.append(FixedLink(before, beam, after))
            before, beam = pin.SE3.Identity(), None
        links.append(FixedLink(before, beam, self._robot.T_joint_endpoint))
        return tuple(links)

    def nominal_joint(self, name: str, angle: float) -> pin.SE3:
        """Return T_parent_child of a POSOR's plates without error motions at an angle [rad] about Z of its origin.

        ``EndpointEstimator.angles`` are the measured angles.
        """
        return self._joint(name).T_parent_joint * pin.SE3(pin.utils.rotate("z", angle), np.zeros(3))

    def _joint(self, name: str) -> FreeJoint:
        return next(joint for joint in self.joints if joint.name == name)

    def nominal_endpoint(self, angles: Mapping[str, float]) -> pin.SE3:
        """Return the endpoint without bending, sag and error motions, as from encoders alone.

        ``angles``: the angle of each joint [rad].
        """
        pose = self.links[0].T_nominal
        for joint, link in zip(self.path_joints, self.links[1:], strict=True):
            pose = pose * self.nominal_joint(joint.name, angles[joint.name]) * link.T_nominal
        return pose

    def estimate(
        self, measured: Mapping[str, MeasuredJoint], accelerations: Mapping[str, FloatArray] | None = None
    ) -> Endpoint:
        """Return pose and covariances of the endpoint, corrected for the sag of the beams.

        ``measured``: measurement of each floating joint, by joint name. Joints are taken as independent
        but for shared terms;
        ``accelerations``: accelerations of beams [m/s^2], (3,), axes of the base, by name; a beam without is at rest.
        Raises ChainError: the measurement of a joint is missing or invalid.
        """
        estimator, estimator.accelerations[:] = self._estimator, 0.0
        for beam, row in zip(self.beams, estimator.accelerations, strict=True):
            row[:] = (accelerations or {}).get(beam.name, 0.0)
        estimator.set_measurements(measured)
        if not estimator.estimate():
            raise ChainError(estimator.fault_text(), where="the chain", expected="numbers that can be used")
        covariances = estimator.covariance_random.copy(), estimator.covariance_systematic.copy()
        return Endpoint(pin.XYZQUATToSE3(estimator.pose), *covariances, estimator.shared_effects)

    def estimate_all(
        self,
        poses: FloatArray,
        covariances_random: FloatArray,
        covariances_systematic: FloatArray,
        stamps_ns: IntArray | None = None,
        *,
        acceleration_window: float = 0.0,
    ) -> Endpoints:
        """Return the endpoints of consecutive scans, see ``EndpointEstimator.estimate_all``."""
        estimator = self.estimator(acceleration_window)
        return estimator.estimate_all(poses, covariances_random, covariances_systematic, stamps_ns)

    def estimator(
        self, acceleration_window: float = 0.0, row_layouts: Sequence[JointRowLayout] = ()
    ) -> EndpointEstimator:
        """Return a new estimator of this arm, for scans at servo rate or recorded scans.

        ``acceleration_window``: time over which the accelerations of the beams are estimated [s], see
        ``chain.beam_acceleration``; zero: the beams are at rest; ``row_layouts``: layouts of the joints' serialised
        measurements, for ``EndpointEstimator.estimate_rows``.
        """
        names = tuple(joint.name for joint in self.joints)
        return EndpointEstimator(self._geometry, names, acceleration_window, row_layouts, self.beams)


def load_chain(urdf: Path, endpoint_frame: str, beams: Path | None = None) -> Chain:
    """Return the chain of a URDF file and a beams file.

    Raises ChainError: the URDF is invalid, or the beams do not match it; CalibrationError: the beams file is invalid.
    """
    try:
        text = read_input_text(urdf)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise ChainError(f"cannot be read: {reason}", where=f"URDF {urdf}", expected="a robot description") from error
    return Chain(
        text,
        endpoint_frame,
        None if beams is None else load_beams(beams),
        source=f"URDF {urdf}",
        beams_source=str(beams),
    )
