"""Microseconds for a message between bytes and numbers: ``tools/in_workspace.py tests/benchmarks/bench_messages.py``.

By layout, as the nodes do it, and by rclpy's message objects, to and from the same numbers. All times are of the
processor, so that a busy machine counts little; the least of some rounds.
"""

from __future__ import annotations

import sys
from time import process_time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor_estimator.core.designs import design
from posor_estimator.core.estimate import Estimate
from posor_estimator.core.fault import Fault
from posor_estimator.core.forward import scans_at
from posor_estimator.core.kernels.stamps import NS
from posor_estimator.core.posor import Posor
from posor_estimator.ros.byte_lane import ByteLane
from posor_estimator.ros.cdr import STAMP
from posor_estimator.ros.cdr_scan import RAW_SCAN, ScanTemplate
from posor_estimator.ros.cdr_transform import JOINT_TRANSFORM, TransformKind, stamp_ns_of
from posor_estimator.ros.messages import pose_from_message, scan_from_message, transform_message
from posor_msgs.msg import JointTransform, RawScan
from rclpy.serialization import deserialize_message, serialize_message
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from collections.abc import Callable

    import pinocchio as pin
    from posor_estimator.core.types import FloatArray

ROUNDS = 15
CALLS = 2000


class Way(NamedTuple):
    """What a node does with a message, both ways."""

    what: str
    by_layout: Callable[[], object]
    by_rclpy: Callable[[], object]


def a_scan(posor: Posor) -> RawScan:
    """Return a scan of a POSOR with three gap probes and two diodes, as it reads in its middle."""
    made = scans_at(posor.stack, np.eye(3)[None], np.array([[0.0, 0.0, 0.7e-3]]), np.array([1], dtype=np.int64))[0]
    scan = RawScan(scan=7, samples=1, lit_sources=list(made.lit_sources))
    scan.header.frame_id, scan.header.stamp.nanosec = posor.calibration.frames.parent, 1
    scan.gap_voltages, scan.diode_currents = made.gap_voltages, made.diode_currents.ravel()
    scan.supply_voltage, scan.temperature = made.supply_voltage, made.temperature
    return scan


def raws(template: ScanTemplate) -> list[bytes]:
    """Return the same scan at 2 kHz, as often as it is wanted: with a stamp that stands every scan would begin anew."""
    return [template.at(NS + 500_000 * n, n) for n in range(ROUNDS * CALLS)]


def ways() -> list[Way]:
    """Return what is compared."""
    posor = Posor(design("triad_diodes"))
    scan = a_scan(posor)
    raw = RAW_SCAN.serialize(scan)
    template = ScanTemplate(raw)
    estimate = Estimate.lost(7, Fault.NONE, "")
    frames = posor.calibration.frames.parent, posor.calibration.frames.child
    lane, other = ByteLane(posor, raw, "total"), Posor(posor.calibration)
    one_by_one, again = (iter(raws(template)) for _ in range(2))
    transform = JOINT_TRANSFORM.serialize(transform_message(scan, estimate, *frames, "total"))
    kind = TransformKind(*frames)
    row = np.zeros(kind.size, dtype=np.uint8).data

    def stamped() -> bytes:
        scan.header.stamp.sec, scan.scan = 1, 2
        return bytes(serialize_message(scan))

    def answered() -> bytes:
        estimate = other.locate(scan_from_message(deserialize_message(next(again), RawScan)))
        return bytes(serialize_message(transform_message(scan, estimate, *frames, "total")))

    def read(data: bytes) -> None:
        if kind.takes(data) and stamp_ns_of(data[STAMP]):
            row[:] = data

    return [
        Way("driver: a prepared scan, its stamp and number set", lambda: template.at(NS, 2), stamped),
        Way(
            "posor_node: from a scan to its transform",
            lambda: lane.answer(next(one_by_one)),
            answered,
        ),
        Way(
            "chain_node: read a transform",
            lambda: read(transform),
            lambda: _read(deserialize_message(transform, JointTransform)),
        ),
    ]


def _read(message: JointTransform) -> tuple[pin.SE3, FloatArray]:
    return pose_from_message(message.pose), np.array(message.covariance, dtype=float).reshape(6, 6)


def least_us(work: Callable[[], object]) -> float:
    """Return the least time [us] of the processor for one call."""
    seconds = []
    for _ in range(ROUNDS):
        begin = process_time()
        for _ in range(CALLS):
            work()
        seconds.append(process_time() - begin)
    return 1e6 * min(seconds) / CALLS


def main() -> int:
    """Print the figures."""
    table = Table(title="A message between bytes and numbers", title_justify="left")
    for heading in ("what", "by layout [us]", "by rclpy [us]"):
        table.add_column(heading, justify="left" if heading == "what" else "right")
    for way in ways():
        table.add_row(way.what, f"{least_us(way.by_layout):.2f}", f"{least_us(way.by_rclpy):.2f}")
    Console(width=118).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
