"""Asks the operating system for real-time treatment of this process, and says why where it is refused."""

from __future__ import annotations

import ctypes
import os
import resource
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from posor_estimator.errors import SystemRefusal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from posor_estimator.ros.parameters import RealtimeParameters

_MCL_CURRENT, _MCL_FUTURE = 1, 2
_CAP_IPC_LOCK = 14
_RLIMIT_RTPRIO = 14
"""Of Linux; Python's ``resource`` names it from 3.12 on."""


def ask_for(parameters: RealtimeParameters) -> list[SystemRefusal]:
    """Ask for what the parameters say, for all threads of the process; those that come later inherit it.

    Returns:
        What was refused; the process goes on without it.

    Raises:
        SystemRefusal: The first thing that was refused, where all of it is required.

    """
    refusals = []
    for ask in _asked(parameters):
        try:
            ask()
        except SystemRefusal as refusal:
            if parameters.required:
                raise
            refusals.append(refusal)
    return refusals


def _asked(parameters: RealtimeParameters) -> Iterator[Callable[[], None]]:
    if parameters.cpus:
        yield lambda: _keep_to(set(parameters.cpus))
    if parameters.priority:
        yield lambda: _prioritise(parameters.priority)
    if parameters.lock_memory:
        yield _lock_memory


def _each_thread(change: Callable[[int], None]) -> None:
    """Change every thread of the process, those too that one not yet changed begins meanwhile."""
    changed: set[int] = set()
    while new := {int(path.name) for path in Path("/proc/self/task").iterdir()} - changed:
        for thread in new:
            with suppress(ProcessLookupError):  # it has ended
                change(thread)
        changed |= new


def _keep_to(cpus: set[int]) -> None:
    before = os.sched_getaffinity(0)
    where = f"realtime.cpus [{_listed(cpus)}]"
    try:
        _each_thread(lambda thread: os.sched_setaffinity(thread, cpus))
    except OSError as error:
        expected = f"some of [{_listed(before)}], which this process may use"
        raise SystemRefusal(_reason(error), where=where, expected=expected) from None
    # The kernel leaves out processors that there are not, without a word.
    if (got := os.sched_getaffinity(0)) != cpus:
        _each_thread(lambda thread: os.sched_setaffinity(thread, before))
        raise SystemRefusal(
            f"the system gives no processor {_listed(cpus - got)}", where=where, expected=f"some of [{_listed(before)}]"
        )


def _prioritise(priority: int) -> None:
    try:
        _each_thread(lambda thread: os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority)))
    except OSError as error:
        limit, _ = resource.getrlimit(_RLIMIT_RTPRIO)
        raise SystemRefusal(
            _reason(error),
            where=f"realtime.priority {priority}",
            expected=f"the capability CAP_SYS_NICE, or a limit of the real-time priority (ulimit -r, now {limit}) "
            f"of at least {priority}",
        ) from None


def _lock_memory() -> None:
    # Within a limit the call would succeed, and an allocation fail later.
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if limit != resource.RLIM_INFINITY and not _may_lock_all():
        raise _no_lock(f"only {limit // 1024} KiB may be locked")
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(_MCL_CURRENT | _MCL_FUTURE):
        code = ctypes.get_errno()
        raise _no_lock(_reason(OSError(code, os.strerror(code))))


def _no_lock(reason: str) -> SystemRefusal:
    return SystemRefusal(
        reason,
        where="realtime.lock_memory",
        expected="the capability CAP_IPC_LOCK, or no limit of locked memory (ulimit -l unlimited)",
    )


def _may_lock_all() -> bool:
    status = Path("/proc/self/status").read_text(encoding="utf-8", errors="replace")
    effective = next(line.split()[1] for line in status.splitlines() if line.startswith("CapEff:"))
    return bool(int(effective, 16) >> _CAP_IPC_LOCK & 1)


def _reason(error: OSError) -> str:
    return f"the system refuses it, {(error.strerror or 'for no reason').lower()}"


def _listed(cpus: set[int]) -> str:
    return ", ".join(map(str, sorted(cpus)))
