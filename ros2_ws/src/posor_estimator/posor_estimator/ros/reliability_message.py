"""The message on the reliability of a joint, from its last scan."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_msgs.msg import JointReliability

from posor_estimator.model.fault import Fault, State
from posor_estimator.numerics.stamps import NS
from posor_estimator.uncertainty.reading_sensitivity import last_sensitivity
from posor_estimator.uncertainty.reliability import reliability

if TYPE_CHECKING:
    from posor_estimator.estimation.posor import Posor
    from posor_estimator.ros.raw_scan_stream import EstimatedScan


def reliability_message(posor: Posor, last: EstimatedScan) -> JointReliability | None:
    """Return the reliability of a POSOR at its last estimate; None: that has no usable pose, or not from it alone."""
    usable = last.estimate["state"] in {State.OK, State.DEGRADED}
    if last.refusal or not usable or last.estimate["faults"] & Fault.ILL_CONDITIONED:
        return None
    found = reliability(posor, last_sensitivity(posor))
    frames = posor.calibration.frames
    message = JointReliability(child_frame_id=frames.child)
    message.header.frame_id = frames.parent
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(last.stamp_ns, NS)
    message.false_alarm, message.missed_detection = found.false_alarm, found.missed_detection
    message.readings = list(found.names)
    message.detectable_biases = found.biases.tolist()
    message.undetected_shifts = found.shifts.ravel().tolist()
    return message
