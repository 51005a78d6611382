"""The arm's endpoint: what a chain_node would have published for the transforms of all joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.fault import State
from posor_estimator.core.kernels.chain import relative_to
from posor_estimator.errors import ChainError
from posor_estimator.reprocess.joined import BlockJoiner
from posor_estimator.ros.messages import UNIT_WITHIN

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_estimator.bulk.layout import Table, TableLayout
    from posor_estimator.chain_node import ChainParameters
    from posor_estimator.core.chain import Chain
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
        refused: Complete stamps without a pose, by the joint whose transform may not be used.

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
        complete = self.joiner.join([block[name] for name in self.joints])
        usable = np.ones(len(complete[0]), dtype=np.bool_)
        for name, each in zip(self.joints, complete, strict=True):
            fit = _usable(each.table)
            self.refused[name] += int(np.count_nonzero(~fit))
            usable &= fit
        self.unusable += int(np.count_nonzero(~usable))
        if not usable.all():
            complete = [each.chosen(usable) for each in complete]
        self.poses += len(complete[0])
        states = np.array([each.table["state"] for each in complete])
        self.degraded += int(np.count_nonzero(np.any(states == int(State.DEGRADED), axis=0)))
        return self._found(complete)

    def _found(self, complete: Sequence[Transforms]) -> Endpoints:
        """Return the endpoints of usable transforms."""
        stamps = complete[0].stamps_ns
        count, joints = len(stamps), len(self.joints)
        poses, covariances, thetas = (
            np.empty((count, joints, 7)),
            np.empty((count, joints, 36)),
            np.empty((count, joints)),
        )
        for j, each in enumerate(complete):
            poses[:, j] = each.table.span("pose.position.x", 7)
            covariances[:, j] = each.table["covariance"]
            thetas[:, j] = each.table["native"][:, 5]
        found = self._lane.endpoints(poses, covariances.reshape(count, joints, 6, 6), stamps, thetas)
        of_endpoint = found.poses, found.covariances
        if self._relative and count:
            if self._home is None:
                self._home = found.poses[0].copy()
            of_endpoint = np.empty_like(found.poses), np.empty_like(found.covariances)
            relative_to(self._home, found.poses, found.covariances, *of_endpoint)
        times = np.max([each.times_ns for each in complete], axis=0)
        return Endpoints(times, stamps, *of_endpoint, found.angles)


def _usable(transforms: Table) -> BoolArray:
    """Return which transforms carry a pose that may be used, as ``ros.messages.why_unusable`` says of one."""
    state = transforms["state"]
    known = (state == int(State.OK)) | (state == int(State.DEGRADED))
    poses = transforms.span("pose.position.x", 7)
    with np.errstate(invalid="ignore"):
        unit = np.abs(np.linalg.norm(poses[:, 3:], axis=1) - 1.0) <= UNIT_WITHIN
    finite = np.isfinite(poses).all(axis=1) & np.isfinite(transforms["covariance"]).all(axis=1)
    return np.asarray(known & unit & finite)
