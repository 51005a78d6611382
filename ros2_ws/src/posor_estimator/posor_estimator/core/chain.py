"""The kinematic chain: POSORs as floating joints, measuring beams between them, the endpoint on the last one.

Pinocchio does the forward kinematics and gives the Jacobian that carries the covariance of each joint and of each beam
to the endpoint. A beam that is not exact is a floating joint too: its six numbers are its sag under gravity as the arm
now stands, its covariance what the beams file says of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor_estimator.core.beams_file import STANDARD_GRAVITY, load_beams
from posor_estimator.core.measuring_beam import MeasuringBeam
from posor_estimator.core.native import native_from_rotation
from posor_estimator.core.robot_model import FreeJoint, RobotModel
from posor_estimator.errors import ChainError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from posor_estimator.core.beams_file import BeamsFile
    from posor_estimator.core.types import FloatArray


@dataclass(frozen=True)
class MeasuredJoint:
    """One POSOR's measurement.

    Attributes:
        T_parent_child: Pose of the target plate in the receiving plate.
        covariance: (6, 6) of x, y, z [m], about X, Y, Z [rad], axes of the parent (as ``posor_msgs/JointTransform``).

    """

    T_parent_child: pin.SE3
    covariance: FloatArray


@dataclass(frozen=True)
class Endpoint:
    """The endpoint in the chain's base frame.

    Attributes:
        T_base_endpoint: Its pose.
        covariance: (6, 6) of x, y, z [m], about X, Y, Z [rad], axes of the base frame, the small turn applied on the
            base's side at the endpoint (ROS order, REP-103).

    """

    T_base_endpoint: pin.SE3
    covariance: FloatArray

    def relative_to(self, home: Endpoint) -> Endpoint:
        """Return this endpoint in the axes of the endpoint at home; home counts as exact."""
        back = home.T_base_endpoint.inverse()
        turn = np.kron(np.eye(2), back.rotation)
        return Endpoint(back * self.T_base_endpoint, turn @ self.covariance @ turn.T)


@dataclass(frozen=True)
class FixedLink:
    """What lies between two POSORs: from the target plate of one (or the base) to the receiving plate of the next.

    Attributes:
        before: From that plate to the start of the beam.
        beam: The measuring beam; None where the beams file names none: straight and exact.
        after: From the end of the beam to the next plate, or to the endpoint.

    """

    before: pin.SE3
    beam: MeasuringBeam | None
    after: pin.SE3

    @property
    def T_nominal(self) -> pin.SE3:
        """The whole link when nothing sags."""
        return self.before * self.after if self.beam is None else self.before * self.beam.T_start_end * self.after


class Chain:
    """A URDF whose floating joints are measured by POSORs.

    Attributes:
        base_frame: The URDF's root link.
        joints: The POSORs.
        beams: The measuring beams of the beams file, in its order.
        gravity: [m/s^2], (3,), in the base frame.

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

        Args:
            urdf: The robot description (XML text).
            endpoint_frame: Link whose pose is wanted.
            beams: What is known of the measuring beams; None: they are straight and exact.
            source: What to call the URDF in complaints, such as its file name.
            beams_source: What to call the beams file in complaints.

        Raises:
            ChainError: The URDF cannot be read, has no floating joint, a moving joint of another type, or no such link;
                a beam is no fixed joint of it, or its gimbals or plates are not on it.

        """
        said = [] if beams is None else beams.beams
        self._robot = RobotModel(urdf, endpoint_frame, (beam.joint for beam in said), source)
        self._data = self._robot.model.createData()
        self.base_frame = self._robot.base_frame
        self.joints = self._robot.joints
        freed = self._robot.freed
        self.beams = tuple(
            MeasuringBeam(beam, joint.T_parent_joint, beams_source) for beam, joint in zip(said, freed, strict=True)
        )
        self._beam_joints = tuple(zip(self.beams, freed, strict=True))
        gravity = np.array([0.0, 0.0, -STANDARD_GRAVITY]) if beams is None else beams.gravity.array
        self.gravity: FloatArray = gravity
        self.links = self._links(source)

    def _links(self, source: str) -> tuple[FixedLink, ...]:
        beams = {joint.index: (beam, joint) for beam, joint in self._beam_joints}
        joints = {joint.index: joint for joint in self.joints}
        links: list[FixedLink] = []
        before, beam, after = pin.SE3.Identity(), None, pin.SE3.Identity()
        for index in self._robot.path():
            if index in beams:
                if beam is not None:
                    raise ChainError(
                        f"beams '{beam.name}' and '{beams[index][0].name}' follow one another without a POSOR between",
                        where=source,
                        expected="one beam at most from POSOR to POSOR",
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
        """Return T_parent_child of a POSOR without error motions: its origin, turned by an angle [rad] about its Z."""
        return self._joint(name).T_parent_joint * pin.SE3(pin.utils.rotate("z", angle), np.zeros(3))

    def joint_angle(self, name: str, T_parent_child: pin.SE3, theta: float) -> float:
        """Return how far a POSOR's joint is turned about its nominal axis, the Z axis of its origin [rad].

        Zero where the target plate stands as the URDF's origin has it; the opposite of ``nominal_joint``.

        Args:
            name: Of the joint.
            T_parent_child: Its measured transform.
            theta: The large rotation of the same (``core.native``), which may have been counted over turns [rad].

        """
        rotation = T_parent_child.rotation
        seen = native_from_rotation(self._joint(name).T_parent_joint.rotation.T @ rotation)[2]
        return theta + math.remainder(seen - native_from_rotation(rotation)[2], 2.0 * math.pi)

    def _joint(self, name: str) -> FreeJoint:
        return next(joint for joint in self.joints if joint.name == name)

    def nominal_endpoint(self, angles: Mapping[str, float]) -> pin.SE3:
        """Return where the endpoint would be if nothing bent, sagged or ran out: what encoders alone can tell.

        Args:
            angles: The angle of each joint [rad].

        """
        pose = self.links[0].T_nominal
        names = [joint.name for joint in self.joints if joint.index in self._robot.path()]
        for name, link in zip(names, self.links[1:], strict=True):
            pose = pose * self.nominal_joint(name, angles[name]) * link.T_nominal
        return pose

    def endpoint(
        self, measured: Mapping[str, MeasuredJoint], accelerations: Mapping[str, FloatArray] | None = None
    ) -> Endpoint:
        """Return the endpoint's pose and covariance, the beams' sag corrected.

        Args:
            measured: One measurement for each floating joint, by joint name. Joints are taken as independent.
            accelerations: Acceleration of beams [m/s^2], (3,), axes of the base, by name; without: they are at rest.

        """
        model = self._robot.model
        q = pin.neutral(model)
        covariance = np.zeros((model.nv, model.nv))
        for joint in self.joints:
            reading = measured[joint.name]
            motion = joint.T_parent_joint.inverse() * reading.T_parent_child
            self._set(q, covariance, joint, motion, reading.covariance, reading.T_parent_child)
        if self._beam_joints:
            pin.forwardKinematics(model, self._data, q)
            for beam, joint in self._beam_joints:
                force = self._start_rotation(joint).T @ (self.gravity - (accelerations or {}).get(beam.name, 0.0))
                under = beam.T_under(force)
                motion = joint.T_parent_joint.inverse() * under
                self._set(q, covariance, joint, motion, beam.covariance_under(force), under)
        jacobian = pin.computeFrameJacobian(
            model, self._data, q, self._robot.endpoint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        pose = pin.updateFramePlacement(model, self._data, self._robot.endpoint)
        return Endpoint(pin.SE3(pose), jacobian @ covariance @ jacobian.T)

    def beam_centres(self) -> dict[str, FloatArray]:
        """Return the middle of each beam in the base frame [m], (3,), as ``endpoint`` last found it."""
        return {
            beam.name: self._data.oMi[self._robot.model.parents[joint.index]].act(
                joint.T_before_parent.act(0.5 * beam.T_start_end.translation)
            )
            for beam, joint in self._beam_joints
        }

    def _start_rotation(self, joint: FreeJoint) -> FloatArray:
        """Return the axes of a beam's start in the base frame."""
        before = self._data.oMi[self._robot.model.parents[joint.index]]
        return np.asarray(before.rotation @ joint.T_before_parent.rotation)

    def _set(
        self,
        q: FloatArray,
        covariance: FloatArray,
        joint: FreeJoint,
        motion: pin.SE3,
        in_parent: FloatArray,
        T_parent_child: pin.SE3,
    ) -> None:
        """Write one joint's numbers and its covariance, given in the axes of its parent, into those of the model."""
        model = self._robot.model.joints[joint.index]
        q[model.idx_q : model.idx_q + 7] = pin.SE3ToXYZQUAT(motion)
        to_local = np.kron(np.eye(2), T_parent_child.rotation.T)
        block = slice(model.idx_v, model.idx_v + 6)
        covariance[block, block] = to_local @ in_parent @ to_local.T


def load_chain(urdf: Path, endpoint_frame: str, beams: Path | None = None) -> Chain:
    """Return the chain of a URDF file and a beams file.

    Raises:
        ChainError: The URDF cannot be read or used, or the beams do not fit it.
        CalibrationError: The beams file cannot be read, or says something that cannot be.

    """
    try:
        text = urdf.read_text(encoding="utf-8")
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
