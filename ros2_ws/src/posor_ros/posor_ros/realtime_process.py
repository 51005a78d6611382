# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Real-time settings of this process, and its health: refused settings and pauses of the garbage collector."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import sys
from contextlib import suppress
from pathlib import Path
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any

from posor.errors import SystemRefusal

from posor_ros.diagnostics import Level

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from posor.errors import PosorError
    from posor.node_parameters import LimitParameters, RealtimeParameters

    from posor_ros.diagnostics import Status

PROCESS_STATUS = "process"  # name of the status line
SWITCH_INTERVAL_S = 1e-4
"""How long one Python thread may hold up another one. Python's default of 5 ms is ten periods at 2 kHz; below this
value busy threads lose time by switching."""

_MCL_CURRENT, _MCL_FUTURE = 1, 2
_CAP_IPC_LOCK = 14
_RLIMIT_RTPRIO = 14  # constant of Linux; Python's ``resource`` has it from 3.12 on


def apply_realtime_parameters(parameters: RealtimeParameters) -> list[SystemRefusal]:
    """Apply the settings to all threads of the process; later threads inherit them. Return the refused settings.

    Raises SystemRefusal: the first refusal, if all settings are required.
    """
    refusals = []
    for apply in _requested_settings(parameters):
        try:
            apply()
        except SystemRefusal as refusal:
            if parameters.required:
                raise
            refusals.append(refusal)
    return refusals


def _requested_settings(parameters: RealtimeParameters) -> Iterator[Callable[[], None]]:
    if parameters.cpus:
        yield lambda: _set_cpus(set(parameters.cpus))
    if parameters.priority:
        yield lambda: _set_priority(parameters.priority)
    if parameters.lock_memory:
        yield _lock_memory


def _for_each_thread(change: Callable[[int], None]) -> None:
    """Change every thread of the process, including threads that an unchanged thread starts meanwhile."""
    changed: set[int] = set()
    while new := {int(path.name) for path in Path("/proc/self/task").iterdir()} - changed:
        for thread in new:
            with suppress(ProcessLookupError):  # the thread has ended
                change(thread)
        changed |= new


def _set_cpus(cpus: set[int]) -> None:
    before = os.sched_getaffinity(0)
    where = f"realtime.cpus [{_cpu_list(cpus)}]"
    try:
        _for_each_thread(lambda thread: os.sched_setaffinity(thread, cpus))
    except OSError as error:
        expected = f"some of [{_cpu_list(before)}], which this process may use"
        raise SystemRefusal(_reason(error), where=where, expected=expected) from None
    # Linux silently leaves out processors that do not exist.
    if (granted := os.sched_getaffinity(0)) != cpus:
        _for_each_thread(lambda thread: os.sched_setaffinity(thread, before))
        raise SystemRefusal(
            f"the system has no processor {_cpu_list(cpus - granted)}",
            where=where,
            expected=f"some of [{_cpu_list(before)}]",
        )


def _set_priority(priority: int) -> None:
    try:
        _for_each_thread(lambda thread: os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority)))
    except OSError as error:
        limit, _ = resource.getrlimit(_RLIMIT_RTPRIO)
        raise SystemRefusal(
            _reason(error),
            where=f"realtime.priority {priority}",
            expected=f"the capability CAP_SYS_NICE, or a limit of the real-time priority (ulimit -r, now {limit}) "
            f"of at least {priority}",
        ) from None


def _lock_memory() -> None:
    expected = "the capability CAP_IPC_LOCK, or no limit of locked memory (ulimit -l unlimited)"
    # Below the limit mlockall would succeed, and a later allocation would fail.
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if limit != resource.RLIM_INFINITY and not _has_capability(_CAP_IPC_LOCK):
        reason = f"only {limit // 1024} KiB may be locked"
        raise SystemRefusal(reason, where="realtime.lock_memory", expected=expected)
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(_MCL_CURRENT | _MCL_FUTURE):
        code = ctypes.get_errno()
        reason = _reason(OSError(code, os.strerror(code)))
        raise SystemRefusal(reason, where="realtime.lock_memory", expected=expected)


def _has_capability(number: int) -> bool:
    status = Path("/proc/self/status").read_text(encoding="utf-8", errors="replace")
    effective = next(line.split()[1] for line in status.splitlines() if line.startswith("CapEff:"))
    return bool(int(effective, 16) >> number & 1)


def _reason(error: OSError) -> str:
    return f"the system refuses it, {(error.strerror or 'for no reason').lower()}"


def _cpu_list(cpus: set[int]) -> str:
    return ", ".join(map(str, sorted(cpus)))


def prepare_heap() -> None:
    """Collect garbage and freeze the heap before the first scan, so that later collections are short."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.collect()
    gc.freeze()


class ProcessHealth:
    """The status line of the process, reported by one of its nodes: refused settings, collections and their pauses."""

    def __init__(self, status: Status, refusals: Sequence[PosorError], limits: Callable[[], LimitParameters]) -> None:
        """Count garbage collections from now on; ``limits`` returns the limits in force."""
        self._status = status
        self._refusals = " ".join(map(str, refusals))
        self._limits = limits
        self._collections = self._begun_ns = self._longest_ns = 0
        gc.callbacks.append(self._on_collection)
        self.report()

    def _on_collection(self, phase: str, _info: dict[str, Any]) -> None:
        if phase == "start":
            self._begun_ns = perf_counter_ns()
            return
        self._collections += 1
        self._longest_ns = max(self._longest_ns, perf_counter_ns() - self._begun_ns)

    def report(self) -> None:
        """Report the collections so far, and the longest pause since the last call."""
        longest_s, self._longest_ns = self._longest_ns * 1e-9, 0
        limit_s = self._limits().pause
        warnings = [self._refusals] if self._refusals else []
        if longest_s > limit_s:
            warnings.append(f"the garbage collector stopped the process for more than {limit_s:g} s")
        values = {"gc_collections": self._collections, "gc_longest_pause": longest_s}
        self._status.report(Level.WARN if warnings else Level.OK, " ".join(warnings) or "ok", values)

    def close(self) -> None:
        """Stop counting."""
        gc.callbacks.remove(self._on_collection)
