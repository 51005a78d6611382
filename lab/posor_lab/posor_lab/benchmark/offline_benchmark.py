# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Speed of offline processing: `reprocess` and the loops that it is compared with, on a long bag made of a short one.

`reprocess` runs as a program of its own; its processor time gives figures per core, and its memory is its own.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from posor.bags.bag_reader import opened_bag
from posor.bags.bag_writer import BagWriter, TopicMessages
from posor.bags.block_reader import read_blocks
from posor.bags.message_block import TopicReader
from posor.messages.message_definitions import MessageTypes
from posor.messages.message_table import MessageTable
from posor.numerics.stamps import NS, tick_stamp_ns
from posor.ros_names import RAW_SCAN, RAW_TOPIC
from posor_msgs.msg import RawScan
from posor_ros.message_classes import schema_of_class

from posor_lab.benchmark.comparison_loops import (
    check_same_endpoints,
    check_same_messages,
    run_bulk_loop,
    run_message_loop,
    run_reading_loop,
)

if TYPE_CHECKING:
    from posor.chain.arm_file import ArmFile

SECONDS = 600
RATE = 1000  # rate of the long bag [Hz]
ROUNDS = 3
START = 1_767_225_600
FREE_FACTOR = 8  # free disk space needed for the bags, in sizes of the long bag


def offline_figures(arm: ArmFile, bag: Path, folder: Path, seconds: int) -> dict[str, float | list[float]]:
    """Return the speed of offline processing of an arm's scans, in scans per second of processor time.

    ``bag`` has scans of all joints that end where they begin; the long bag of ``seconds`` and the results are removed.
    Of several rounds the fastest counts: load of the host, and memory that the host has to find for the page cache,
    only add time.

    Returns ``offline_scans_per_s``: `reprocess` into a bag, of all rounds in ``offline_runs_scans_per_s``, per second
    of wall time in ``offline_wall_scans_per_s``; ``offline_summary_scans_per_s``: without output;
    ``offline_memory_mb``: its peak memory; and the loops of ``comparison_loops``: ``reading_messages_per_s``,
    ``bulk_loop_scans_per_s``, ``message_loop_scans_per_s``. Raises OSError: there is not enough free disk space. Raises
    BagError: a loop has other results than `reprocess`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    long, looped, reprocessed = folder / "long", folder / "looped", folder / "reprocessed"
    try:
        repeat_bag(arm, bag, long, seconds)
        loop_speeds, runs = list[float](), []
        for _ in range(ROUNDS):
            shutil.rmtree(looped, ignore_errors=True)
            shutil.rmtree(reprocessed, ignore_errors=True)
            loop_speeds.append(run_message_loop(arm, long, looped))
            runs.append(_run_reprocess(arm, long, reprocessed))
        check_same_messages(looped, reprocessed)
        bulk_speed, stamps_ns, poses = run_bulk_loop(arm, long)
        check_same_endpoints(arm, stamps_ns, poses, reprocessed)
        fastest, without_output = min(runs, key=lambda run: run["cpu_s"]), _run_reprocess(arm, long, None)
        return {
            "offline_scans": fastest["scans"],
            "offline_scans_per_s": fastest["scans"] / fastest["cpu_s"],
            "offline_runs_scans_per_s": [run["scans"] / run["cpu_s"] for run in runs],
            "offline_wall_scans_per_s": fastest["scans"] / fastest["wall_s"],
            "offline_summary_scans_per_s": without_output["scans"] / without_output["cpu_s"],
            "offline_memory_mb": max(run["memory_mb"] for run in (*runs, without_output)),
            "reading_messages_per_s": run_reading_loop(long),
            "bulk_loop_scans_per_s": bulk_speed,
            "message_loop_scans_per_s": max(loop_speeds),
        }
    finally:
        for temporary in (long, looped, reprocessed):
            shutil.rmtree(temporary, ignore_errors=True)


def repeat_bag(arm: ArmFile, bag: Path, long: Path, seconds: int) -> None:
    """Write a bag that repeats the scans of another bag with increasing stamps and scan numbers.

    Raises OSError: there is not enough free disk space.
    """
    topics = {joint: f"/{arm.name}/{joint}/{RAW_TOPIC}" for joint in arm.calibrations}
    with opened_bag(bag) as reader:
        whole = list(read_blocks(reader, list(topics.values()), str(bag)))
        tables = {}
        for number, (joint, topic) in enumerate(topics.items()):
            of_topic = TopicReader(number, topic, schema_of_class(RawScan), str(bag))
            tables[joint] = [table for block in whole for _, _, table in of_topic.read_tables(block)]
    scans = {
        joint: MessageTable(found[0].layout, np.concatenate([table.rows for table in found]))
        for joint, found in tables.items()
    }
    size = seconds * RATE * sum(table.rows.shape[1] + 31 for table in scans.values())
    if shutil.disk_usage(long.parent).free < FREE_FACTOR * size:
        raise OSError(f"{long.parent}: the bags of the benchmark need {FREE_FACTOR * size >> 20} MB of free disk space")
    definition = MessageTypes().definition(RAW_SCAN)
    with BagWriter(long) as writer:
        channels = {joint: writer.add_topic(topic, RAW_SCAN, definition) for joint, topic in topics.items()}
        for begin in range(0, seconds * RATE, RATE):
            ticks = START * RATE + np.arange(begin, begin + RATE)
            stamps = tick_stamp_ns(ticks, RATE)
            parts = []
            for joint, table in scans.items():
                some = table.select((ticks - START * RATE) % len(table))
                some["header.stamp.sec"], some["header.stamp.nanosec"] = stamps // NS, stamps % NS
                some["scan"] = ticks
                parts.append(TopicMessages(channels[joint], stamps, some.messages))
            writer.write_messages(parts)


def _run_reprocess(arm: ArmFile, bag: Path, output: Path | None) -> dict[str, float]:
    """Run `reprocess` in a process of its own; return its scans, times and memory."""
    paths = [bag, arm.path, *([] if output is None else [output])]
    command = [sys.executable, "-m", __name__, *(str(path.resolve()) for path in paths)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return dict(json.loads(printed.splitlines()[-1]))


def _reprocess(bag: str, arm: str, output: str = "") -> None:
    """Reprocess a bag and print scans, times and memory."""
    from posor.bags.offline_pipeline import reprocess_bag  # noqa: PLC0415
    from posor.bags.reprocess_command import parser, tasks_of  # noqa: PLC0415
    from posor.chain.arm_file import load_arm_file  # noqa: PLC0415

    options = [bag, "--arm", arm, *(["--output", output] if output else [])]
    (task,) = tasks_of(parser().parse_args(options))
    load_arm_file(Path(arm))
    summary = reprocess_bag(task)
    figures = {"scans": summary.scans, "wall_s": summary.wall_s, "cpu_s": summary.cpu_s, "memory_mb": _peak_mb()}
    print(json.dumps(figures))


def _peak_mb() -> float:
    """Return the peak memory of this process [MB]; getrusage would include the parent process."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM:")) / 1024.0


if __name__ == "__main__":
    _reprocess(*sys.argv[1:])
