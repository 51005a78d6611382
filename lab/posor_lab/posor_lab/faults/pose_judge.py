# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which poses are wrong: further from the truth than their stated covariance allows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import PoseWithCovariance
from posor.numerics.stamps import NS, tick_stamp_ns
from posor.ros_names import ENDPOINT_COVARIANCE_TOPIC, ENDPOINT_STATE_TOPIC, TRANSFORM_TOPIC
from posor_drivers.simulator.pose_array import PoseArray, poses_between
from posor_msgs.msg import EndpointState, JointTransform

from posor_lab.harness.message_conversion import is_usable, stamp_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.estimation.estimate import Estimates
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray
    from posor_drivers.simulator.arm_simulation import ArmSimulation

    from posor_lab.reports.arrival_receiver import Arrival, ArrivalReceiver

SIGMAS = 5.0  # standard deviations beyond which a pose is wrong
SMALL_TURN = 0.1  # turn [rad] beyond which a pose is wrong whatever its covariance

STALE_S = 1.2
"""Age beyond which a pose published as valid is wrong, whatever its numbers [s]: ``freshness.max_age`` and a margin."""


def wrong_poses(found: PoseArray, covariances: FloatArray, true: PoseArray) -> BoolArray:
    """Return which poses are wrong, (n,); ``covariances`` in ROS order, (n, 6, 6).

    A pose is wrong if a component x, y, z or a small turn about X, Y, Z of the parent frame is more than ``SIGMAS``
    stated standard deviations from the truth, or if a number is not finite or a variance negative.
    """
    errors = small_errors(found, true)
    with np.errstate(invalid="ignore"):
        spreads = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
        return np.asarray(~np.all(np.abs(errors) <= SIGMAS * spreads, axis=1))


def small_errors(found: PoseArray, true: PoseArray) -> FloatArray:
    """Return errors of poses in ROS order, (n, 6), axes of the parent frame; infinite turns beyond ``SMALL_TURN``."""
    turns = np.einsum("nij,nkj->nik", found.rotations, true.rotations)
    about = 0.5 * np.stack(
        [turns[:, 2, 1] - turns[:, 1, 2], turns[:, 0, 2] - turns[:, 2, 0], turns[:, 1, 0] - turns[:, 0, 1]], axis=1
    )
    cosines = 0.5 * (np.trace(turns, axis1=1, axis2=2) - 1.0)
    about[~(cosines > np.cos(SMALL_TURN))] = np.inf
    return np.column_stack([found.translations - true.translations, about])


def estimated_poses(estimates: Estimates) -> tuple[PoseArray, FloatArray]:
    """Return the poses of estimates, (n), and their total covariances, (n, 6, 6)."""
    covariances = estimates.covariances()
    return PoseArray(estimates.rotations, estimates.translations), covariances


def true_poses(simulation: ArmSimulation, times_ns: IntArray, joint: str = "") -> PoseArray:
    """Return the true poses of a joint, or without ``joint`` of the endpoint, at times [ns], (n,)."""
    rate = simulation.scenario.ticks_per_second
    ticks = np.rint(times_ns * (rate / NS)).astype(np.int64)
    around = [simulation.truth(ticks + n) for n in (-1, 0, 1)]
    poses = [each.T_parent_child[joint] if joint else each.endpoint for each in around]
    shares: FloatArray = np.asarray((times_ns - tick_stamp_ns(ticks, rate)) * (rate / NS), dtype=np.float64)
    return poses_between(poses[1], poses, shares[:, None]) if np.any(shares) else poses[1]


class PoseJudge:
    """Compares published poses with the truth of a simulation at their stamps."""

    def __init__(self, simulation: ArmSimulation, *, by_level: bool = False) -> None:
        """Compare with the truth of ``simulation``.

        ``by_level``: an endpoint is wrong only beyond the protection level of its own message, and a transform beyond
        its ``stamp_shift`` in addition.
        """
        self._simulation, self._by_level = simulation, by_level

    def count_wrong(self, receiver: ArrivalReceiver, begin_ns: int, end_ns: int, joint: str = "") -> int:
        """Return how many poses that came as valid between two times [ns] are wrong or stale.

        The transforms of ``joint`` count beside the endpoint; empty: no joint.
        """
        arrivals = receiver.between(ENDPOINT_COVARIANCE_TOPIC, begin_ns, end_ns)
        states = _valid(receiver.between(ENDPOINT_STATE_TOPIC, begin_ns, end_ns))
        if self._by_level:  # only the state holds the level of a pose
            judged = {stamp_ns(each.message) for each, _ in states}
            arrivals = [each for each in arrivals if stamp_ns(each.message) not in judged]
        count = self._count_wrong([(each, each.message.pose) for each in arrivals]) + self._count_wrong(states)
        if joint:
            transforms = receiver.between(f"{joint}/{TRANSFORM_TOPIC}", begin_ns, end_ns)
            count += self._count_wrong(_valid(transforms), joint)
        return count

    def covered_share(self, receiver: ArrivalReceiver, begin_ns: int, end_ns: int) -> float:
        """Return which share of the wrong endpoints that came as valid is within the protection level; 1 without any.

        An unknown level (NaN), as in the second after a recovery, covers no pose.
        """
        parts = _valid(receiver.between(ENDPOINT_STATE_TOPIC, begin_ns, end_ns))
        if not parts:
            return 1.0
        found, true, wrong = self._compare(parts)
        levels = np.array([each.message.protection_level for each, _ in parts])
        covered = np.all(np.abs(small_errors(found, true)) <= levels, axis=1)
        return float(np.mean(covered[wrong])) if wrong.any() else 1.0

    def _compare(self, parts: Sequence[tuple[Arrival, Any]], joint: str = "") -> tuple[PoseArray, PoseArray, BoolArray]:
        """Return found and true poses of the endpoint or a joint, and which are wrong."""
        found = pose_array([each.pose for _, each in parts])
        covariances = np.reshape([_covariance(each) for _, each in parts], (-1, 6, 6))
        true = self._truth([each for each, _ in parts], joint)
        return found, true, wrong_poses(found, covariances, true)

    def _truth(self, arrivals: Sequence[Arrival], joint: str) -> PoseArray:
        """Return the true poses of the endpoint or a joint at the stamps of messages."""
        return true_poses(self._simulation, np.array([stamp_ns(each.message) for each in arrivals]), joint)

    def _count_wrong(self, parts: Sequence[tuple[Arrival, Any]], joint: str = "") -> int:
        if not parts:
            return 0
        ages_ns = np.array([each.time_ns - stamp_ns(each.message) for each, _ in parts])
        found, true, wrong = self._compare(parts, joint)
        if self._by_level:
            wrong &= ~np.all(np.abs(small_errors(found, true)) <= [_bound(each) for _, each in parts], axis=1)
        return int(np.count_nonzero(wrong | (ages_ns > STALE_S * NS)))


def _bound(stated: Any) -> FloatArray:
    """Return the stated bound of a pose: protection level of an endpoint's state, else 5 sigma and ``stamp_shift``."""
    if isinstance(stated, EndpointState):
        return np.asarray(stated.protection_level)
    shift = stated.stamp_shift if isinstance(stated, JointTransform) else np.zeros(6)
    return np.asarray(SIGMAS * np.sqrt(np.reshape(_covariance(stated), (6, 6)).diagonal()) + shift)


def _covariance(stated: Any) -> FloatArray:
    """Return the covariance of a PoseWithCovariance, or the sum of both parts of a transform or an endpoint's state."""
    if isinstance(stated, PoseWithCovariance):
        return np.asarray(stated.covariance)
    return np.asarray(stated.covariance_random + stated.covariance_systematic)


def _valid(arrivals: Sequence[Arrival]) -> list[tuple[Arrival, Any]]:
    """Return the messages published as valid, which hold a pose and its covariance themselves."""
    return [(each, each.message) for each in arrivals if is_usable(each.message)]


def pose_array(poses: Sequence[Any]) -> PoseArray:
    """Return geometry_msgs/Pose messages as arrays; a pose that is not finite stays so."""
    translations = np.array([(each.position.x, each.position.y, each.position.z) for each in poses])
    quaternions = [(each.orientation.x, each.orientation.y, each.orientation.z, each.orientation.w) for each in poses]
    vectors, scalars = np.hsplit(np.array(quaternions), [3])
    # Not normalised: an orientation that is not a unit quaternion is judged as a reader of the message would use it.
    crossed = np.cross(vectors[:, None], np.eye(3)).swapaxes(1, 2)
    squares = np.sum(vectors**2, axis=1)[:, None, None]
    outer = vectors[:, :, None] * vectors[:, None]
    return PoseArray(np.eye(3) * (1.0 - 2.0 * squares) + 2.0 * (outer + scalars[:, None] * crossed), translations)
