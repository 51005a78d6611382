# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Run the linters and the tests in parallel processes, and print one line for each.

The files of an entry of SHARED have one pytest process, which saves seconds of imports for each file; those that start
nodes or servers share the processes of REAL_TIME_SHARED, of which two run at a time. The others and the linters run at
low priority in the processor time that these tests leave while they wait; a process that has no such job left runs
tests in real time, and the reverse. Those of SLOW come first, so that none of them is left for the end. The linters
need no build and start before it. Every process uses one thread of linear algebra, because threads of small matrices
wait for each other.
The output ends with every skipped or failed test and its reason, and ``N passed, N failed, N skipped``.
Arguments: paths of tests; without paths, the linters and all tests run. Tests with the marker ``long`` are left out;
with the option ``--long`` they alone run.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import signal
import subprocess
import textwrap
import threading
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

from environment import THIS, SetupError, exit_with, workspace_environment
from setup_workspace import set_up

PROCESSES = min(2, os.cpu_count() or 1)  # of each priority
LOW_PRIORITY = 4  # nice value
NO_TESTS = 5  # pytest's exit code
PROCESS_TIMEOUT_S = 900.0  # in addition to pytest's own timeout for each test
LONG_TIMEOUT_S = 3600  # of a test with --long
LONG_PROCESS_TIMEOUT_S = 4 * 3600.0  # several such tests share a process
INTERRUPT_TIMEOUT_S = 20.0  # for an interrupted pytest to stop the nodes of its tests
DEFAULTS = {  # the caller's own settings have precedence
    "OPENBLAS_NUM_THREADS": "1",  # numpy and scipy
    "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",  # all but pytest-timeout, whose imports take half of the start of pytest
}
FAILURE_LENGTH = 1000  # last characters of a failure, in the summary; the whole is printed when its job ends
REPORTS = THIS.root / "build" / "test"
REAL_TIME = re.compile(
    r"rclpy\.init|\bContext\(|ros_context|ros_domain|isolated_network|harness\.graph|rig_replay|\bProgram\("
    r"|posor_lab\.device_servers|\bsocketserver\b"
)
SHARED = tuple(  # folders, or files of a folder, that share a process, except those in real time; the first counts
    THIS.root / pattern
    for pattern in (
        *("ros2_ws/src/posor/test/estimation", "ros2_ws/src/posor/test"),
        *("ros2_ws/src/posor_[bc]*/test", "ros2_ws/src/posor_design/test", "ros2_ws/src/posor_[der]*/test"),
        *(f"lab/posor_lab/test/[{letters}]*" for letters in ("a-b", "c-e", "f-z")),
        *(f"tests/test_[{letters}]*.py" for letters in ("a-c", "d-o", "p-z")),
    )
)
REAL_TIME_SHARED = tuple(  # the same for files that start nodes or servers: each test ends what it has started
    THIS.root / pattern
    for pattern in (
        *("ros2_ws/src/posor_drivers/test/instruments", "ros2_ws/src/posor_[bdr]*/test"),
        *(f"ros2_ws/src/posor_estimator/test/test_[{letters}]*.py" for letters in ("a-e", "f-z")),
        *(f"tests/test_[{letters}]*.py" for letters in ("a-e", "f-q", "r-s", "t-z")),
        "lab/posor_lab/test/*/test_*.py",
    )
)


SLOW = (
    "ros2_ws/src/posor_drivers/test/instruments",
    "lab/posor_lab/test/[f-z]*",
    "tests/test_[r-s]*.py",
    "ros2_ws/src/posor_[der]*/test",
    "tests/test_[t-z]*.py",
    "ros2_ws/src/posor_[bc]*/test",
    "tests/test_[a-e]*.py",
    "lab/posor_lab/test/[a-b]*",
    "ros2_ws/src/posor_[bdr]*/test",
    "ros2_ws/src/posor/test",
    "tests/test_[f-q]*.py",
    "lab/posor_lab/test/[c-e]*",
    "ros2_ws/src/posor_estimator/test/test_[f-z]*.py",
    "ros2_ws/src/posor_design/test",
    "tests/test_[p-z]*.py",
    "ros2_ws/src/posor_estimator/test/test_[a-e]*.py",
    "tests/test_[d-o]*.py",
    "lab/posor_lab/test/*/test_*.py",
    "tests/test_[a-c]*.py",
    "ros2_ws/src/posor/test/estimation",
)
"""Files and entries of SHARED and REAL_TIME_SHARED, those with most processor time first; instruments wait longest."""


@dataclass
class Job:
    """A process that runs the linters or some test files, and its results."""

    name: str
    command: list[str]
    report: Path | None = None
    low_priority: bool = False
    passed: int = 0
    failed: int = 0
    failures: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    seconds: float = 0.0
    output: str = ""

    @property
    def tool(self) -> str:
        """Name of the program for messages."""
        return "pytest" if self.report else self.command[0]

    def format_line(self) -> str:
        """Return the line of this job in the progress report."""
        counts = [f"{self.passed} passed"] if self.report else []
        counts += [f"{self.failed} failed"] if self.failed else []
        counts += [f"{len(self.skipped)} skipped"] if self.skipped else []
        return f"{'FAILED' if self.failed else 'ok':<6} {self.seconds:6.1f} s  {self.name}: {', '.join(counts) or 'ok'}"

    def read_report(self) -> None:
        """Read the numbers of tests and the reasons of skipped tests from pytest's XML report."""
        if self.report is None or not self.report.is_file():
            return
        for case in ET.parse(self.report).iter("testcase"):  # noqa: S314  pytest has just written it
            name = f"{case.get('classname', '')}.{case.get('name', '')}"
            skip = case.find("skipped")
            failure = next((each for each in case if each.tag in {"failure", "error"}), None)
            if failure is not None:
                self.failed += 1
                self.failures.append(f"{name}:\n{(failure.text or '')[-FAILURE_LENGTH:]}")
            elif skip is not None:
                self.skipped.append(f"{name}: {skip.get('message') or 'no reason given'}")
            else:
                self.passed += 1


def find_test_files(paths: list[str]) -> list[Path]:
    """Return the test files below some paths, or all test files, those near the top first.

    Raises:
        SetupError: A path does not exist.

    """
    roots = [Path(path).resolve() for path in paths] or [
        *(THIS.root / "tests", THIS.root / "lab"),
        *sorted(THIS.ros2.glob("src/*/test")),
    ]
    for root in roots:
        if not root.exists():
            raise SetupError(f"{root}: no such test file or folder.")
    files = [file for root in roots for file in ([root] if root.is_file() else sorted(root.rglob("test_*.py")))]
    return sorted(files, key=lambda file: len(file.parts))


def display_name(path: Path) -> str:
    """Return a path relative to the checkout, or the whole path outside the checkout."""
    return str(path.relative_to(THIS.root) if path.is_relative_to(THIS.root) else path)


def is_real_time(file: Path) -> bool:
    """Return whether the text of a file names what makes a ROS context or a server of devices."""
    return bool(REAL_TIME.search(file.read_text(encoding="utf-8")))


def shared_process(file: Path) -> Path | None:
    """Return the entry of SHARED or REAL_TIME_SHARED of a file, or None."""
    entries = REAL_TIME_SHARED if is_real_time(file) else SHARED
    return next((each for each in entries if any(path.match(str(each)) for path in (file, *file.parents))), None)


def make_test_jobs(files: list[Path], *, long: bool = False) -> list[Job]:
    """Return one job for the files that share a process, and one for each other, those of SLOW first.

    ``long``: the tests with this marker, in place of all others.
    """
    selection = ["-m", "long", f"--timeout={LONG_TIMEOUT_S}"] if long else ["-m", "not long"]
    groups: dict[Path, list[str]] = {}
    for file in files:
        groups.setdefault(shared_process(file) or file, []).append(str(file))
    jobs = []
    for key, names in groups.items():
        report = REPORTS / (display_name(key).strip("/").replace("/", ".") + ".xml")
        options = ["-c", str(THIS.root / "pyproject.toml"), "-p", "pytest_timeout", "-q", "--color=no"]
        command = [str(THIS.python), "-m", "pytest", *options, f"--junitxml={report}", *selection, *names]
        jobs.append(Job(display_name(key), command, report, low_priority=key in SHARED))
    return sorted(jobs, key=lambda job: SLOW.index(job.name) if job.name in SLOW else len(SLOW))


class Runner:
    """Sets the workspace up, runs jobs and terminates all running processes after an interruption."""

    def __init__(self, timeout_s: float) -> None:
        """Prepare; ``timeout_s``: of each process [s]."""
        self.timeout_s = timeout_s
        self.environ = DEFAULTS | os.environ
        self.running: set[subprocess.Popen[str]] = set()
        self.printing = threading.Lock()
        self.finished = 0
        self.interrupted = False

    def run_all(self, linters: list[Job], tests: list[Job]) -> None:
        """Run the linters during the build, then the tests, and print a line for each job when it ends."""
        early = deque(linters)
        normal, low = (deque(job for job in tests if job.low_priority == priority) for priority in (False, True))
        count = len(linters) + len(tests)
        with ThreadPoolExecutor(2 * PROCESSES) as pool:
            try:
                workers = [pool.submit(self.run_jobs, count, early)] if early else []
                with self.printing:
                    set_up(THIS, os.environ)
                self.environ = DEFAULTS | workspace_environment()
                order = [(normal, low)] * PROCESSES + [(low, normal)] + [(low,)] * (PROCESSES - 1)
                workers += [pool.submit(self.run_jobs, count, *queues) for queues in order]
                for worker in as_completed(workers):
                    worker.result()
            except BaseException:
                self.interrupted = True
                for queue in (early, normal, low):
                    queue.clear()
                for process in list(self.running):
                    interrupt_process(process)
                raise

    def run_jobs(self, count: int, *queues: deque[Job]) -> None:
        """Run the jobs of one queue after the other and print a line for each of ``count`` jobs of all queues."""
        for queue in queues:
            while job := pop_left(queue):
                self.run_job(job)
                with self.printing:
                    if self.interrupted:
                        return
                    self.finished += 1
                    print(f"[{self.finished}/{count}] {job.format_line()}", flush=True)
                    if job.failed:
                        print(job.output, flush=True)

    def run_job(self, job: Job) -> None:
        """Run a job in a process group of its own and store its results."""
        if job.report:
            job.report.unlink(missing_ok=True)
        start = time.monotonic()
        process = subprocess.Popen(
            job.command,
            cwd=THIS.root,
            env=self.environ,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            text=True,
            errors="replace",
        )
        self.running.add(process)
        if job.low_priority:
            lower_priority(process)
        try:
            job.output, _ = process.communicate(timeout=self.timeout_s)
            ending = f"{job.tool} ended with exit code {process.returncode}"
        except subprocess.TimeoutExpired:
            interrupt_process(process)
            job.output, _ = process.communicate()
            ending = f"interrupted after {self.timeout_s:.0f} s"
        self.running.discard(process)
        job.seconds = time.monotonic() - start
        job.read_report()
        if process.returncode == NO_TESTS and " deselected" in job.output:
            return
        if process.returncode and not job.failed:
            job.failed = 1
            job.output += f"{ending}\n"
            job.failures = [job.output[-FAILURE_LENGTH:]]


def pop_left(queue: deque[Job]) -> Job | None:
    """Take the first job from a queue that other threads empty too."""
    try:
        return queue.popleft()
    except IndexError:
        return None


def lower_priority(process: subprocess.Popen[str]) -> None:
    """Lower the priority of a process, and of its session where the kernel schedules sessions as groups."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, process.pid, LOW_PRIORITY)
        Path(f"/proc/{process.pid}/autogroup").write_text(str(LOW_PRIORITY), encoding="ascii")


def interrupt_process(process: subprocess.Popen[str]) -> None:
    """Interrupt a process group as Ctrl-C does; kill it if it does not end."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGINT)
        try:
            process.wait(INTERRUPT_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)


def print_summary(jobs: list[Job]) -> None:
    """Print the skipped and the failed tests with their reasons, and the numbers of tests."""
    for job in jobs:
        for skip in job.skipped:
            print(f"skipped: {skip}")
    for job in jobs:
        if job.failed:
            print(f"failed: {job.name}")
            for failure in job.failures:
                print(textwrap.indent(failure, "    "))
    passed, failed = sum(job.passed for job in jobs), sum(job.failed for job in jobs)
    print(f"{passed} passed, {failed} failed, {sum(len(job.skipped) for job in jobs)} skipped")


def main() -> int:
    """Run the tests named on the command line, or the linters and all tests, and return the exit code."""
    parser = argparse.ArgumentParser(description="Run the linters and the tests.")
    parser.add_argument("--long", action="store_true", help="only the tests that are left out otherwise")
    parser.add_argument("paths", nargs="*", help="files or folders; default: all tests, and the linters")
    options = parser.parse_args()
    tests = make_test_jobs(find_test_files(options.paths), long=options.long)
    linters = [Job("make lint", ["make", "--no-print-directory", "lint"], low_priority=True)]
    linters = [] if options.paths or options.long else linters
    REPORTS.mkdir(parents=True, exist_ok=True)
    Runner(LONG_PROCESS_TIMEOUT_S if options.long else PROCESS_TIMEOUT_S).run_all(linters, tests)
    jobs = [*linters, *tests]
    print_summary(jobs)
    return 0 if jobs and not any(job.failed for job in jobs) else 1


if __name__ == "__main__":
    exit_with("make test", main)
