# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Statistics of a measured time window (latencies, lost ticks), and the host on which the benchmark runs."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.errors import PosorError
from posor.numerics.compiled import MODE
from posor.numerics.stamps import first_tick_after, tick_stamp_ns
from rclpy.utilities import get_rmw_implementation_identifier
from scipy.stats import quantile_test

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from posor.numerics.array_types import IntArray


def host_description() -> dict[str, Any]:
    """Return hardware, versions and the present load average."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    processors = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return {
        "cores": len(os.sched_getaffinity(0)),
        "processor": next(processors, platform.machine()),
        "kernel": platform.release(),
        "python": platform.python_version(),
        "rmw": get_rmw_implementation_identifier(),
        "kernels": MODE,
        "load": os.getloadavg()[0],
    }


def stolen_s() -> float:
    """Return the time [s] since boot in which the host of this virtual machine ran others instead."""
    stolen = int(Path("/proc/stat").read_text(encoding="ascii").split(maxsplit=9)[8])
    return stolen / os.sysconf("SC_CLK_TCK")


STAMP, PUBLISHED, RECEIVED, NUMBER = range(4)  # columns of the rows that ``latency_receiver`` writes
PERCENTILES = {"p50_us": 50.0, "p99_us": 99.0, "p999_us": 99.9, "max_us": 100.0}
COUNTERS = ("ticks_missed", "incomplete", "refused")
"""Ticks missed by a driver, the largest of all drivers; scans without a joint; scans refused by the chain."""
USAGE = ("cpu_cores", "memory_mb")


class NothingReceivedError(PosorError):
    """No pose was received in the measured time."""


def percentiles_us(times_ns: IntArray) -> dict[str, float]:
    """Return the percentiles of ``PERCENTILES`` of times [ns] in us."""
    return {name: float(np.percentile(times_ns, share)) / 1e3 for name, share in PERCENTILES.items()}


@dataclass(frozen=True)
class TickWindow:
    """The measured time: from ``begin_ns`` to before ``end_ns`` of the ROS clock, with ticks at ``rate`` [Hz]."""

    begin_ns: int
    end_ns: int
    rate: int

    @property
    def stamps_ns(self) -> IntArray:
        """Stamps of all its ticks [ns], (n,)."""
        first, last = (first_tick_after(end - 1, self.rate) for end in (self.begin_ns, self.end_ns))
        return tick_stamp_ns(np.arange(first, last), self.rate)


@dataclass(frozen=True)
class MeasuredRun:
    """Measurements of one window."""

    latencies_ns: IntArray  # from the stamp of each pose to its reception, (n,)
    published_ns: IntArray  # from the stamp of each pose to its publication, (n,)
    expected: int  # number of ticks in the window
    not_received: int  # number of poses that were published but not received
    counters: Mapping[str, int]  # growth of ``COUNTERS`` of the nodes over the window and a little more
    cpu_cores: Mapping[str, float]  # processor time of each process [s/s]
    memory_mb: Mapping[str, float]  # resident memory of each process

    @property
    def lost(self) -> int:
        """Number of ticks without a received pose."""
        return self.expected - len(self.latencies_ns)


def evaluate_window(
    rows: IntArray,
    window: TickWindow,
    counters: Mapping[str, int],
    cpu_cores: Mapping[str, float],
    memory_mb: Mapping[str, float],
) -> MeasuredRun:
    """Return the measurements of a window from rows (n, 4) of ``latency_receiver``; rows outside are ignored.

    Raises NothingReceivedError: there is no pose. Raises PosorError: a pose has the stamp of no tick, or two poses have
    the same stamp.
    """
    ticks = window.stamps_ns
    inside = rows[(rows[:, STAMP] >= window.begin_ns) & (rows[:, STAMP] < window.end_ns)]
    stamps, numbers, where = inside[:, STAMP], inside[:, NUMBER], "endpoint/pose"
    if not len(inside):
        raise NothingReceivedError("no pose came in the measured time", where=where, expected=f"{len(ticks)}")
    stray = stamps[~np.isin(stamps, ticks)]
    if len(stray):
        raise PosorError(f"stamp {stray[0]} ns", where=where, expected=f"a tick of {window.rate} Hz")
    if len(np.unique(stamps)) != len(stamps):
        raise PosorError("two poses have the same stamp", where=where, expected="one for each tick")
    return MeasuredRun(
        latencies_ns=inside[:, RECEIVED] - stamps,
        published_ns=inside[:, PUBLISHED] - stamps,
        expected=len(ticks),
        not_received=int(numbers[-1] - numbers[0]) + 1 - len(numbers),
        counters=counters,
        cpu_cores=cpu_cores,
        memory_mb=memory_mb,
    )


def run_figures(runs: Sequence[MeasuredRun]) -> dict[str, Any]:
    """Return the figures of several runs of the same graph as if they were one run."""
    published = percentiles_us(np.concatenate([run.published_ns for run in runs]))
    latencies_ns = np.concatenate([run.latencies_ns for run in runs])
    lost, not_received = sum(run.lost for run in runs), sum(run.not_received for run in runs)
    processes = {
        process: {name: float(np.mean([getattr(run, name)[process] for run in runs])) for name in USAGE}
        for process in runs[0].cpu_cores
    }
    return {
        **percentiles_us(latencies_ns),
        **{f"published_{name}": published[name] for name in ("p50_us", "p99_us")},
        "expected": sum(run.expected for run in runs),
        "received": len(latencies_ns),
        "lost": lost,
        "not_received": not_received,
        "not_published": lost - not_received,
        **{name: sum(run.counters[name] for run in runs) for name in COUNTERS},
        **{name: sum(process[name] for process in processes.values()) for name in USAGE},
        "processes": processes,
    }


def paired_p99_ratio(pairs: Iterable[tuple[IntArray, IntArray]]) -> dict[str, float | None]:
    """Return the ratio of the p99 of the times of a run to that of another one, measured next to it.

    Of all pairs: the ``median``, and its 95 % interval from ``low`` to ``high``, which supposes nothing of the
    distribution; None: fewer than six pairs have no interval.
    """
    ratios = [float(np.percentile(run_ns, 99.0) / np.percentile(other_ns, 99.0)) for run_ns, other_ns in pairs]
    interval: Any = quantile_test(ratios, p=0.5).confidence_interval(0.95)
    low, high = (float(end) if np.isfinite(end) else None for end in interval)
    return {"median": float(np.median(ratios)), "low": low, "high": high}
