# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Runs a graph for some time and measures it from outside."""

from __future__ import annotations

import json
import re
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.ros_names import ENDPOINT_TOPIC
from posor_bringup.supervisor import ProgramCommand

from posor_lab.benchmark import empty_loop, latency_receiver, page_reader
from posor_lab.benchmark.graph_load import GraphLoad, graph_programs
from posor_lab.benchmark.tick_statistics import MeasuredRun, TickWindow, evaluate_window
from posor_lab.harness.graph import values_of
from posor_lab.reports.graph_receiver import GraphReceiver, running_graph
from posor_lab.soak.process_sample import ProcessSample

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from diagnostic_msgs.msg import DiagnosticArray
    from posor_bringup.supervisor import RunningProgram

    from posor_lab.reports.graph_receiver import GraphWatch

VIEW = "view"  # name of its process in the figures
START_TIMEOUT_S = 60.0
WARM_UP_S = 1.0
SETTLING_S = 1.2  # time after the window for messages under way and for the diagnostics that cover its end
TOTALS: Mapping[str, tuple[str, Callable[[Sequence[int]], int]]] = {
    "ticks_missed": ("ticks_missed", max),
    "incomplete": ("scans_incomplete", sum),
    "refused": ("scans_refused", sum),
}
"""Keys of the totals of ``COUNTERS`` in the diagnostics, and how those of several nodes are combined."""


class DiagnosticsReceiver(GraphReceiver):
    """Receives only the diagnostics; a graph without them is silent."""

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        super()._on_diagnostics(message)
        self.received += 1

    def totals(self) -> dict[tuple[str, str], int]:
        """Return the newest totals by counter and node."""
        totals: dict[tuple[str, str], int] = {}
        for name, values in ((name, values_of(status)) for name, status in self.statuses.items()):
            node = name.partition(":")[0]
            totals |= {(counter, node): int(values[key]) for counter, (key, _) in TOTALS.items() if key in values}
        return totals

    def worst_status(self) -> str:
        """Return the worst of the newest statuses."""
        worst = max(self.statuses.values(), key=lambda status: status.level, default=None)
        return "no diagnostics received" if worst is None else f"{worst.name}: {worst.message}"


class GraphMeasurement:
    """Measures graphs; needs its own ROS domain, with ROS initialised. ``folder`` is that of the last run."""

    folder: Path

    def __init__(self, folder: Path, interrupted: Callable[[], bool] = lambda: False) -> None:
        """Prepare; each run writes into a folder in ``folder``."""
        self._folder, self._interrupted, self._runs = folder, interrupted, 0

    def measure_graph(self, load: GraphLoad, seconds: float) -> MeasuredRun:
        """Start a graph, measure it for some seconds, end it. Raises PosorError: a process failed, or no pose came."""
        rows, diagnostics = self._new_folder(load.name) / "received.npy", DiagnosticsReceiver("bench")
        arguments = f"/{load.arm.name}/{ENDPOINT_TOPIC}", str(rows), str(load.priority)
        receiver = ProgramCommand("receiver", "", str(latency_receiver.__file__), arguments)
        with running_graph([receiver], diagnostics, self.folder, "make bench", self._interrupted) as watch:
            (received,) = watch.running.values()
            _wait_for_line(watch, received, diagnostics, latency_receiver.READY)
            running = [watch.supervisor.start(program) for program in graph_programs(load, self.folder)]
            _wait_for_line(watch, received, diagnostics, latency_receiver.FIRST_POSE)
            browsers = []
            if load.page != "absent":
                view = ProgramCommand(VIEW, "posor_bringup", "view", (str(load.arm.path), "--port", "0"))
                running.append(watch.supervisor.start(view))
                address = _wait_for_line(watch, running[-1], diagnostics, "page at ").split(";")[0]
            if load.page == "shown":
                browser = ProgramCommand("browser", "", str(page_reader.__file__), (address,))
                browsers.append(watch.supervisor.start(browser))
                _wait_for_line(watch, browsers[0], diagnostics, page_reader.SHOWN)
            watch.wait_for(WARM_UP_S)
            before, begin_ns, begin = diagnostics.totals(), time.time_ns(), _take_samples(running)
            watch.wait_for(seconds)
            end_ns, end = time.time_ns(), _take_samples(running)
            watch.wait_for(SETTLING_S)
            grown = {place: total - before.get(place, 0) for place, total in diagnostics.totals().items()}
            watch.supervisor.end([*running, *browsers])  # before the receiver
        counters = {
            name: combine([0, *(growth for (counter, _), growth in grown.items() if counter == name)])
            for name, (_, combine) in TOTALS.items()
        }
        cores = {
            name: (end[name].used_s - used.used_s) / (end[name].seconds - used.seconds) for name, used in begin.items()
        }
        memory_mb = {name: sample.memory_mb for name, sample in end.items()}
        return evaluate_window(np.load(rows), TickWindow(begin_ns, end_ns, load.rate), counters, cores, memory_mb)

    def measure_empty_loop(self, rate: int, spin_us: int, seconds: float) -> dict[str, Any]:
        """Return how late an empty loop is for its ticks, see ``empty_loop``."""
        lateness = self._new_folder(f"empty_loop_{rate}_{spin_us}") / "lateness.json"
        loop = ProgramCommand("loop", "", str(empty_loop.__file__), (str(rate), str(spin_us), str(lateness)))
        diagnostics = DiagnosticsReceiver("bench")
        with running_graph([loop], diagnostics, self.folder, "make bench", self._interrupted) as watch:
            (running,) = watch.running.values()
            _wait_for_line(watch, running, diagnostics, empty_loop.READY)
            watch.wait_for(seconds, may_be_silent=True)
        return dict(json.loads(lateness.read_text(encoding="utf-8")))

    def _new_folder(self, name: str) -> Path:
        self._runs += 1
        self.folder = self._folder / f"{self._runs:02}_{name}"
        self.folder.mkdir(parents=True)
        return self.folder


def _wait_for_line(watch: GraphWatch, program: RunningProgram, diagnostics: DiagnosticsReceiver, text: str) -> str:
    """Wait until a program has printed a line that contains a text; return the rest of the line."""
    pattern = re.compile(f"{re.escape(text)}(.*)\n")
    found: re.Match[str] | None = None

    def has_line() -> bool:
        nonlocal found
        found = pattern.search(program.log.read_text(encoding="utf-8"))
        return found is not None

    watch.wait(
        has_line, lambda: f"the line '{text}' of {program.program.name} ({diagnostics.worst_status()})", START_TIMEOUT_S
    )
    return found[1] if found else ""


def _take_samples(running: Sequence[RunningProgram]) -> dict[str, ProcessSample]:
    return {each.program.name: ProcessSample.take(each.process.pid, time.monotonic()) for each in running}
