# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A `compose` with a stopwatch around every stage of a tick: ``stage_profile.py COMPOSITION FILE``.

Writes the time of each stage per tick, and the times from the stamp to the milestones of a tick, into FILE (JSON) at
the end. Nodes that share the process call each other, so all stages of a tick run in one thread.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from pkgutil import resolve_name
from threading import get_ident
from time import perf_counter_ns, time_ns
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.messages.cdr_schema import STAMP
from posor.messages.joint_transform import stamp_ns_of
from posor_estimator.compose_command import main as compose
from posor_ros.intra_process import IntraProcessPublisher
from posor_ros.node_program import non_ros_arguments

if TYPE_CHECKING:
    from collections.abc import Callable

CALIBRATION_ROUNDS, CALLS = 50, 500  # the cost of a stopwatch is taken from the fastest round


@dataclass
class StageTime:
    """Calls of a stage, its own time [ns] and the number of timed calls that it made."""

    calls: int = 0
    own_ns: int = 0
    timed_calls: int = 0


class Stopwatches:
    """Times functions in one thread: the first that calls one of them."""

    def __init__(self, now_ns: Callable[[], int] = perf_counter_ns) -> None:
        self._now_ns = now_ns
        self._stages: dict[str, StageTime] = {}
        self._open: list[list[int]] = []
        self._thread = 0
        self._inside_ns = self._outside_ns = 0.0
        self._calibrate()

    def timed(self, function: Callable[..., Any], name: Callable[..., str] | str) -> Callable[..., Any]:
        """Return the function with a stopwatch; ``name``: of its stage, or a function that returns it for a call."""
        open_calls, now_ns = self._open, self._now_ns

        @wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            if get_ident() != self._thread:
                if self._thread:
                    return function(*arguments, **named)
                self._thread = get_ident()
            inner = [0, 0]
            open_calls.append(inner)
            begin = now_ns()
            try:
                return function(*arguments, **named)
            finally:
                elapsed = now_ns() - begin
                open_calls.pop()
                if open_calls:
                    open_calls[-1][0] += elapsed
                    open_calls[-1][1] += 1
                label = name if isinstance(name, str) else name(*arguments)
                stage = self._stages.setdefault(label, StageTime())
                stage.calls += 1
                stage.own_ns += elapsed - inner[0]
                stage.timed_calls += inner[1]

        return call

    def _calibrate(self) -> None:
        """Measure the time that a stopwatch adds to its own stage and to the calling stage."""
        nothing, rounds = self.timed(lambda: None, "no-op"), list[tuple[float, float]]()
        for _ in range(CALIBRATION_ROUNDS):
            self.restart()
            begin = self._now_ns()
            for _ in range(CALLS):
                nothing()
            rounds.append(((self._now_ns() - begin) / CALLS, self._stages["no-op"].own_ns / CALLS))
        whole_ns, self._inside_ns = min(rounds)
        self._outside_ns = whole_ns - self._inside_ns
        self._thread = 0
        self.restart()

    def restart(self) -> None:
        """Forget all times."""
        self._stages.clear()

    def stage_times(self) -> dict[str, tuple[int, float]]:
        """Return calls and time [us] of each stage without the cost of the stopwatches."""

        def own_us(stage: StageTime) -> float:
            return (stage.own_ns - stage.calls * self._inside_ns - stage.timed_calls * self._outside_ns) / 1e3

        return {name: (stage.calls, own_us(stage)) for name, stage in self._stages.items()}


STAGES = {  # method and name of each stage; publishing is one more stage for each message type
    "posor_drivers.tick_scheduler:TickTask.run_tick": "driver: schedule the ticks, other",
    "posor.messages.raw_scan:ScanTemplate.at": "driver: stamp into the scan",
    "posor_estimator.posor_node:PosorEstimatorNode.estimate_scans": "posor_node: other",
    "posor_estimator.posor_node:PosorEstimatorNode.complete_scan": "posor_node: counts and reports",
    "posor.messages.message_stream:RawScanStream.prepare": "posor_node: read",
    "posor.messages.message_stream:RawScanStream.run_prepared": "posor_node: estimate scans by themselves",
    "posor.messages.message_stream:RawScanStream.finish": "posor_node: write",
    "posor.messages.arm_pass:ArmPass.run": "posor_node and chain_node: estimate scans and endpoint",
    "posor_estimator.chain_node:ChainNode._take_scans": "chain_node: check the scans",
    "posor_estimator.chain_node:ChainNode._estimate_taken": "chain_node: other",
    "posor_estimator.chain_node:ChainNode._on_transforms": "chain_node: other, of transforms by themselves",
    "posor.chain.time_synchroniser:TimeSynchroniser.add_together": "chain_node: synchronise",
    "posor.chain.endpoint_estimator:EndpointEstimator.estimate_rows": "chain_node: read the transforms, endpoint",
    "posor.messages.endpoint_messages:MessageWriter.write": "chain_node: numbers into bytes",
}
SCAN, POSE = "RawScan", "PoseStamped"
MILESTONES = ("stamp_to_first_scan_us", "first_to_last_scan_us", "last_scan_to_pose_us")
WARM_UP_TICKS = 100


class TickMilestones:
    """Times of each tick; ``intervals_ns`` are the intervals of ``MILESTONES`` of each tick."""

    def __init__(self, on_warm: Callable[[], None]) -> None:
        """Store milestones; call ``on_warm`` after ``WARM_UP_TICKS`` and forget those ticks."""
        self._on_warm = on_warm
        self._is_warm = False
        self._stamp_ns = self._first_ns = self._last_ns = 0
        self.intervals_ns: list[tuple[int, int, int]] = []

    def on_scan(self, data: bytes) -> None:
        """Store the time of a scan."""
        stamp_ns, now_ns = stamp_ns_of(data[STAMP]), time_ns()
        if stamp_ns != self._stamp_ns:
            self._stamp_ns, self._first_ns = stamp_ns, now_ns
        self._last_ns = now_ns

    def on_pose(self, data: bytes) -> None:
        """Store the intervals of a tick when its pose has been published."""
        now_ns = time_ns()
        if stamp_ns_of(data[STAMP]) != self._stamp_ns:
            return
        first_ns, last_ns = self._first_ns, self._last_ns
        self.intervals_ns.append((first_ns - self._stamp_ns, last_ns - first_ns, now_ns - last_ns))
        if not self._is_warm and len(self.intervals_ns) == WARM_UP_TICKS:
            self._is_warm = True
            self.intervals_ns.clear()
            self._on_warm()


def install_stopwatches(watches: Stopwatches, milestones: TickMilestones) -> None:
    """Put a stopwatch around every stage; call it before nodes are created."""
    for place, stage in STAGES.items():
        (name, _, method), timed = place.rpartition("."), watches.timed(resolve_name(place), stage)
        kind = resolve_name(name)
        setattr(kind, method, staticmethod(timed) if isinstance(vars(kind)[method], staticmethod) else timed)
    publisher_type: Any = IntraProcessPublisher
    deliver, over_dds = publisher_type.deliver, publisher_type.publish_over_dds
    publisher_type.deliver = watches.timed(deliver, lambda publisher, *_: f"deliver {publisher.message_type.__name__}")
    publisher_type.publish_over_dds = watches.timed(
        over_dds, lambda publisher, *_: f"publish {publisher.message_type.__name__}"
    )
    publish = publisher_type.publish

    def publish_and_store(publisher: Any, data: bytes) -> bool:
        kind = publisher.message_type.__name__
        if kind == SCAN:
            milestones.on_scan(data)
        is_published = bool(publish(publisher, data))
        if kind == POSE:
            milestones.on_pose(data)
        return is_published

    publisher_type.publish = publish_and_store


def profile_figures(watches: Stopwatches, milestones: TickMilestones) -> dict[str, Any]:
    """Return calls and time of each stage per tick, the longest first, and percentiles of the milestones."""
    intervals_us = np.array(milestones.intervals_ns).reshape(-1, 3) / 1e3
    ticks = len(intervals_us)
    stages = sorted(watches.stage_times().items(), key=lambda item: -item[1][1])
    return {
        "ticks": ticks,
        "stages": {name: {"calls": calls / ticks, "us": us / ticks} for name, (calls, us) in stages},
        **{
            name: {"p50": float(np.percentile(column, 50)), "p99": float(np.percentile(column, 99))}
            for name, column in zip(MILESTONES, intervals_us.T, strict=True)
        },
    }


def main() -> int:
    """Run the program."""
    composition, file = non_ros_arguments(sys.argv)
    watches = Stopwatches()
    milestones = TickMilestones(watches.restart)
    install_stopwatches(watches, milestones)
    code = compose([sys.argv[0], composition])
    if milestones.intervals_ns:
        figures = profile_figures(watches, milestones)
        Path(file).write_text(json.dumps(figures, indent=1), encoding="utf-8")
    return code


if __name__ == "__main__":
    sys.exit(main())
