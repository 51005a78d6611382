"""Processor time of the estimator without a graph."""

from __future__ import annotations

from functools import partial
from statistics import fmean
from time import process_time
from typing import TYPE_CHECKING, Any

from posor.bags.bag_reader import counted_messages, opened_bag
from posor.estimation.posor import Posor
from posor.model.scan import Scans
from posor.ros_names import RAW_TOPIC
from posor_msgs.msg import RawScan
from posor_ros.message_conversion import scan_from_message
from rclpy.serialization import deserialize_message

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from posor.chain.arm_file import ArmFile

ROUNDS = 5


def least_us(calls: int, work: Callable[[], object]) -> float:
    """Return the least processor time of ``work`` in several rounds, per call of the estimator [us]."""
    seconds = []
    for _ in range(ROUNDS):
        begin = process_time()
        work()
        seconds.append(process_time() - begin)
    return 1e6 * min(seconds) / calls


def estimator_figures(arm: ArmFile, bag: Path) -> dict[str, float]:
    """Return ``kernel_us`` (all scans in one call) and ``scan_us`` (scan by scan) [us], means over the joints."""
    many, single = [], []
    for joint in arm.calibrations:
        topic = f"/{arm.name}/{joint}/{RAW_TOPIC}"
        with opened_bag(bag) as reader:
            records = counted_messages(reader, (topic,), str(bag))
            scans = [scan_from_message(deserialize_message(data, RawScan)) for _, _, data in records]
        posor, arrays = Posor(arm.calibration(joint)), Scans.of(scans)
        many.append(least_us(len(scans), partial(_estimate, posor, posor.estimate_all, [arrays])))
        single.append(least_us(len(scans), partial(_estimate, posor, posor.estimate, scans)))
    return {"kernel_us": fmean(many), "scan_us": fmean(single)}


def _estimate(posor: Posor, estimate: Callable[[Any], object], parts: Sequence[Any]) -> None:
    posor.reset()
    for part in parts:
        estimate(part)
