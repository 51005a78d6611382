"""Speed of reprocessing alone: a long bag of scans, made of a short one, and the plain loop over its messages.

The processor time of a program of its own is measured, so that the figures are per core, and its memory.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from posor_drivers.simulator.ticks import NS, stamps_of
from posor_estimator.bulk.bag_writer import BulkWriter, Part
from posor_estimator.bulk.blocks import blocks
from posor_estimator.bulk.layout import Table
from posor_estimator.bulk.pieces import TopicReader
from posor_estimator.ros.bag_reader import opened_bag
from posor_estimator.ros.cdr import Schema
from posor_estimator.ros.message_types import RAW_SCAN, MessageTypes
from posor_estimator.ros.qos import RAW_TOPIC
from posor_msgs.msg import RawScan

from tests.benchmarks.plain_loop import check_same, plain_loop, reading

if TYPE_CHECKING:
    from posor_estimator.core.arm import Arm

SECONDS = 600
RATE = 1000
"""Of the long bag [Hz]."""
ROUNDS = 3
ROOT = Path(__file__).resolve().parents[2]
START = 1_767_225_600
ROOM = 8
"""How many times the size of the long bag must be free, for it and the results."""


def offline_figures(
    arm: Arm, bag: Path, folder: Path, seconds: int = SECONDS, rounds: int = ROUNDS
) -> dict[str, float | list[float]]:
    """Return the speed of reprocessing an arm's scans.

    Args:
        arm: The arm.
        bag: Scans of each of its joints, which end where they begin.
        folder: Where the long bag and the results are made, and removed.
        seconds: Length of the long bag.
        rounds: How often it is reprocessed into a bag, and the plain loop run. The least time counts: whatever else the
            machine does, and the first use of memory that it has not yet given to the page cache, only adds to it.

    Returns:
        ``offline_scans_per_s``, into a bag, and ``offline_summary_scans_per_s``, without results, both per second of
        processor time; ``offline_runs_scans_per_s``, of every round; ``offline_wall_scans_per_s``, into a bag;
        ``offline_memory_mb``, the largest; ``plain_loop_scans_per_s``, of the loop over the messages whose results are
        the same; and ``reading_messages_per_s``, of rosbags reading and decoding them, and no more (``plain_loop``).

    Raises:
        OSError: There is too little room for the bag.
        BagError: The plain loop has come to other results.

    """
    folder.mkdir(parents=True, exist_ok=True)
    long, plain, reprocessed = folder / "long", folder / "plain", folder / "reprocessed"
    try:
        repeat(arm, bag, long, seconds)
        plainly, runs = list[float](), []
        for _ in range(rounds):
            shutil.rmtree(plain, ignore_errors=True)
            shutil.rmtree(reprocessed, ignore_errors=True)
            plainly.append(plain_loop(arm, long, plain))
            runs.append(_run(arm, long, reprocessed))
        check_same(plain, reprocessed)
        written, alone = min(runs, key=lambda run: run["cpu_s"]), _run(arm, long, None)
        return {
            "offline_scans": written["scans"],
            "offline_scans_per_s": written["scans"] / written["cpu_s"],
            "offline_runs_scans_per_s": [run["scans"] / run["cpu_s"] for run in runs],
            "offline_wall_scans_per_s": written["scans"] / written["wall_s"],
            "offline_summary_scans_per_s": alone["scans"] / alone["cpu_s"],
            "offline_memory_mb": max(run["memory_mb"] for run in (*runs, alone)),
            "plain_loop_scans_per_s": max(plainly),
            "reading_messages_per_s": reading(long),
        }
    finally:
        for made in (long, plain, reprocessed):
            shutil.rmtree(made, ignore_errors=True)


def repeat(arm: Arm, bag: Path, long: Path, seconds: int, rate: int = RATE) -> None:
    """Write a bag that repeats the scans of another, with stamps and scan numbers that go on.

    Raises:
        OSError: There is too little room for it.

    """
    topics = {joint: f"/{arm.name}/{joint}/{RAW_TOPIC}" for joint in arm.calibrations}
    with opened_bag(bag) as reader:
        whole = list(blocks(reader, list(topics.values()), str(bag)))
        pieces = {}
        for number, (joint, topic) in enumerate(topics.items()):
            of_topic = TopicReader(number, topic, Schema.of(RawScan), str(bag))
            pieces[joint] = [piece for block in whole for piece in of_topic.pieces(block)]
    scans = {
        joint: Table(found[0].table.layout, np.concatenate([each.table.rows for each in found]))
        for joint, found in pieces.items()
    }
    size = seconds * rate * sum(table.rows.shape[1] + 31 for table in scans.values())
    if shutil.disk_usage(long.parent).free < ROOM * size:
        raise OSError(f"{long.parent}: {ROOM * size >> 20} MB of room are needed for the bags of the benchmark")
    types = MessageTypes()
    text, type_hash = types.definition(RAW_SCAN)
    with BulkWriter(long) as writer:
        connections = {
            joint: writer.add_connection(topic, RAW_SCAN, msgdef=text, rihs01=type_hash)
            for joint, topic in topics.items()
        }
        for begin in range(0, seconds * rate, rate):
            ticks = START * rate + np.arange(begin, begin + rate)
            stamps = stamps_of(ticks, rate)
            parts = []
            for joint, table in scans.items():
                some = table.chosen((ticks - START * rate) % len(table))
                some["header.stamp.sec"], some["header.stamp.nanosec"] = stamps // NS, stamps % NS
                some["scan"] = ticks
                parts.append(Part(connections[joint], stamps, some.messages))
            writer.write_parts(parts)


def _run(arm: Arm, bag: Path, output: Path | None) -> dict[str, float]:
    """Reprocess a bag in a program of its own; return what it says of itself."""
    places = [bag, arm.path, *([] if output is None else [output])]
    command = [sys.executable, "-m", "tests.benchmarks.offline", *(str(place.resolve()) for place in places)]
    said = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout
    return dict(json.loads(said.splitlines()[-1]))


def _main(bag: str, arm: str, output: str = "") -> None:
    from posor_estimator.core.arm import load_arm  # noqa: PLC0415
    from posor_estimator.reprocess.command import parser, tasks_of  # noqa: PLC0415
    from posor_estimator.reprocess.pipeline import reprocess  # noqa: PLC0415

    options = [bag, "--arm", arm, *(["--output", output] if output else [])]
    (task,) = tasks_of(parser().parse_args(options))
    load_arm(Path(arm))
    summary = reprocess(task)
    told = {"scans": summary.scans, "wall_s": summary.wall_s, "cpu_s": summary.cpu_s, "memory_mb": _peak_mb()}
    print(json.dumps(told))


def _peak_mb() -> float:
    """Return the most memory of this program [MB]; getrusage would tell that of the one that started it, if more."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM:")) / 1024.0


if __name__ == "__main__":
    _main(*sys.argv[1:])
