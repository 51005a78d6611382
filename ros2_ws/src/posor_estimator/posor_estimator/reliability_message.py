"""The message on the reliability of a joint, from its last scan."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor.model.fault import USABLE_STATES, Fault
from posor.numerics.stamps import NS
from posor.uncertainty.reliability import reliability

if TYPE_CHECKING:
    from posor.estimation.posor import Posor
    from posor.messages.message_stream import EstimatedScan
    from posor.uncertainty.reading_sensitivity import EstimateMatrices


def has_reliability(last: EstimatedScan) -> bool:
    """Return whether an estimate has a usable pose, and from the readings alone."""
    usable = last.estimate["state"] in USABLE_STATES
    return not last.refusal and usable and not last.estimate["faults"] & Fault.ILL_CONDITIONED


def reliability_fields(posor: Posor, matrices: EstimateMatrices, stamp_ns: int) -> dict[str, Any]:
    """Return the fields of a ``JointReliability`` by their paths, at the estimate of the matrices."""
    found = reliability(posor, matrices.sensitivity())
    frames = posor.calibration.frames
    sec, nanosec = divmod(stamp_ns, NS)
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
