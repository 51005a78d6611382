# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Real-time settings of a process, and the errors where the system refuses them; valid with and without permission."""

from __future__ import annotations

import gc
import json
import subprocess
import sys
from textwrap import dedent
from typing import Any
from unittest.mock import Mock

import pytest
from posor.errors import PosorError
from posor.node_parameters import LimitParameters
from posor_ros.diagnostics import Level
from posor_ros.realtime_process import SWITCH_INTERVAL_S, ProcessHealth, prepare_heap

APPLY_IN_PROCESS = """
    import ctypes, json, os, resource, sys
    from pathlib import Path
    from threading import Event, Thread
    from posor.errors import SystemRefusal
    from posor.node_parameters import RealtimeParameters
    from posor_ros.realtime_process import apply_realtime_parameters

    settings, drop_capabilities = json.loads(sys.argv[1]), sys.argv[2] == "unprivileged"
    available = sorted(os.sched_getaffinity(0))
    done = Event()
    before = Thread(target=done.wait, daemon=True)
    before.start()
    if drop_capabilities:
        resource.setrlimit(14, (0, 0))  # RLIMIT_RTPRIO
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
        if os.geteuid() == 0:
            os.setresuid(65534, 65534, 65534)  # drops the capabilities
    try:
        refused = [str(refusal) for refusal in apply_realtime_parameters(RealtimeParameters(**settings))]
        raised = None
    except SystemRefusal as refusal:
        refused, raised = [], str(refusal)
    later_threads = []
    after = Thread(target=lambda: later_threads.append((os.sched_getscheduler(0), sorted(os.sched_getaffinity(0)))))
    after.start()
    after.join()
    threads = [os.getpid(), before.native_id]
    locked = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmLck"))
    print(json.dumps({
        "available": available,
        "refused": refused,
        "raised": raised,
        "fifo": [os.sched_getscheduler(thread) == os.SCHED_FIFO for thread in threads],
        "cpus": [sorted(os.sched_getaffinity(thread)) for thread in threads],
        "later": later_threads[0],
        "locked": int(locked.split()[1]),
    }))
    done.set()
"""


def apply_settings(*, unprivileged: bool = False, **parameters: Any) -> dict[str, Any]:
    """Apply settings in a new process, which may drop its capabilities before; return the results."""
    command = [
        sys.executable,
        "-c",
        dedent(APPLY_IN_PROCESS),
        json.dumps(parameters),
        "unprivileged" if unprivileged else "privileged",
    ]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert result.stderr == ""
    results: dict[str, Any] = json.loads(result.stdout)
    return results


def test_no_setting_is_applied_by_default() -> None:
    results = apply_settings(unprivileged=True, required=True)
    assert (results["refused"], results["raised"]) == ([], None)
    assert not any(results["fifo"])
    assert results["locked"] == 0


def test_the_priority_is_set_for_all_threads_or_refused_with_the_reason() -> None:
    results = apply_settings(priority=3)
    if results["refused"]:
        (sentence,) = results["refused"]
        assert sentence.startswith("realtime.priority 3: the system refuses it, ")
        assert not any(results["fifo"])
    else:
        assert all(results["fifo"])
        assert results["later"][0] == 1  # SCHED_FIFO


def test_all_threads_are_restricted_to_the_processors() -> None:
    first = apply_settings()["available"][0]
    results = apply_settings(cpus=[first], required=True)
    assert results["raised"] is None
    assert results["cpus"] == [[first]] * len(results["cpus"])
    assert results["later"][1] == [first]


def test_memory_is_locked_or_refused_with_the_reason() -> None:
    results = apply_settings(lock_memory=True)
    if results["refused"]:
        (sentence,) = results["refused"]
        assert sentence.startswith("realtime.lock_memory: ")
    else:
        assert results["locked"] > 1000


def test_an_unknown_processor_is_refused_and_nothing_changes() -> None:
    available = apply_settings()["available"]
    text = ", ".join(map(str, available))
    results = apply_settings(cpus=[available[0], 1000])
    assert results["refused"] == [
        f"realtime.cpus [{available[0]}, 1000]: the system has no processor 1000; expected some of [{text}]."
    ]
    assert results["cpus"] == [available] * len(results["cpus"])
    results = apply_settings(cpus=[1000], required=True)
    assert results["raised"] == (
        f"realtime.cpus [1000]: the system refuses it, invalid argument; "
        f"expected some of [{text}], which this process may use."
    )


def test_an_unprivileged_user_reads_which_capabilities_are_missing() -> None:
    results = apply_settings(unprivileged=True, priority=80, lock_memory=True)
    priority, memory = results["refused"]
    assert priority == (
        "realtime.priority 80: the system refuses it, operation not permitted; expected the capability CAP_SYS_NICE, "
        "or a limit of the real-time priority (ulimit -r, now 0) of at least 80."
    )
    assert memory == (
        "realtime.lock_memory: only 64 KiB may be locked; "
        "expected the capability CAP_IPC_LOCK, or no limit of locked memory (ulimit -l unlimited)."
    )
    assert not any(results["fifo"])
    assert results["locked"] == 0
    assert apply_settings(unprivileged=True, priority=80, required=True)["raised"] == priority


@pytest.fixture
def status() -> Mock:
    return Mock()


def test_garbage_collections_and_their_longest_pause_are_reported(status: Mock) -> None:
    health = ProcessHealth(status, [], lambda: LimitParameters(pause=1e-9))
    try:
        assert status.report.call_args.args[:2] == (Level.OK, "ok")
        before = status.report.call_args.args[2]["gc_collections"]
        gc.collect()
        health.report()
        assert status.report.call_args.args[:2] == (
            Level.WARN,
            "the garbage collector stopped the process for more than 1e-09 s",
        )
        assert status.report.call_args.args[2]["gc_collections"] > before
        assert 0.0 < status.report.call_args.args[2]["gc_longest_pause"] < 60.0
    finally:
        health.close()
    count = status.report.call_args.args[2]["gc_collections"]
    gc.collect()
    health.report()
    assert status.report.call_args.args[2] == {"gc_collections": count, "gc_longest_pause": 0.0}


def test_refused_settings_stay_in_the_diagnostics(status: Mock) -> None:
    refusals = [PosorError("is refused", where="a"), PosorError("too", where="b")]
    health = ProcessHealth(status, refusals, LimitParameters)
    health.report()
    health.close()
    assert status.report.call_args.args[:2] == (Level.WARN, "a: is refused. b: too.")


def test_prepare_heap_freezes_the_present_objects() -> None:
    before = sys.getswitchinterval()
    try:
        prepare_heap()
        assert gc.get_freeze_count() > 1000
        assert sys.getswitchinterval() == pytest.approx(SWITCH_INTERVAL_S)
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)
