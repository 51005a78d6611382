"""Between messages and the core's own types; nowhere else do fields of posor_msgs meet the numerical core."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
import pinocchio as pin
from geometry_msgs.msg import Pose
from posor_msgs.msg import JointTransform, RawScan

from posor_estimator.core.chain_lane import WHY
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.kernels.chain_pose import fault_of
from posor_estimator.core.kernels.stamps import time_ns
from posor_estimator.core.scan import Scan, by_diode

if TYPE_CHECKING:
    from posor_estimator.core.estimate import Estimate
    from posor_estimator.core.types import FloatArray

CovarianceKind = Literal["random", "systematic", "total"]

COVARIANCE_KINDS: dict[CovarianceKind, int] = {
    "random": JointTransform.COVARIANCE_RANDOM,
    "systematic": JointTransform.COVARIANCE_SYSTEMATIC,
    "total": JointTransform.COVARIANCE_TOTAL,
}


def scan_from_message(message: RawScan) -> Scan:
    """Return the scan as the core sees it."""
    currents = np.array(message.diode_currents, dtype=float)
    return Scan(
        number=message.scan,
        stamp_ns=stamp_ns(message),
        gap_voltages=np.array(message.gap_voltages, dtype=float),
        ring_voltages=np.array(message.ring_voltages, dtype=float),
        diode_currents=by_diode(currents[None])[0],
        lit_sources=tuple(message.lit_sources),
        supply_voltage=message.supply_voltage,
        temperature=message.temperature,
        at_home=bool(message.status & RawScan.STATUS_HOME_BUMP),
    )


def pose_message(pose: pin.SE3) -> Pose:
    """Return a transform as a pose [m, unit quaternion]."""
    message = Pose()
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(pose).tolist()
    message.position.x, message.position.y, message.position.z = x, y, z
    message.orientation.x, message.orientation.y, message.orientation.z, message.orientation.w = qx, qy, qz, qw
    return message


def lost_pose_message() -> Pose:
    """Return the pose of a lost joint: every number NaN."""
    message = Pose()
    nan = float("nan")
    message.position.x = message.position.y = message.position.z = nan
    message.orientation.x = message.orientation.y = message.orientation.z = message.orientation.w = nan
    return message


def pose_from_message(message: Pose) -> pin.SE3:
    """Return a pose message as a transform."""
    p, q = message.position, message.orientation
    return pin.XYZQUATToSE3(np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w]))


def chosen_covariance(estimate: Estimate, kind: CovarianceKind) -> FloatArray:
    """Return the part of the covariance that a node was told to publish, (6, 6)."""
    if kind == "random":
        return estimate.covariance_random
    if kind == "systematic":
        return estimate.covariance_systematic
    return estimate.covariance_random + estimate.covariance_systematic


def transform_message(
    raw: RawScan, estimate: Estimate, parent: str, child: str, kind: CovarianceKind
) -> JointTransform:
    """Return the message that reports an estimate of a raw scan."""
    message = JointTransform()
    message.header.stamp = raw.header.stamp
    message.header.frame_id = parent
    message.child_frame_id = child
    message.scan = raw.scan
    message.pose = lost_pose_message() if estimate.T_R_T is None else pose_message(estimate.T_R_T)
    message.covariance = chosen_covariance(estimate, kind).ravel()
    message.covariance_kind = COVARIANCE_KINDS[kind]
    message.native = estimate.native
    message.residual = estimate.residual
    message.redundancy = estimate.redundancy
    message.state = int(estimate.state)
    message.faults = int(estimate.faults)
    message.scan_status = raw.status
    return message


def why_unusable(message: JointTransform) -> str:
    """Return why the message's pose must not be used, an empty string when it may.

    The numbers are looked at whatever the state says of them: a pose that is none must not go on.
    """
    if message.state not in (State.OK, State.DEGRADED):
        known = {int(state): state.name.lower() for state in State}
        if message.state not in known:
            return f"has the unknown state {message.state}"
        return f"is {known[message.state]} ({Fault(message.faults).name or f'unknown faults {message.faults}'})"
    p, q = message.pose.position, message.pose.orientation
    pose = np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])
    fault = fault_of(pose, np.array(message.covariance, dtype=float).reshape(6, 6))
    return WHY[fault] if fault else ""


def is_usable(message: JointTransform) -> bool:
    """Return whether the message's pose may be used."""
    return not why_unusable(message)


def stamp_ns(message: RawScan | JointTransform) -> int:
    """Return the header's stamp in nanoseconds; 0 where it is no time."""
    stamp = message.header.stamp
    return time_ns(stamp.sec, stamp.nanosec)
