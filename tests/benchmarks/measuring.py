"""Runs a graph or its floor for a while and measures it from outside."""

from __future__ import annotations

import json
import os
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from posor_bringup.supervisor import ProcessError, Script, Supervisor
from posor_estimator.ros.qos import DIAGNOSTICS_TOPIC, ENDPOINT_TOPIC
from posor_estimator.testing.graph import Graph, values_of
from rclpy.serialization import deserialize_message

from tests.benchmarks import alone, receiver
from tests.benchmarks.accounts import COUNTERS, Run, Window, account
from tests.benchmarks.layouts import Load, processes

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from posor_bringup.supervisor import RunningProgram

START_S = 60.0
"""Within this time the first pose must come."""
WARM_UP_S = 1.0
AFTERWARDS_S = 1.2
"""For what is on its way, and for the diagnostics that tell of the window's end."""
COUNTED: Mapping[str, Callable[[Sequence[int]], int]] = {
    "ticks_missed": max,
    "scans_incomplete": sum,
    "scans_refused": sum,
}
"""Values in the diagnostics that are totals, and how those of several nodes make one."""
MEGA = 1e6


class Bench:
    """Measures, in a folder for everything that this makes; the environment must lead to a ROS domain of its own.

    Attributes:
        folder: Of the last run.

    """

    folder: Path

    def __init__(self, folder: Path, graph: Graph, interrupted: Callable[[], bool] = lambda: False) -> None:
        self._folder = folder
        self._interrupted = interrupted
        self._graph = graph
        self._diagnostics: list[bytes] = graph.collect(DiagnosticArray, DIAGNOSTICS_TOPIC, raw=True)
        self._number = 0

    def run(self, load: Load, seconds: float) -> Run:
        """Start a load, measure for some seconds, end everything.

        Raises:
            PosorError: A process ended, or no pose came.

        """
        self._number += 1
        self.folder = folder = self._folder / f"{self._number:02}_{load.name}"
        folder.mkdir(parents=True)
        noted = folder / "received.npy"
        with Supervisor(folder) as supervisor:
            ear = supervisor.start(
                Script("receiver", "", str(receiver.__file__), (f"/{load.arm.name}/{ENDPOINT_TOPIC}", str(noted)))
            )
            self._until(supervisor, lambda: receiver.READY in ear.log.read_text(), "the receiver")
            running = [supervisor.start(program) for program in processes(load, folder)]
            self._until(supervisor, lambda: receiver.FIRST in ear.log.read_text(), "the first pose")
            self._pass(supervisor, WARM_UP_S)
            totals, begin = self._totals(), _Look(running)
            self._pass(supervisor, seconds)
            end = _Look(running)
            self._pass(supervisor, AFTERWARDS_S)
            counted = _difference(totals, self._totals())
            supervisor.end(running)
            supervisor.end([ear])
        window = Window(begin.time_ns, end.time_ns, load.rate)
        return account(np.load(noted), window, counted, begin.cores_until(end), end.memory_mb)

    def alone(self, rate: int, spin_us: int, seconds: float) -> dict[str, Any]:
        """Return how late the machine is for ticks when nothing is done, see ``alone``."""
        self._number += 1
        folder = self._folder / f"{self._number:02}_alone_{rate}_{spin_us}"
        folder.mkdir(parents=True)
        found = folder / "lateness.json"
        with Supervisor(folder) as supervisor:
            program = supervisor.start(Script("alone", "", str(alone.__file__), (str(rate), str(spin_us), str(found))))
            self._until(supervisor, lambda: alone.READY in program.log.read_text(), "the first tick")
            self._pass(supervisor, seconds)
            supervisor.end([program])
        return dict(json.loads(found.read_text(encoding="utf-8")))

    def _until(self, supervisor: Supervisor, condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + START_S
        while not condition():
            if time.monotonic() > deadline:
                raise ProcessError(
                    f"{what} did not come within {START_S:g} s ({self._complaint()})", where="make bench"
                )
            self._look(supervisor)

    def _pass(self, supervisor: Supervisor, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self._look(supervisor)

    def _look(self, supervisor: Supervisor) -> None:
        """Let a short time pass, or a message come."""
        supervisor.check()
        if self._interrupted():
            raise ProcessError("interrupted", where="make bench")
        self._graph.receive()

    def _complaint(self) -> str:
        """Return the newest of the worst that the nodes say of themselves."""
        newest = reversed(self._diagnostics)
        said = [status for data in newest for status in deserialize_message(data, DiagnosticArray).status]
        worst = max(said, key=lambda status: status.level, default=None)
        return "no node says anything" if worst is None else f"{worst.name}: {worst.message}"

    def _totals(self) -> dict[tuple[str, str], int]:
        """Return the newest totals told in the diagnostics, by node and name."""
        totals: dict[tuple[str, str], int] = {}
        for data in self._diagnostics:
            for status in deserialize_message(data, DiagnosticArray).status:
                node = status.name.partition(":")[0]
                told = values_of(status)
                totals |= {(node, name): int(told[name]) for name in COUNTED if name in told}
        self._diagnostics.clear()
        return totals


def _difference(before: Mapping[tuple[str, str], int], after: Mapping[tuple[str, str], int]) -> dict[str, int]:
    """Return by how much the totals have grown, those of several nodes made one."""
    grown = {name: [0] for name in COUNTED}
    for (node, name), total in after.items():
        grown[name].append(total - before.get((node, name), 0))
    return dict(zip(COUNTERS, (made_one(grown[name]) for name, made_one in COUNTED.items()), strict=True))


class _Look:
    """What the system knows of processes at one moment."""

    def __init__(self, running: Sequence[RunningProgram]) -> None:
        self.time_ns = time.time_ns()
        self._steady_s = time.monotonic()
        self._used_s = {started.program.name: _processor_s(started.process.pid) for started in running}
        self.memory_mb = {started.program.name: _memory_mb(started.process.pid) for started in running}

    def cores_until(self, later: _Look) -> dict[str, float]:
        """Return the processor time [s/s] of each process between two looks."""
        seconds = later._steady_s - self._steady_s
        return {name: (later._used_s[name] - used) / seconds for name, used in self._used_s.items()}


def _processor_s(pid: int) -> float:
    """Return the processor time of a process, user and system [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


def _memory_mb(pid: int) -> float:
    """Return the resident memory of a process [MB]."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    (kilobytes,) = re.findall(r"VmRSS:\s+(\d+) kB", status)
    return int(kilobytes) * 1024 / MEGA
