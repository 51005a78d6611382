"""The chain at servo rate and at disk speed: one scan at a time, or many, by the same compiled walk along the arm.

A lane holds the arm as the kernels want it and room for one scan; to run it allocates next to nothing. Many scans go
through the same loop and so give the same numbers to the last bit; both go on from the motion seen before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from posor_estimator.core.beam_motion import BeamMotion
from posor_estimator.core.kernels import chain as kernel
from posor_estimator.core.kernels.chain_pose import COVARIANCE_NOT_FINITE, NOT_FINITE, NOT_UNIT
from posor_estimator.errors import ChainError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.chain import MeasuredJoint
    from posor_estimator.core.chain_layout import ChainLayout
    from posor_estimator.core.types import BoolArray, FloatArray, IntArray

WHY = {
    NOT_FINITE: "has a pose that is not finite",
    NOT_UNIT: "has an orientation that is no unit quaternion",
    COVARIANCE_NOT_FINITE: "has a covariance that is not finite",
}
"""What is wrong with a joint's numbers, by its fault."""


@dataclass(frozen=True)
class Endpoints:
    """Endpoints of n scans of an arm of j joints. A scan with a joint whose numbers are none has NaN, and its faults.

    Attributes:
        poses: Of the endpoint in the chain's base frame, (n, 7): x, y, z [m], unit quaternion x, y, z, w.
        covariances: Of the same, (n, 6, 6), as ``Endpoint.covariance``.
        angles: Of the joints about their nominal axes [rad], (n, j).
        faults: Of the joints, (n, j): zero, or a key of ``WHY``.

    """

    poses: FloatArray
    covariances: FloatArray
    angles: FloatArray
    faults: IntArray

    @classmethod
    def room(cls, scans: int, joints: int) -> Endpoints:
        """Return room for so many scans; what stands there means nothing."""
        return cls(
            np.empty((scans, 7)),
            np.empty((scans, 6, 6)),
            np.empty((scans, joints)),
            np.empty((scans, joints), dtype=np.int64),
        )

    @property
    def sound(self) -> BoolArray:
        """Which scans have an endpoint, (n,)."""
        sound: BoolArray = np.all(self.faults == 0, axis=1)
        return sound

    def relative_to(self, home: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return poses (n, 7) and covariances (n, 6, 6) in the axes of the endpoint at home, (7,), which is exact."""
        found = np.empty_like(self.poses), np.empty_like(self.covariances)
        kernel.relative_to(home, self.poses, self.covariances, *found)
        return found


class ChainLane:
    """Finds endpoints scan after scan; ``Chain.lane`` makes one.

    The caller fills ``poses``, ``covariances`` and ``thetas`` in place, calls ``run``, and reads the rest. All arrays
    stay the same objects from scan to scan; where there is no endpoint every number of it is NaN.

    Attributes:
        joints: Names of the joints, in the order of all arrays of joints.
        poses: Of the joints, receiving plate to target plate, (j, 7): x, y, z [m], unit quaternion x, y, z, w.
        covariances: Of the same, (j, 6, 6), as ``MeasuredJoint.covariance``; the upper triangle is what counts.
        thetas: The joints' large rotations, counted [rad], (j,), for ``angles``; NaN: not counted.
        accelerations: Of the beams [m/s^2], (b, 3), axes of the base; ``run`` writes them where there is a window, and
            takes them as they are where there is none.
        pose: Of the endpoint in the base frame, (7,), as ``poses``.
        covariance: Of the same, (6, 6), as ``Endpoint.covariance``.
        angles: Of the joints about their nominal axes [rad], (j,).
        faults: Of the joints, (j,): zero, or a key of ``WHY``.
        relative_pose: Of the endpoint in its axes at home, (7,), written by ``find_relative_to``.
        relative_covariance: Of the same, (6, 6).
        stamp_ns: Time of the scan [ns], (1,); ``run`` writes it.
        arguments: What ``kernels.chain.endpoints`` is called with for the scan.

    """

    def __init__(self, layout: ChainLayout, joints: tuple[str, ...], window_s: float) -> None:
        """Make a lane; ``window_s`` [s]: time over which the beams' accelerations are found, zero: as if at rest."""
        self.joints = joints
        self._layout = layout
        self._motion = BeamMotion(window_s, len(layout.beams))
        self.stamp_ns: IntArray = np.zeros(1, dtype=np.int64)
        room = np.zeros((1, len(joints), 7)), np.zeros((1, len(joints), 6, 6)), np.full((1, len(joints)), np.nan)
        self.poses, self.covariances, self.thetas = room[0][0], room[1][0], room[2][0]
        self.poses[:, 6] = 1.0
        self._accelerations, self._centres = np.zeros(3 * len(layout.beams)), np.empty(3 * len(layout.beams))
        self.accelerations: FloatArray = self._accelerations.reshape(-1, 3)
        found = Endpoints.room(1, len(joints))
        self.pose, self.covariance = found.poses[0], found.covariances[0]
        self.angles, self.faults = found.angles[0], found.faults[0]
        for numbers in (self.pose, self.covariance, self.angles):
            numbers[:] = np.nan
        self.faults[:] = 0
        self._relative = np.full((1, 7), np.nan), np.full((1, 6, 6), np.nan)
        self.relative_pose, self.relative_covariance = self._relative[0][0], self._relative[1][0]
        self._found = found
        self._one = self.stamp_ns, *room, found
        self.arguments = self._arguments(0, *self._one)

    def take(self, measured: Mapping[str, MeasuredJoint]) -> None:
        """Fill ``poses`` and ``covariances`` with measurements by joint name.

        Raises:
            ChainError: There is none of a joint.

        """
        for number, name in enumerate(self.joints):
            if name not in measured:
                raise ChainError(
                    f"joint '{name}' has no measurement",
                    where="the chain",
                    expected=f"one of each of {', '.join(self.joints)}",
                )
            self.poses[number] = pin.SE3ToXYZQUAT(measured[name].T_parent_child)
            self.covariances[number] = measured[name].covariance

    def run(self, stamp_ns: int = 0) -> bool:
        """Find the endpoint of what stands in ``poses``; return whether there is one.

        Args:
            stamp_ns: Time of the scan, for the beams' accelerations. One that goes back begins their motion anew.

        """
        self.stamp_ns[0] = stamp_ns
        while kernel.endpoints(*self.arguments) == 0:
            self.make_room()
        return not math.isnan(self.pose[0])

    def endpoints(
        self,
        poses: FloatArray,
        covariances: FloatArray,
        stamps_ns: IntArray | None = None,
        thetas: FloatArray | None = None,
    ) -> Endpoints:
        """Return the endpoints of many scans: as if each were put into the lane and run, to the last bit.

        Of the lane's own arrays only ``accelerations`` take part.

        Args:
            poses: (n, j, 7), as the attribute.
            covariances: (n, j, 6, 6), as the attribute.
            stamps_ns: Times of the scans, (n,); may be left out where there is no window.
            thetas: (n, j), as the attribute; without them no turn is counted.

        Raises:
            ChainError: An array has the wrong shape, or there is a window and no stamps.

        """
        count, joints = len(poses), len(self.joints)
        if stamps_ns is None:
            if self._motion.looks:
                raise ChainError("the endpoints of an arm in motion need stamps", expected=f"{count} of them")
            stamps_ns = np.zeros(count, dtype=np.int64)
        thetas = np.full((count, joints), np.nan) if thetas is None else thetas
        for name, array, shape in (
            ("poses", poses, (count, joints, 7)),
            ("covariances", covariances, (count, joints, 6, 6)),
            ("stamps_ns", stamps_ns, (count,)),
            ("thetas", thetas, (count, joints)),
        ):
            if array.shape != shape:
                raise ChainError(f"{name} of shape {array.shape}", where="the chain", expected=f"{shape}")
        found = Endpoints.room(count, joints)
        # Arrays of another make, such as read-only ones, would have the kernel compiled anew.
        stamps_ns = np.require(stamps_ns, np.int64, ["C", "A", "W"])
        poses, covariances, thetas = (
            np.require(array, np.float64, ["C", "A", "W"]) for array in (poses, covariances, thetas)
        )
        done = 0
        while (done := kernel.endpoints(*self._arguments(done, stamps_ns, poses, covariances, thetas, found))) < count:
            self.make_room()
        return found

    def find_relative_to(self, home: FloatArray) -> None:
        """Write ``relative_pose`` and ``relative_covariance``; ``home``, (7,), is an endpoint and counts as exact."""
        kernel.relative_to(home, self._found.poses, self._found.covariances, *self._relative)

    def reason(self) -> str:
        """Return why the last scan has no endpoint, empty where it has one."""
        return "; ".join(
            f"{name} {WHY[fault]}" for name, fault in zip(self.joints, self.faults.tolist(), strict=True) if fault
        )

    def make_room(self) -> None:
        """Make room for more scans of the window, as the kernels ask for it."""
        self._motion.make_room()
        self.arguments = self._arguments(0, *self._one)

    def _arguments(
        self,
        begin: int,
        stamps_ns: IntArray,
        poses: FloatArray,
        covariances: FloatArray,
        thetas: FloatArray,
        found: Endpoints,
    ) -> tuple[Any, ...]:
        """Return what the kernel takes."""
        return (
            *self._layout,
            self._motion.kept,
            self._motion.seen_ns,
            self._motion.seen,
            self._accelerations,
            self._centres,
            begin,
            stamps_ns,
            poses,
            covariances,
            thetas,
            found.poses,
            found.covariances,
            found.angles,
            found.faults,
        )
