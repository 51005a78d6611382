"""The arm's endpoint: what a chain_node would have published for the transforms of all joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.chain_records import read_records
from posor_estimator.core.fault import State
from posor_estimator.errors import ChainError
from posor_estimator.reprocess.joined import BlockJoiner
from posor_estimator.ros.cdr_transform import columns_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_estimator.bulk.layout import TableLayout
    from posor_estimator.chain_node import ChainParameters
    from posor_estimator.core.chain import Chain
    from posor_estimator.core.chain_lane import Endpoints as Found
    from posor_estimator.core.types import BoolArray, FloatArray, IntArray
    from posor_estimator.reprocess.transforms import Transforms


@dataclass(frozen=True)
class Endpoints:
    """Poses of the endpoint at n stamps.

    Attributes:
        times_ns: When the last of the transforms was logged, shape (n,).
        stamps_ns: Middle of the exposure, shape (n,).
        poses: x, y, z [m] and the unit quaternion x, y, z, w, in the base frame, or relative to home, shape (n, 7).
        covariances: ROS order, see ``core.chain.Endpoint``, shape (n, 6, 6).
        angles: Of each joint about its nominal axis [rad], shape (n, joints).

    """

    times_ns: IntArray
    stamps_ns: IntArray
    poses: FloatArray
    covariances: FloatArray
    angles: FloatArray

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.stamps_ns)


class EndpointReprocessor:
    """Finds the endpoint for the transforms of all joints, block after block.

    Attributes:
        joints: Names of the joints, in the chain's order.
        frame: In which the endpoint's pose is given.
        joiner: What joins the transforms, with its counts.
        poses: How many poses there have been.
        degraded: How many of these rest on a joint whose state is DEGRADED.
        unusable: Complete stamps that gave no pose, and transforms whose stamp is no time.
        refused: The same, by the joint whose transform may not be used.

    """

    def __init__(self, chain: Chain, parameters: ChainParameters, layouts: Mapping[str, TableLayout]) -> None:
        """Begin afresh.

        Args:
            chain: The chain.
            parameters: Of chain_node, as far as they concern the numbers.
            layouts: Of the transforms of each joint.

        Raises:
            ChainError: A joint of the chain has no transforms, or they are between other frames.

        """
        self.joints = tuple(joint.name for joint in chain.joints)
        for joint in chain.joints:
            if joint.name not in layouts:
                raise ChainError(
                    f"joint {joint.name} has no calibration",
                    where=f"URDF {parameters.urdf}",
                    expected=f"one for each of {', '.join(self.joints)}",
                )
            strings = layouts[joint.name].strings
            frames = strings["header.frame_id"], strings["child_frame_id"]
            if frames != (joint.parent, joint.child):
                raise ChainError(
                    f"the calibration of {joint.name} is from '{frames[0]}' to '{frames[1]}'",
                    where=f"URDF {parameters.urdf}",
                    expected=f"'{joint.parent}' to '{joint.child}'",
                )
        self._lane = chain.lane(parameters.acceleration_window)
        at_home = parameters.reference == "home"
        self._relative = at_home
        self._home: FloatArray | None = None
        self.frame = f"{parameters.endpoint_frame}_home" if at_home else chain.base_frame
        self.joiner = BlockJoiner(self.joints)
        self.poses = self.degraded = self.unusable = 0
        self.refused = dict.fromkeys(self.joints, 0)

    def endpoints(self, block: Mapping[str, Transforms]) -> Endpoints:
        """Return the endpoint at all stamps that become complete with a block of transforms.

        Args:
            block: Of each joint.

        """
        complete = self.joiner.join([self._stamped(name, block[name]) for name in self.joints])
        states = np.array([each.table["state"] for each in complete])
        known = (states == int(State.OK)) | (states == int(State.DEGRADED))
        usable = known.all(axis=0)
        if not usable.all():
            complete = [each.chosen(usable) for each in complete]
        found = self._found(complete)
        known[:, usable] &= found.faults.T == 0
        self._count(states, known)
        return self._published(complete, found)

    def _stamped(self, joint: str, transforms: Transforms) -> Transforms:
        """Return those that have a stamp; to the joiner the others would be time that has gone back."""
        stamped = transforms.stamps_ns != 0
        if stamped.all():
            return transforms
        without = int(np.count_nonzero(~stamped))
        self.refused[joint] += without
        self.unusable += without
        return transforms.chosen(stamped)

    def _count(self, states: IntArray, known: BoolArray) -> None:
        """Count complete stamps, by the joints' states and by whether their numbers may be used, (joints, n)."""
        for name, count in zip(self.joints, np.count_nonzero(~known, axis=1).tolist(), strict=True):
            self.refused[name] += count
        sound = known.all(axis=0)
        self.poses += int(np.count_nonzero(sound))
        self.unusable += int(np.count_nonzero(~sound))
        self.degraded += int(np.count_nonzero(np.any(states[:, sound] == int(State.DEGRADED), axis=0)))

    def _found(self, complete: Sequence[Transforms]) -> Found:
        """Return what the chain finds of transforms."""
        stamps = complete[0].stamps_ns
        count, joints = len(stamps), len(self.joints)
        poses, covariances, thetas = (
            np.empty((count, joints, 7)),
            np.empty((count, joints, 6, 6)),
            np.empty((count, joints)),
        )
        for j, each in enumerate(complete):
            read_records(each.table.rows, columns_of(each.table.layout), j, poses, covariances, thetas)
        return self._lane.endpoints(poses, covariances, stamps, thetas)

    def _published(self, complete: Sequence[Transforms], found: Found) -> Endpoints:
        """Return the endpoints that are some, relative to home if that is wanted."""
        sound = found.sound
        times, stamps = np.max([each.times_ns for each in complete], axis=0), complete[0].stamps_ns
        poses, covariances, angles = found.poses, found.covariances, found.angles
        if self._relative and sound.any():
            if self._home is None:
                self._home = poses[int(np.argmax(sound))].copy()
            poses, covariances = found.relative_to(self._home)
        if sound.all():
            return Endpoints(times, stamps, poses, covariances, angles)
        return Endpoints(times[sound], stamps[sound], poses[sound], covariances[sound], angles[sound])
