"""A `compose` with a stopwatch around every stage of a tick: ``profiled.py COMPOSITION FILE``.

Writes into FILE (JSON), at the end, what each stage took of a tick, and how long after its stamp a tick reached its
milestones. Nodes that share the process call one another, so that all of a tick happens in one thread.
"""

from __future__ import annotations

import json
import sys
from importlib import import_module
from pathlib import Path
from struct import Struct
from time import time_ns
from typing import TYPE_CHECKING, Any

import numpy as np
from posor_estimator.ros.compose import main as compose
from posor_estimator.ros.main import own_arguments

from tests.benchmarks.stopwatch import Stopwatches

if TYPE_CHECKING:
    from collections.abc import Callable

STAGES = (
    ("posor_drivers.ticker", "Beat", "go_on", "driver: take turns, all else"),
    ("posor_estimator.ros.cdr_scan", "ScanTemplate", "at", "driver: stamp into the scan"),
    ("posor_estimator.posor_node", "PosorEstimatorNode", "_take", "posor_node: all else"),
    ("posor_estimator.ros.byte_lane", "ByteLane", "answer", "posor_node: bytes of the scan and the transform"),
    ("posor_estimator.core.records", "RecordLane", "run", "posor_node: read, locate, write"),
    ("posor_estimator.chain_node", "ChainNode", "_take", "chain_node: all else"),
    ("posor_estimator.core.joining", "ScanJoiner", "add", "chain_node: join"),
    ("posor_estimator.core.chain_records", "ChainRecords", "run", "chain_node: read the transforms, endpoint"),
    ("posor_estimator.ros.cdr_writer", "MessageWriter", "write", "chain_node: numbers into bytes"),
)
"""Module, class, method and name of each stage; publishing is one more for each type of message."""
SCAN, POSE = "RawScan", "PoseStamped"
WARM_UP = 100
"""Ticks that do not count: at first everything is done for the first time."""
_STAMP = Struct("<iI")
_NS = 1_000_000_000


class Milestones:
    """When the scans of a tick were at hand, and when its pose had been sent [ns after the stamp]."""

    def __init__(self, on_warm: Callable[[], None]) -> None:
        self._on_warm: Callable[[], None] | None = on_warm
        self._stamp_ns = self._first_ns = self._last_ns = 0
        self.passed: list[tuple[int, int, int]] = []

    def scan(self, data: bytes) -> None:
        """Note that a scan is at hand."""
        stamp_ns, now_ns = _stamp_of(data), time_ns()
        if stamp_ns != self._stamp_ns:
            self._stamp_ns, self._first_ns = stamp_ns, now_ns
        self._last_ns = now_ns

    def pose(self, data: bytes) -> None:
        """Note that a pose was sent."""
        now_ns = time_ns()
        if _stamp_of(data) == self._stamp_ns:
            first_ns, last_ns = self._first_ns, self._last_ns
            self.passed.append((first_ns - self._stamp_ns, last_ns - first_ns, now_ns - last_ns))
            if self._on_warm is not None and len(self.passed) == WARM_UP:
                self.passed.clear()
                self._on_warm()
                self._on_warm = None


def _stamp_of(data: bytes) -> int:
    sec, nanosec = _STAMP.unpack_from(data, 4)
    return int(sec * _NS + nanosec)


def put_stopwatches(watches: Stopwatches, milestones: Milestones) -> None:
    """Put a stopwatch around every stage, before there is any node."""
    for module, name, method, stage in STAGES:
        kind = getattr(import_module(module), name)
        setattr(kind, method, watches.timed(getattr(kind, method), stage))
    outlet = import_module("posor_estimator.ros.wire").Outlet
    publish = watches.timed(outlet.publish, lambda outlet, *_: f"publish {outlet.message_type.__name__}")
    outlet.publish = _noting(_noting(publish, SCAN, before=milestones.scan), POSE, after=milestones.pose)


def _noting(
    function: Callable[..., Any],
    kind: str,
    *,
    before: Callable[[bytes], None] | None = None,
    after: Callable[[bytes], None] | None = None,
) -> Callable[..., Any]:
    """Return an outlet's method that tells of messages of one type as well."""

    def method(outlet: Any, data: bytes) -> Any:
        told = outlet.message_type.__name__ == kind
        if told and before is not None:
            before(data)
        result = function(outlet, data)
        if told and after is not None:
            after(data)
        return result

    return method


def main() -> int:
    """Run the program."""
    composition, file = own_arguments(sys.argv)
    watches = Stopwatches()
    milestones = Milestones(watches.restart)
    put_stopwatches(watches, milestones)
    code = compose([sys.argv[0], composition])
    passed = np.array(milestones.passed).reshape(-1, 3) / 1e3
    if len(passed):
        found, ticks = watches.found(), len(passed)
        names = ("stamp_to_first_scan_us", "first_to_last_scan_us", "last_scan_to_pose_us")
        told = {
            "ticks": ticks,
            "stages": {
                name: {"calls": calls / ticks, "us": took / ticks}
                for name, (calls, took) in sorted(found.items(), key=lambda item: -item[1][1])
            },
            **{
                name: {"p50": float(np.percentile(column, 50)), "p99": float(np.percentile(column, 99))}
                for name, column in zip(names, passed.T, strict=True)
            },
        }
        Path(file).write_text(json.dumps(told, indent=1), encoding="utf-8")
    return code


if __name__ == "__main__":
    sys.exit(main())
