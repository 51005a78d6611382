# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Measurements for the planning of a cell: messages and processor time of one arm, speed of a small cluster."""

from __future__ import annotations

import shutil
import signal
import sys
import time
from collections import Counter
from contextlib import ExitStack, suppress
from statistics import fmean
from typing import TYPE_CHECKING, Any

from mcap.reader import make_reader
from posor.ros_names import ENDPOINT_STATE_TOPIC, RAW_TOPIC
from posor_bringup.supervisor import ProcessError, ProgramCommand
from posor_msgs.msg import EndpointState

from posor_lab.benchmark.graph_load import graph_programs
from posor_lab.benchmark.graph_measurement import START_TIMEOUT_S, DiagnosticsReceiver
from posor_lab.benchmark.offline_benchmark import repeat_bag
from posor_lab.harness.program import Program, installed
from posor_lab.reports.graph_receiver import running_graph
from posor_lab.soak.process_sample import ProcessSample

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from posor.chain.arm_file import ArmFile
    from rclpy.node import Node

    from posor_lab.benchmark.graph_load import GraphLoad

PROGRAM = "make scaling"
WARM_UP_S = 3.0  # from the first state of the endpoint to the measured time: the recorder finds the topics
DASK = {"DASK_DISTRIBUTED__DASHBOARD__LINK": ""}
BAGS = 4  # reprocessed at a time, so that two workers have equal shares
REPROCESS_S = 3600.0  # longest time of a measurement of the cluster


def measure_recorded_arm(
    load: GraphLoad, seconds: float, folder: Path, interrupted: Callable[[], bool]
) -> dict[str, Any]:
    """Run an arm whose topics are all recorded in another process.

    Returns ``topics``: bytes of a message and messages per second of each topic; ``ticks_per_s`` of a joint;
    ``tick_s``: processor time of the nodes in a tick; ``participants`` and ``endpoints``: DDS participants of the arm,
    their writers and readers.
    """
    folder.mkdir(parents=True)
    bag = folder / "recorded"
    record = ProgramCommand("record", "posor_drivers", "record", ("--all", "--output", str(bag)))
    receiver = DiagnosticsReceiver("scaling")
    with running_graph([record, *graph_programs(load, folder)], receiver, folder, PROGRAM, interrupted) as watch:
        recorder, *nodes = watch.running.values()
        states = receiver.store_topic(EndpointState, f"/{load.arm.name}/{ENDPOINT_STATE_TOPIC}")
        watch.wait(lambda: bool(states), lambda: "a state of the endpoint", START_TIMEOUT_S)
        receiver.destroy_subscription(next(reversed(list(receiver.subscriptions))))
        watch.wait_for(WARM_UP_S)
        begin_ns, before = time.time_ns(), [_used(node.process.pid) for node in nodes]
        watch.wait_for(seconds)
        end_ns, after = time.time_ns(), [_used(node.process.pid) for node in nodes]
        endpoints = count_endpoints(receiver, f"/{load.arm.name}")
        watch.running.pop(record.name)
        with suppress(ProcessError):  # messages were lost, on a busy host: the rates show how many
            watch.supervisor.end([recorder])
    used = sum(b - a for a, b in zip(before, after, strict=True))
    topics = read_topics(next(bag.glob("*.mcap")), begin_ns, end_ns)
    raw = [each["per_s"] for topic, each in topics.items() if topic.endswith(f"/{RAW_TOPIC}")]
    return {
        "topics": topics,
        "ticks_per_s": fmean(raw),
        "tick_s": used / seconds / fmean(raw),
        "participants": len(nodes),
        "endpoints": endpoints,
    }


def read_topics(bag: Path, begin_ns: int, end_ns: int) -> dict[str, dict[str, float]]:
    """Return ``bytes`` of a message (mean) and messages ``per_s`` of the topics of an MCAP file within a time."""
    counts, sizes = Counter[str](), Counter[str]()
    with bag.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(start_time=begin_ns, end_time=end_ns):
            counts[channel.topic] += 1
            sizes[channel.topic] += len(message.data)
    seconds = 1e-9 * (end_ns - begin_ns)
    return {topic: {"bytes": sizes[topic] / count, "per_s": count / seconds} for topic, count in sorted(counts.items())}


def count_endpoints(observer: Node, namespace: str) -> int:
    """Return the writers and readers of all nodes in a namespace; a service or a client has one of each."""
    found = 0
    for name, own in observer.get_node_names_and_namespaces():
        if own == namespace or own.startswith(f"{namespace}/"):
            for kind, weight in (("publisher", 1), ("subscriber", 1), ("service", 2), ("client", 2)):
                names = getattr(observer, f"get_{kind}_names_and_types_by_node")(name, own)
                found += weight * len(names)
    return found


def _used(pid: int) -> float:
    return ProcessSample.take(pid, 0.0).used_s


def measure_cluster(arm: ArmFile, scans: Path, folder: Path, seconds: int, workers: Sequence[int]) -> dict[str, Any]:
    """Reprocess bags of raw scans with some numbers of Dask workers, of one thread each.

    Returns ``bag_bytes``, ``bag_seconds`` and ``scans`` of all bags, ``result_bytes``, and of each number of workers
    ``wall_s`` and ``cpu_s`` (of the workers). Raises OSError: there is not enough free disk space.
    """
    folder.mkdir(parents=True)
    bags = [folder / f"bag_{n}" for n in range(BAGS)]
    try:
        for bag in bags:
            repeat_bag(arm, scans, bag, seconds)
        results, runs = folder / "results", {}
        for count in workers:
            shutil.rmtree(results, ignore_errors=True)
            runs[str(count)] = _reprocess(arm, bags, results, count, folder)
        return {
            "bag_bytes": sum(map(_size, bags)),
            "bag_seconds": BAGS * seconds,
            "result_bytes": _size(results),
            "runs": runs,
        }
    finally:
        for each in (*bags, folder / "results"):
            shutil.rmtree(each, ignore_errors=True)


def _reprocess(arm: ArmFile, bags: Sequence[Path], results: Path, count: int, folder: Path) -> dict[str, float]:
    def dask(name: str, *arguments: str) -> Program:
        return Program([sys.executable, "-m", f"distributed.cli.dask_{name}", "--no-dashboard", *arguments], DASK)

    with ExitStack() as stack:
        scheduler = stack.enter_context(dask("scheduler", "--host", "127.0.0.1", "--port", "0"))
        address = scheduler.wait_for_line("Scheduler at:").split()[-1]
        options = ("--nthreads", "1", "--no-nanny", "--local-directory", str(folder / "spill"))
        workers = [stack.enter_context(dask("worker", address, *options)) for _ in range(count)]
        for worker in workers:
            worker.wait_for_line("Registered to:")
        used, begin_s = sum(_used(each.process.pid) for each in workers), time.monotonic()
        command = [*map(str, bags), "--arm", str(arm.path), "--output", str(results), "--scheduler", address]
        client = stack.enter_context(Program([*installed("posor", "reprocess"), *command]))
        code = client.process.wait(REPROCESS_S)
        wall_s, cpu_s = time.monotonic() - begin_s, sum(_used(each.process.pid) for each in workers) - used
        if code:
            raise RuntimeError("\n".join(client.stderr))
        for each in (*workers, scheduler):
            each.process.send_signal(signal.SIGINT)
    return {"wall_s": wall_s, "cpu_s": cpu_s}


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
