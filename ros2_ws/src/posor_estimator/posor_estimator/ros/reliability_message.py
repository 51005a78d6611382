"""The message on the reliability of a joint, from its last scan."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_msgs.msg import JointReliability

from posor_estimator.model.fault import State
from posor_estimator.numerics.stamps import NS
from posor_estimator.ros.cdr_scan import scan_of
from posor_estimator.uncertainty.reliability import joint_reliability

if TYPE_CHECKING:
    from posor_estimator.estimation.posor import Posor
    from posor_estimator.ros.raw_scan_stream import EstimatedScan


def reliability_message(posor: Posor, last: EstimatedScan) -> JointReliability | None:
    """Return the reliability of a POSOR at the pose of a scan; None: the scan has no usable pose.

    Raises:
        FitError: The readings do not determine all six freedoms at this pose.

    """
    import pinocchio as pin  # noqa: PLC0415  50 MB that a node does not need before its first scan

    estimate = last.estimate
    if last.refusal or estimate["state"] not in {State.OK, State.DEGRADED}:
        return None
    scan = scan_of(last.data)
    found = joint_reliability(posor, scan, pin.SE3(estimate["rotation"], estimate["translation"]))
    frames = posor.calibration.frames
    message = JointReliability(child_frame_id=frames.child)
    message.header.frame_id = frames.parent
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(last.stamp_ns, NS)
    message.false_alarm, message.missed_detection = found.false_alarm, found.missed_detection
    message.readings = list(found.names)
    message.detectable_biases = found.biases.tolist()
    message.undetected_shifts = found.shifts.ravel().tolist()
    return message
