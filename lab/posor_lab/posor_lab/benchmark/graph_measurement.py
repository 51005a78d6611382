"""Runs a graph for some time and measures it from outside."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from posor.ros_names import DIAGNOSTICS_TOPIC, ENDPOINT_TOPIC
from posor_bringup.supervisor import ProcessError, Program, Supervisor
from rclpy.serialization import deserialize_message

from posor_lab.benchmark import empty_loop, latency_receiver
from posor_lab.benchmark.graph_load import GraphLoad, graph_programs
from posor_lab.benchmark.tick_statistics import COUNTERS, MeasuredRun, TickWindow, evaluate_window
from posor_lab.harness.graph import Graph, values_of
from posor_lab.reports.console_progress import InterruptedRunError
from posor_lab.soak.process_sample import ProcessSample

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from posor_bringup.supervisor import RunningProgram

START_TIMEOUT_S = 60.0
WARM_UP_S = 1.0
SETTLING_S = 1.2
"""Time after the window for messages under way and for the diagnostics that cover its end."""
TOTALS: Mapping[str, Callable[[Sequence[int]], int]] = {
    "ticks_missed": max,
    "scans_incomplete": sum,
    "scans_refused": sum,
}
"""Totals in the diagnostics, in the order of ``COUNTERS``, and how those of several nodes are combined."""


class GraphMeasurement:
    """Measures graphs; the process must be in its own ROS domain.

    Attributes:
        folder: Folder of the last run.

    """

    folder: Path

    def __init__(self, folder: Path, graph: Graph, interrupted: Callable[[], bool] = lambda: False) -> None:
        """Listen to the diagnostics with the node ``graph``; each run writes into a folder in ``folder``."""
        self._folder = folder
        self._graph = graph
        self._interrupted = interrupted
        self._diagnostics: list[bytes] = graph.collect(DiagnosticArray, DIAGNOSTICS_TOPIC, raw=True)
        self._runs = 0

    def measure_graph(self, load: GraphLoad, seconds: float) -> MeasuredRun:
        """Start a graph, measure it for some seconds, end it.

        Raises:
            PosorError: A process failed, or no pose came.

        """
        folder = self._new_folder(load.name)
        rows = folder / "received.npy"
        arguments = f"/{load.arm.name}/{ENDPOINT_TOPIC}", str(rows)
        with Supervisor(folder) as supervisor:
            receiver = supervisor.start(Program("receiver", "", str(latency_receiver.__file__), arguments))
            self._wait_for_line(supervisor, receiver, latency_receiver.READY, "the receiver")
            running = [supervisor.start(program) for program in graph_programs(load, folder)]
            self._wait_for_line(supervisor, receiver, latency_receiver.FIRST_POSE, "the first pose")
            self._wait(supervisor, WARM_UP_S)
            totals, begin_ns, begin = self._take_totals(), time.time_ns(), _take_samples(running)
            self._wait(supervisor, seconds)
            end_ns, end = time.time_ns(), _take_samples(running)
            self._wait(supervisor, SETTLING_S)
            counters = _growth(totals, self._take_totals())
            supervisor.end(running)
            supervisor.end([receiver])
        cores = {
            name: (end[name].used_s - used.used_s) / (end[name].seconds - used.seconds) for name, used in begin.items()
        }
        memory_mb = {name: sample.memory_mb for name, sample in end.items()}
        return evaluate_window(np.load(rows), TickWindow(begin_ns, end_ns, load.rate), counters, cores, memory_mb)

    def measure_empty_loop(self, rate: int, spin_us: int, seconds: float) -> dict[str, Any]:
        """Return how late an empty loop is for its ticks, see ``empty_loop``."""
        folder = self._new_folder(f"empty_loop_{rate}_{spin_us}")
        lateness = folder / "lateness.json"
        arguments = str(rate), str(spin_us), str(lateness)
        with Supervisor(folder) as supervisor:
            program = supervisor.start(Program("empty_loop", "", str(empty_loop.__file__), arguments))
            self._wait_for_line(supervisor, program, empty_loop.READY, "the first tick")
            self._wait(supervisor, seconds)
            supervisor.end([program])
        return dict(json.loads(lateness.read_text(encoding="utf-8")))

    def _new_folder(self, name: str) -> Path:
        self._runs += 1
        self.folder = self._folder / f"{self._runs:02}_{name}"
        self.folder.mkdir(parents=True)
        return self.folder

    def _wait_for_line(self, supervisor: Supervisor, program: RunningProgram, line: str, what: str) -> None:
        deadline_s = time.monotonic() + START_TIMEOUT_S
        while line not in program.log.read_text():
            if time.monotonic() > deadline_s:
                reason = f"{what} did not come within {START_TIMEOUT_S:g} s ({self._worst_status()})"
                raise ProcessError(reason, where="make bench")
            self._receive(supervisor)

    def _wait(self, supervisor: Supervisor, seconds: float) -> None:
        deadline_s = time.monotonic() + seconds
        while time.monotonic() < deadline_s:
            self._receive(supervisor)

    def _receive(self, supervisor: Supervisor) -> None:
        """Wait for a message for a short time; check the processes."""
        supervisor.check()
        if self._interrupted():
            raise InterruptedRunError("interrupted", where="make bench")
        self._graph.receive()

    def _worst_status(self) -> str:
        """Return the newest of the worst diagnostic statuses."""
        newest = (deserialize_message(data, DiagnosticArray) for data in reversed(self._diagnostics))
        statuses = [status for message in newest for status in message.status]
        worst = max(statuses, key=lambda status: status.level, default=None)
        return "no diagnostics received" if worst is None else f"{worst.name}: {worst.message}"

    def _take_totals(self) -> dict[tuple[str, str], int]:
        """Return the newest totals in the diagnostics by node and name; forget the diagnostics."""
        totals: dict[tuple[str, str], int] = {}
        for data in self._diagnostics:
            for status in deserialize_message(data, DiagnosticArray).status:
                values = values_of(status)
                node = status.name.partition(":")[0]
                totals |= {(node, name): int(values[name]) for name in TOTALS if name in values}
        self._diagnostics.clear()
        return totals


def _growth(before: Mapping[tuple[str, str], int], after: Mapping[tuple[str, str], int]) -> dict[str, int]:
    """Return the growth of the totals by name of ``COUNTERS``, combined over the nodes."""
    grown = {name: [0] for name in TOTALS}
    for (node, name), total in after.items():
        grown[name].append(total - before.get((node, name), 0))
    return dict(zip(COUNTERS, (combine(grown[name]) for name, combine in TOTALS.items()), strict=True))


def _take_samples(running: Sequence[RunningProgram]) -> dict[str, ProcessSample]:
    return {each.program.name: ProcessSample.take(each.process.pid, time.monotonic()) for each in running}
