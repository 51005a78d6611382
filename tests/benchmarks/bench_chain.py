"""Microseconds for an endpoint of a six-joint arm: ``tools/in_workspace.py tests/benchmarks/bench_chain.py``.

With sag and covariances; one scan at a time as chain_node does it, and many in one call. Beside it the same
call where the scan is refused, and what joining costs. All times are of the processor, so that a busy machine counts
little; the least of some rounds.
"""

from __future__ import annotations

import sys
from time import process_time
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor_bringup.arms import checked_arm
from posor_estimator.core.chain import MeasuredJoint
from posor_estimator.core.joining import ScanJoiner, join_all
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_estimator.core.arm import Arm

ROUNDS = 15
SCANS = 2000
PERIOD_NS = 500_000
WINDOW_S = 0.05
FIGURES = {
    "endpoint_us": "one endpoint (ChainLane.run)",
    "endpoint_floor_us": "floor: the same call, refused before the walk",
    "endpoint_moving_us": f"one endpoint, accelerations over {WINDOW_S} s at {1_000_000_000 // PERIOD_NS} Hz",
    "endpoints_us": "an endpoint of many (ChainLane.endpoints)",
    "endpoints_moving_us": "an endpoint of many, accelerations as above",
    "relative_us": "relative to home (ChainLane.find_relative_to)",
    "by_name_us": "one endpoint from pinocchio's transforms by name (Chain.endpoint)",
    "join_us": "joining one joint's transform (ScanJoiner.add)",
    "join_all_us": "joining a stamp of all joints at once (join_all)",
}


def chain_figures(arm: Arm) -> dict[str, float]:
    """Return the figures, by the keys of ``FIGURES``."""
    chain, random = arm.chain(), np.random.default_rng(1)
    names = tuple(joint.name for joint in chain.joints)
    stamps = np.arange(1, SCANS + 1) * PERIOD_NS
    angles = 0.5 * np.sin(stamps[:, None] * 1e-9 + np.arange(len(names)))
    transforms = [[chain.nominal_joint(*each) for each in zip(names, row, strict=True)] for row in angles.tolist()]
    poses = np.array([[pin.SE3ToXYZQUAT(transform) for transform in row] for row in transforms])
    roots = random.normal(size=(SCANS, len(names), 6, 6)) * 1e-6
    covariances = roots @ np.swapaxes(roots, 2, 3)
    measured = {name: MeasuredJoint(transforms[0][n], covariances[0, n]) for n, name in enumerate(names)}
    still, moving = chain.lane(), chain.lane(WINDOW_S)
    for lane in (still, moving):
        lane.poses[:], lane.covariances[:] = poses[0], covariances[0]
        lane.endpoints(poses, covariances, stamps)
    ticks = stamps.tolist()
    # A scan without sound numbers is refused before the walk begins.
    refused = chain.lane()
    refused.poses[:] = np.nan

    def at_home() -> None:
        for _ in ticks:
            still.find_relative_to(still.pose)

    def joined() -> None:
        joiner: ScanJoiner[int] = ScanJoiner(names)
        for tick in ticks:
            for name in names:
                joiner.add(name, tick, tick, 0.0)

    lost = [np.delete(stamps, slice(n, None, 97)) for n in range(len(names))]
    return {
        "endpoint_us": _least(SCANS, lambda: [still.run(tick) for tick in ticks]),
        "endpoint_floor_us": _least(SCANS, lambda: [refused.run(tick) for tick in ticks]),
        "endpoint_moving_us": _least(SCANS, lambda: [moving.run(tick) for tick in ticks]),
        "endpoints_us": _least(SCANS, lambda: still.endpoints(poses, covariances, stamps)),
        "endpoints_moving_us": _least(SCANS, lambda: moving.endpoints(poses, covariances, stamps)),
        "relative_us": _least(SCANS, at_home),
        "by_name_us": _least(SCANS, lambda: [chain.endpoint(measured) for _ in ticks]),
        "join_us": _least(SCANS * len(names), joined),
        "join_all_us": _least(SCANS, lambda: join_all(lost)),
    }


def _least(count: int, work: Callable[[], object]) -> float:
    """Return the least time [us] of the processor for one of so many."""
    seconds = []
    for _ in range(ROUNDS):
        begin = process_time()
        work()
        seconds.append(process_time() - begin)
    return 1e6 * min(seconds) / count


def main() -> int:
    """Print the figures."""
    table = Table(title="The chain of the six-axis arm", title_justify="left")
    table.add_column("what")
    table.add_column("us", justify="right")
    for key, value in chain_figures(checked_arm("six_axis")).items():
        table.add_row(FIGURES[key], f"{value:.2f}")
    Console(width=118).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
