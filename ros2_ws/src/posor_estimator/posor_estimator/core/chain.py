"""The kinematic chain: POSORs as floating joints, measuring beams between them, the endpoint on the last one.

Pinocchio reads the URDF and says what lies on the way from the base to the endpoint. A beam that is not exact is a
floating joint of its model too: its transform has the sag under gravity as the arm now stands, its covariance is what
the beams file says of it. The walk along the arm is compiled (``core.kernels.chain``) and checked against pinocchio's
forward kinematics and Jacobian.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor_estimator.core.beams_file import STANDARD_GRAVITY, load_beams
from posor_estimator.core.chain_lane import ChainLane, Endpoints
from posor_estimator.core.chain_layout import ChainLayout
from posor_estimator.core.measuring_beam import MeasuringBeam
from posor_estimator.core.robot_model import FreeJoint, RobotModel
from posor_estimator.errors import ChainError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from posor_estimator.core.beams_file import BeamsFile
    from posor_estimator.core.types import FloatArray, IntArray


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
        self._layout = ChainLayout.of(self._robot, self.beams, gravity)
        self._lane = self.lane()

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
        """Return T_parent_child of a POSOR without error motions: its origin, turned by an angle [rad] about its Z.

        A ``ChainLane`` tells the angle of a measured one.
        """
        return self._joint(name).T_parent_joint * pin.SE3(pin.utils.rotate("z", angle), np.zeros(3))

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

        Raises:
            ChainError: A joint is missing, or its numbers are none.

        """
        lane, lane.accelerations[:] = self._lane, 0.0
        for beam, row in zip(self.beams, lane.accelerations, strict=True):
            row[:] = (accelerations or {}).get(beam.name, 0.0)
        lane.take(measured)
        if not lane.run():
            raise ChainError(lane.reason(), where="the chain", expected="finite numbers and unit quaternions")
        return Endpoint(pin.XYZQUATToSE3(lane.pose), lane.covariance.copy())

    def lane(self, acceleration_window: float = 0.0) -> ChainLane:
        """Return a lane of this arm, for endpoints at servo rate or of many scans.

        Args:
            acceleration_window: Time over which the beams' accelerations are found [s], see ``BeamMotion``; zero: the
                beams are as if at rest.

        """
        return ChainLane(self._layout, tuple(joint.name for joint in self.joints), acceleration_window)

    def endpoints(
        self,
        poses: FloatArray,
        covariances: FloatArray,
        stamps_ns: IntArray | None = None,
        *,
        acceleration_window: float = 0.0,
    ) -> Endpoints:
        """Return the endpoints of many scans that follow one another, see ``ChainLane.endpoints``."""
        return self.lane(acceleration_window).endpoints(poses, covariances, stamps_ns)


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
