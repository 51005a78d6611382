# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Conversion between ROS messages and the types of the numerical packages."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import Pose
from posor.estimation.estimate import ESTIMATE, estimate_of
from posor.messages.raw_scan import RecordedScans
from posor.model.fault import USABLE_STATES
from posor.model.scan import Scan, Scans, split_by_diode
from posor.numerics.stamps import time_ns
from posor_msgs.msg import EndpointState, JointTransform, RawScan

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pinocchio as pin
    from numpy.typing import NDArray
    from posor.estimation.estimate import Estimate
    from posor.estimation.fault_model import JointCauses
    from posor.estimation.posor import Posor
    from sensor_msgs.msg import JointState


def message_content(message: Any) -> dict[str, Any]:
    """Return the fields of a message, numbers by their bits; serialised messages differ in the bytes between fields."""
    fields = {name: getattr(message, name) for name in message.get_fields_and_field_types()}
    arrays = {name: np.asarray(value) for name, value in fields.items()}
    return {name: arrays[name].tobytes() if arrays[name].dtype.kind in "biuf" else fields[name] for name in fields}


def scan_from_message(message: RawScan) -> Scan:
    """Return a raw scan as a scan of the numerical packages."""
    currents = np.array(message.diode_currents, dtype=float)
    return Scan(
        number=message.scan,
        stamp_ns=stamp_ns(message),
        gap_voltages=np.array(message.gap_voltages, dtype=float),
        ring_voltages=np.array(message.ring_voltages, dtype=float),
        diode_currents=split_by_diode(currents),
        lit_sources=tuple(message.lit_sources),
        exposure_offsets=np.array(message.exposure_offsets, dtype=float),
        exposure_span=message.exposure_span,
        stamp_uncertainty=message.stamp_uncertainty,
        stamp_limit=message.stamp_limit,
        supply_voltage=message.supply_voltage,
        temperature=message.temperature,
        reference_voltage=message.reference_voltage,
        at_home=bool(message.status & RawScan.STATUS_HOME_BUMP),
        status=message.status,
    )


def recorded_scans(messages: Sequence[RawScan]) -> RecordedScans:
    """Return raw scans as they are read from a bag; all have the same readings."""
    scans = Scans.of([scan_from_message(message) for message in messages])
    stamps = [(message.header.stamp.sec, message.header.stamp.nanosec) for message in messages]
    return RecordedScans(
        log_times_ns=scans.stamps_ns,
        order=np.arange(len(messages)),
        scans=scans,
        header_stamps=np.array(stamps, dtype=np.int64),
        statuses=np.array([message.status for message in messages], dtype=np.int64),
        frame=messages[0].header.frame_id,
    )


def pose_message(pose: pin.SE3 | None) -> Pose:
    """Return a transform as a pose [m, unit quaternion]; NaN in every number for None, the pose of a lost joint."""
    import pinocchio as pin  # noqa: PLC0415  50 MB that a node does not need

    message = Pose()
    p, q = message.position, message.orientation
    numbers = [math.nan] * 7 if pose is None else pin.SE3ToXYZQUAT(pose).tolist()
    p.x, p.y, p.z, q.x, q.y, q.z, q.w = numbers
    return message


def pose_from_message(message: Pose) -> pin.SE3:
    """Return a pose message as a transform."""
    import pinocchio as pin  # noqa: PLC0415  50 MB that a node does not need

    p, q = message.position, message.orientation
    return pin.XYZQUATToSE3(np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w]))


def estimate_with_effects(posor: Posor, scan: Scan) -> tuple[Estimate, NDArray[np.float32]]:
    """Return the estimate of the next scan of a POSOR, and its fault effects."""
    effects, records = posor.allocate_effects(1), np.zeros(1, dtype=ESTIMATE)
    posor.estimate_records(Scans.of([scan])._records.copy(), records, effects)
    return estimate_of(records, 0, posor.reason(scan, records[0])), effects[0]


def transform_message(
    raw: RawScan,
    estimate: Estimate,
    parent: str,
    child: str,
    faults: tuple[JointCauses, NDArray[np.float32]] | None = None,
    calibration: int = 0,
) -> JointTransform:
    """Return the joint transform of an estimate and its raw scan.

    ``faults``: causes and their effects; ``calibration``: its id, 0: not stated.
    """
    message = JointTransform()
    message.header.stamp = raw.header.stamp
    message.header.frame_id = parent
    message.child_frame_id = child
    message.scan = raw.scan
    message.pose = pose_message(estimate.T_R_T)
    message.covariance_random = estimate.covariance_random.ravel()
    message.covariance_systematic = estimate.covariance_systematic.ravel()
    message.stamp_shift = estimate.stamp_shift
    message.native = estimate.native
    message.residual = estimate.residual
    message.redundancy = estimate.redundancy
    message.state = int(estimate.state)
    message.faults = int(estimate.faults)
    message.scan_status = raw.status
    if faults is not None:
        causes, effects = faults
        message.causes, message.effect_causes, message.effect_kinds = (list(each) for each in causes)
        message.effects = effects.ravel()
    message.calibration = calibration
    return message


def is_usable(message: JointTransform | EndpointState) -> bool:
    """Return whether the state of a transform or endpoint says that its pose may be used."""
    return message.state in USABLE_STATES


def stamp_ns(message: RawScan | JointTransform | JointState) -> int:
    """Return the header's stamp in nanoseconds; 0 if the stamp is invalid."""
    stamp = message.header.stamp
    return time_ns(stamp.sec, stamp.nanosec)
