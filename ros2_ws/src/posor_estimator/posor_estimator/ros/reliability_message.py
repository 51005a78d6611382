"""The message on the reliability of a joint, from its last scan."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor_estimator.model.fault import USABLE_STATES, Fault
from posor_estimator.numerics.stamps import NS
from posor_estimator.uncertainty.reading_sensitivity import last_sensitivity
from posor_estimator.uncertainty.reliability import reliability

if TYPE_CHECKING:
    from posor_estimator.estimation.posor import Posor
    from posor_estimator.ros.raw_scan_stream import EstimatedScan


def reliability_fields(posor: Posor, last: EstimatedScan) -> dict[str, Any] | None:
    """Return the fields of a ``JointReliability`` at the last estimate of a POSOR.

    Returns:
        The fields by their paths; None: the estimate has no usable pose, or not from the readings alone.

    """
    usable = last.estimate["state"] in USABLE_STATES
    if last.refusal or not usable or last.estimate["faults"] & Fault.ILL_CONDITIONED:
        return None
    found = reliability(posor, last_sensitivity(posor))
    frames = posor.calibration.frames
    sec, nanosec = divmod(last.stamp_ns, NS)
    return {
        "header.stamp.sec": sec,
        "header.stamp.nanosec": nanosec,
        "header.frame_id": frames.parent,
        "child_frame_id": frames.child,
        "false_alarm": found.false_alarm,
        "missed_detection": found.missed_detection,
        "readings": found.names,
        "detectable_biases": found.biases,
        "undetected_shifts": found.shifts.ravel(),
    }
