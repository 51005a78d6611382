"""Processor time of the estimator without a graph."""

from __future__ import annotations

from statistics import fmean
from time import process_time
from typing import TYPE_CHECKING

from posor.bags.bag_reader import counted_messages, opened_bag
from posor.estimation.posor import Posor
from posor.model.scan import Scans
from posor.ros_names import RAW_TOPIC
from posor_msgs.msg import RawScan
from posor_ros.message_conversion import scan_from_message
from rclpy.serialization import deserialize_message

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from posor.chain.arm_file import Arm
    from posor.model.scan import Scan

ROUNDS = 5


def least_us(calls: int, work: Callable[[], object]) -> float:
    """Return the least processor time [us] per call of work that makes so many calls."""
    seconds = []
    for _ in range(ROUNDS):
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

        many.append(least_us(len(scans), estimate_all))
        single.append(least_us(len(scans), estimate_each))
    return {"kernel_us": fmean(many), "scan_us": fmean(single)}


def _read_scans(bag: Path, topic: str) -> list[Scan]:
    with opened_bag(bag) as reader:
        records = counted_messages(reader, (topic,), str(bag))
        return [scan_from_message(deserialize_message(data, RawScan)) for _, _, data in records]
