"""What a process asks of the system, and the sentences where it is refused; right where the system permits it, too."""

from __future__ import annotations

import gc
import json
import subprocess
import sys
from textwrap import dedent
from typing import Any

import pytest
from posor_estimator.errors import PosorError
from posor_estimator.ros.diagnostics import Level
from posor_estimator.ros.parameters import LimitParameters
from posor_estimator.ros.process import SWITCH_S, ProcessHealth, settle

ASK = """
    import ctypes, json, os, resource, sys
    from pathlib import Path
    from threading import Event, Thread
    from posor_estimator.errors import SystemRefusal
    from posor_estimator.ros.parameters import RealtimeParameters
    from posor_estimator.ros.realtime import ask_for

    asked, weaken = json.loads(sys.argv[1]), sys.argv[2] == "weak"
    there = sorted(os.sched_getaffinity(0))
    done = Event()
    before = Thread(target=done.wait, daemon=True)
    before.start()
    if weaken:
        resource.setrlimit(14, (0, 0))  # RLIMIT_RTPRIO
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
        if os.geteuid() == 0:
            os.setresuid(65534, 65534, 65534)  # drops the capabilities
    try:
        refused = [str(refusal) for refusal in ask_for(RealtimeParameters(**asked))]
        raised = None
    except SystemRefusal as refusal:
        refused, raised = [], str(refusal)
    later = []
    after = Thread(target=lambda: later.append((os.sched_getscheduler(0), sorted(os.sched_getaffinity(0)))))
    after.start()
    after.join()
    threads = [os.getpid(), before.native_id]
    locked = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmLck"))
    print(json.dumps({
        "there": there,
        "refused": refused,
        "raised": raised,
        "fifo": [os.sched_getscheduler(thread) == os.SCHED_FIFO for thread in threads],
        "cpus": [sorted(os.sched_getaffinity(thread)) for thread in threads],
        "later": later[0],
        "locked": int(locked.split()[1]),
    }))
    done.set()
"""


def asked(*, weak: bool = False, **parameters: Any) -> dict[str, Any]:
    """Ask in a process of its own, which may give up its rights before, and return what became of it."""
    command = [sys.executable, "-c", dedent(ASK), json.dumps(parameters), "weak" if weak else "as it is"]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert result.stderr == ""
    told: dict[str, Any] = json.loads(result.stdout)
    return told


def test_nothing_is_asked_for_unless_told_to() -> None:
    told = asked(weak=True, required=True)
    assert (told["refused"], told["raised"]) == ([], None)
    assert not any(told["fifo"])
    assert told["locked"] == 0


def test_priority_is_given_to_all_threads_or_refused_with_its_reason() -> None:
    told = asked(priority=3)
    if told["refused"]:
        (sentence,) = told["refused"]
        assert sentence.startswith("realtime.priority 3: the system refuses it, ")
        assert not any(told["fifo"])
    else:
        assert all(told["fifo"])
        assert told["later"][0] == 1  # SCHED_FIFO


def test_processors_are_kept_to_by_all_threads() -> None:
    first = asked()["there"][0]
    told = asked(cpus=[first], required=True)
    assert told["raised"] is None
    assert told["cpus"] == [[first]] * len(told["cpus"])
    assert told["later"][1] == [first]


def test_memory_is_locked_or_refused_with_its_reason() -> None:
    told = asked(lock_memory=True)
    if told["refused"]:
        (sentence,) = told["refused"]
        assert sentence.startswith("realtime.lock_memory: ")
    else:
        assert told["locked"] > 1000


def test_a_processor_that_there_is_not_is_refused_and_nothing_changes() -> None:
    there = asked()["there"]
    text = ", ".join(map(str, there))
    told = asked(cpus=[there[0], 1000])
    assert told["refused"] == [
        f"realtime.cpus [{there[0]}, 1000]: the system gives no processor 1000; expected some of [{text}]."
    ]
    assert told["cpus"] == [there] * len(told["cpus"])
    told = asked(cpus=[1000], required=True)
    assert told["raised"] == (
        f"realtime.cpus [1000]: the system refuses it, invalid argument; "
        f"expected some of [{text}], which this process may use."
    )


def test_a_user_without_rights_is_told_which_are_missing() -> None:
    told = asked(weak=True, priority=80, lock_memory=True)
    priority, memory = told["refused"]
    assert priority == (
        "realtime.priority 80: the system refuses it, operation not permitted; expected the capability CAP_SYS_NICE, "
        "or a limit of the real-time priority (ulimit -r, now 0) of at least 80."
    )
    assert memory == (
        "realtime.lock_memory: only 64 KiB may be locked; "
        "expected the capability CAP_IPC_LOCK, or no limit of locked memory (ulimit -l unlimited)."
    )
    assert not any(told["fifo"])
    assert told["locked"] == 0
    assert asked(weak=True, priority=80, required=True)["raised"] == priority


class Line:
    """Takes what a status line would be told."""

    def report(self, level: Level, message: str, values: dict[str, Any]) -> None:
        self.told = (level, message)
        self.values = values


@pytest.fixture
def line() -> Any:
    return Line()


def test_pauses_of_the_garbage_collector_are_counted_and_the_longest_told(line: Any) -> None:
    health = ProcessHealth(line, [], lambda: LimitParameters(pause=1e-9))
    try:
        assert line.told == (Level.OK, "ok")
        before = line.values["gc_collections"]
        gc.collect()
        health.report()
        assert line.told == (Level.WARN, "the garbage collector held the process up for more than 1e-09 s")
        assert line.values["gc_collections"] > before
        assert 0.0 < line.values["gc_longest_pause"] < 60.0
    finally:
        health.close()
    count = line.values["gc_collections"]
    gc.collect()
    health.report()
    assert line.values == {"gc_collections": count, "gc_longest_pause": 0.0}


def test_what_was_refused_stays_in_the_diagnostics(line: Any) -> None:
    refusals = [PosorError("is refused", where="a"), PosorError("too", where="b")]
    health = ProcessHealth(line, refusals, LimitParameters)
    health.report()
    health.close()
    assert line.told == (Level.WARN, "a: is refused. b: too.")


def test_what_is_there_at_the_start_is_no_longer_looked_at_for_garbage() -> None:
    before = sys.getswitchinterval()
    try:
        settle()
        assert gc.get_freeze_count() > 1000
        assert sys.getswitchinterval() == pytest.approx(SWITCH_S)
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)
