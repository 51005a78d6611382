"""Times of single steps without a graph: the estimator, the chain, and messages between bytes and numbers.

``python -m posor_validation.benchmark.microbenchmarks`` prints the times of the chain and of messages.
"""

from __future__ import annotations

import sys
from statistics import fmean
from time import process_time
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor_bringup.arms import load_checked_arm
from posor_estimator.bags.bag_reader import counted_messages, opened_bag
from posor_estimator.bags.cdr_schema import STAMP
from posor_estimator.calibration.designs import design
from posor_estimator.chain.joint_measurements import MeasuredJoint
from posor_estimator.chain.time_synchroniser import TimeSynchroniser, synchronise_stamps
from posor_estimator.estimation.estimate import Estimate
from posor_estimator.estimation.forward import scans_at
from posor_estimator.estimation.posor import Posor
from posor_estimator.model.fault import Fault
from posor_estimator.model.scan import Scans
from posor_estimator.numerics.stamps import NS
from posor_estimator.ros.cdr_scan import RAW_SCAN, ScanTemplate
from posor_estimator.ros.cdr_transform import JOINT_TRANSFORM, JointTransformFormat, stamp_ns_of
from posor_estimator.ros.message_conversion import pose_from_message, scan_from_message, transform_message
from posor_estimator.ros.raw_scan_stream import RawScanStream
from posor_estimator.ros_names import RAW_TOPIC
from posor_msgs.msg import JointTransform, RawScan
from rclpy.serialization import deserialize_message, serialize_message
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from posor_estimator.chain.arm_file import Arm
    from posor_estimator.model.scan import Scan

ROUNDS = 15
CALLS = 2000
PERIOD_NS = 500_000
WINDOW_S = 0.05
"""Time over which the accelerations of beams are estimated."""


def least_us(calls: int, work: Callable[[], object], rounds: int = ROUNDS) -> float:
    """Return the least processor time [us] per call of work that makes so many calls."""
    seconds = []
    for _ in range(rounds):
        begin = process_time()
        work()
        seconds.append(process_time() - begin)
    return 1e6 * min(seconds) / calls


def estimator_figures(arm: Arm, bag: Path) -> dict[str, float]:
    """Return ``kernel_us`` (all scans in one call) and ``scan_us`` (scan by scan) [us], means over the joints."""
    many, single = [], []
    for joint in arm.calibrations:
        posor, scans = Posor(arm.calibration(joint)), _read_scans(bag, f"/{arm.name}/{joint}/{RAW_TOPIC}")
        arrays = Scans.of(scans)

        def estimate_all(posor: Posor = posor, arrays: Scans = arrays) -> None:
            posor.reset()
            posor.estimate_all(arrays)

        def estimate_each(posor: Posor = posor, scans: list[Scan] = scans) -> None:
            posor.reset()
            for scan in scans:
                posor.estimate(scan)

        many.append(least_us(len(scans), estimate_all, rounds=5))
        single.append(least_us(len(scans), estimate_each, rounds=5))
    return {"kernel_us": fmean(many), "scan_us": fmean(single)}


def _read_scans(bag: Path, topic: str) -> list[Scan]:
    with opened_bag(bag) as reader:
        records = counted_messages(reader, (topic,), str(bag))
        return [scan_from_message(deserialize_message(data, RawScan)) for _, _, data in records]


def chain_times_us(arm: Arm) -> dict[str, float]:
    """Return the times [us] of the chain with sag and covariances, for one scan at a time and for many in one call."""
    chain, random = arm.chain(), np.random.default_rng(1)
    names = tuple(joint.name for joint in chain.joints)
    stamps_ns = np.arange(1, CALLS + 1) * PERIOD_NS
    angles = 0.5 * np.sin(stamps_ns[:, None] * 1e-9 + np.arange(len(names)))
    transforms = [[chain.nominal_joint(*each) for each in zip(names, row, strict=True)] for row in angles.tolist()]
    poses = np.array([[pin.SE3ToXYZQUAT(transform) for transform in row] for row in transforms])
    roots = random.normal(size=(CALLS, len(names), 6, 6)) * 1e-6
    covariances = roots @ np.swapaxes(roots, 2, 3)
    measured = {name: MeasuredJoint(transforms[0][n], covariances[0, n]) for n, name in enumerate(names)}
    at_rest, moving, refusing = chain.estimator(), chain.estimator(WINDOW_S), chain.estimator()
    for estimator in (at_rest, moving):
        estimator.poses[:], estimator.covariances[:] = poses[0], covariances[0]
        estimator.estimate_all(poses, covariances, stamps_ns)
    refusing.poses[:] = np.nan  # refused before the kinematics begin
    ticks = stamps_ns.tolist()

    def synchronise() -> None:
        synchroniser: TimeSynchroniser[int] = TimeSynchroniser(names)
        for tick in ticks:
            for name in names:
                synchroniser.add(name, tick, tick, 0.0)

    def estimate_relative() -> None:
        for _ in ticks:
            at_rest.estimate_relative_to(at_rest.pose)

    incomplete = [np.delete(stamps_ns, slice(n, None, 97)) for n in range(len(names))]
    accelerations = f"accelerations over {WINDOW_S} s at {NS // PERIOD_NS} Hz"
    work: dict[str, Callable[[], object]] = {
        "one endpoint": lambda: [at_rest.estimate(tick) for tick in ticks],
        "the same call with refused measurements": lambda: [refusing.estimate(tick) for tick in ticks],
        f"one endpoint, {accelerations}": lambda: [moving.estimate(tick) for tick in ticks],
        "one endpoint of many": lambda: at_rest.estimate_all(poses, covariances, stamps_ns),
        f"one endpoint of many, {accelerations}": lambda: moving.estimate_all(poses, covariances, stamps_ns),
        "endpoint relative to home": estimate_relative,
        "one endpoint from transforms by joint name": lambda: [chain.estimate(measured) for _ in ticks],
        "synchronise all joints of a stamp, one by one": synchronise,
        "synchronise all joints of a stamp, all stamps at once": lambda: synchronise_stamps(incomplete),
    }
    return {title: least_us(CALLS, function) for title, function in work.items()}


def message_times_us() -> dict[str, tuple[float, float]]:
    """Return the times [us] of the messages of a scan by field offsets, as in the nodes, and by rclpy's messages."""
    posor, other = (Posor(design("triad_diodes")) for _ in range(2))
    scan = _example_scan(posor)
    raw = RAW_SCAN.serialize(scan)
    template = ScanTemplate(raw)
    estimate = Estimate.lost(7, Fault.NONE, "")
    frames = posor.calibration.frames.parent, posor.calibration.frames.child
    stream = RawScanStream(posor, raw, "total")
    # At 2 kHz: with a constant stamp the estimator would start anew at every scan.
    raws, raws_again = ((template.at(NS + PERIOD_NS * n, n) for n in range(ROUNDS * CALLS)) for _ in range(2))
    transform = JOINT_TRANSFORM.serialize(transform_message(scan, estimate, *frames, "total"))
    kind = JointTransformFormat(*frames)
    row = np.zeros(kind.size, dtype=np.uint8).data

    def stamp_by_rclpy() -> None:
        scan.header.stamp.sec, scan.scan = 1, 2
        serialize_message(scan)

    def estimate_by_rclpy() -> None:
        estimate = other.estimate(scan_from_message(deserialize_message(next(raws_again), RawScan)))
        serialize_message(transform_message(scan, estimate, *frames, "total"))

    def read_by_offsets() -> None:
        if kind.matches(transform) and stamp_ns_of(transform[STAMP]):
            row[:] = transform

    def read_by_rclpy() -> None:
        message = deserialize_message(transform, JointTransform)
        pose_from_message(message.pose)
        np.array(message.covariance, dtype=float).reshape(6, 6)

    steps: dict[str, tuple[Callable[[], object], Callable[[], object]]] = {
        "driver: stamp and number of a prepared scan": (lambda: template.at(NS, 2), stamp_by_rclpy),
        "posor_node: from a scan to its transform": (lambda: stream.estimate_message(next(raws)), estimate_by_rclpy),
        "chain_node: read a transform": (read_by_offsets, read_by_rclpy),
    }

    def repeat(step: Callable[[], object]) -> None:
        for _ in range(CALLS):
            step()

    return {
        title: (least_us(CALLS, lambda: repeat(offsets)), least_us(CALLS, lambda: repeat(rclpy)))  # noqa: B023
        for title, (offsets, rclpy) in steps.items()
    }


def _example_scan(posor: Posor) -> RawScan:
    """Return a scan of a POSOR with gap probes and diodes in the middle of its range."""
    scans = scans_at(posor.stack, np.eye(3)[None], np.array([[0.0, 0.0, 0.7e-3]]), np.array([1], dtype=np.int64))
    example = scans[0]
    scan = RawScan(scan=7, samples=1, lit_sources=list(example.lit_sources))
    scan.header.frame_id, scan.header.stamp.nanosec = posor.calibration.frames.parent, 1
    scan.gap_voltages, scan.diode_currents = example.gap_voltages, example.diode_currents.ravel()
    scan.supply_voltage, scan.temperature = example.supply_voltage, example.temperature
    return scan


def main() -> int:
    """Print the times."""
    chain = Table("step", "us", title="Chain of the six-axis arm", title_justify="left")
    for step, time_us in chain_times_us(load_checked_arm("six_axis")).items():
        chain.add_row(step, f"{time_us:.2f}")
    messages = Table("step", "by offsets [us]", "by rclpy [us]", title="Messages", title_justify="left")
    for step, times_us in message_times_us().items():
        messages.add_row(step, *(f"{time_us:.2f}" for time_us in times_us))
    console = Console(width=118)
    console.print(chain)
    console.print(messages)
    return 0


if __name__ == "__main__":
    sys.exit(main())
