"""Microseconds that the estimator takes for a scan, without any graph: the compiled part alone, and scan by scan."""

from __future__ import annotations

from statistics import fmean, median
from time import perf_counter
from typing import TYPE_CHECKING

from posor_estimator.core.posor import Posor
from posor_estimator.core.scan import Scans
from posor_estimator.ros.bag_reader import counted_messages, opened_bag
from posor_estimator.ros.messages import scan_from_message
from posor_estimator.ros.qos import RAW_TOPIC
from posor_msgs.msg import RawScan
from rclpy.serialization import deserialize_message

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from posor_estimator.core.arm import Arm
    from posor_estimator.core.scan import Scan

ROUNDS = 5


def kernel_figures(arm: Arm, bag: Path) -> dict[str, float]:
    """Return ``kernel_us`` (many scans in one call) and ``scan_us`` (one call for each), means over an arm's joints."""
    together, alone = [], []
    for joint in arm.calibrations:
        posor, singles = Posor(arm.calibration(joint)), _scans(bag, f"/{arm.name}/{joint}/{RAW_TOPIC}")
        scans = Scans.of(singles)
        together.append(_timed(posor, lambda posor=posor, scans=scans: posor.locate_all(scans)))  # type: ignore[misc]
        alone.append(_timed(posor, lambda posor=posor, singles=singles: [posor.locate(one) for one in singles]))  # type: ignore[misc]
    return {"kernel_us": 1e6 * fmean(together) / len(singles), "scan_us": 1e6 * fmean(alone) / len(singles)}


def _scans(bag: Path, topic: str) -> list[Scan]:
    with opened_bag(bag) as reader:
        records = counted_messages(reader, (topic,), str(bag))
        return [scan_from_message(deserialize_message(data, RawScan)) for _, _, data in records]


def _timed(posor: Posor, work: Callable[[], object]) -> float:
    """Return the median time [s] of the work, each time from a fresh start."""
    seconds = []
    for _ in range(ROUNDS):
        posor.reset()
        begin = perf_counter()
        work()
        seconds.append(perf_counter() - begin)
    return median(seconds)
