"""Run the tests: one pytest process for each file, so that no ROS context leaks from one file into another.

Two files at a time, with one thread of linear algebra in each process: more would only wait for one another, since the
matrices are small and the processors have work. Prints one line for each file when it ends, the whole output of a file
that failed, every skipped test with its reason, and last of all ``N passed, N failed, N skipped``. With paths as
arguments, only those.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

from environment import THIS, SetupError, workspace_environment

AT_A_TIME = min(2, os.cpu_count() or 1)
FILE_TIMEOUT_S = 480.0  # a net under pytest's own timeout for each test
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}  # numpy's and scipy's; what the caller has set goes before it
FAREWELL_S = 20.0  # what an interrupted pytest gets to stop the nodes that its tests have started
REPORTS = THIS.root / "build" / "test"


@dataclass
class Outcome:
    """What came of one test file."""

    file: Path
    passed: int = 0
    failed: int = 0
    skipped: list[str] = field(default_factory=list)
    seconds: float = 0.0
    output: str = ""

    def line(self) -> str:
        """Return the file's line of the progress report."""
        verdict = "FAILED" if self.failed else "ok"
        counts = f"{self.passed} passed"
        counts += f", {self.failed} failed" if self.failed else ""
        counts += f", {len(self.skipped)} skipped" if self.skipped else ""
        return f"{verdict:<6} {self.seconds:6.1f} s  {shown(self.file)}: {counts}"


def shown(file: Path) -> str:
    """Return a file's name as it is printed: relative to the checkout if it is in it."""
    return str(file.relative_to(THIS.root) if file.is_relative_to(THIS.root) else file)


def test_files(wanted: list[str]) -> list[Path]:
    """Return the test files asked for, or all; the deeper a file lies, the later: those near the top take longest.

    Raises:
        SetupError: A path asked for does not exist.

    """
    places = [Path(name).resolve() for name in wanted] or [THIS.root / "tests", *sorted(THIS.ros2.glob("src/*/test"))]
    missing = [str(place) for place in places if not place.exists()]
    if missing:
        raise SetupError(f"{missing[0]}: no such test file or folder.")
    files = [file for place in places for file in ([place] if place.is_file() else sorted(place.rglob("test_*.py")))]
    return sorted(files, key=lambda file: len(file.parts))


def read_report(path: Path, outcome: Outcome) -> None:
    """Take the counts and the reasons of skipped tests from pytest's XML report."""
    for case in ET.parse(path).iter("testcase"):  # noqa: S314 - written by pytest a moment ago
        name = f"{case.get('classname', '')}.{case.get('name', '')}"
        skip = case.find("skipped")
        if case.find("failure") is not None or case.find("error") is not None:
            outcome.failed += 1
        elif skip is not None:
            outcome.skipped.append(f"{name}: {skip.get('message') or 'no reason given'}")
        else:
            outcome.passed += 1


class Runner:
    """Runs test files in pytest processes and knows which are at work, so that an interruption ends them all.

    Args:
        environ: Environment of the sourced workspace.

    """

    def __init__(self, environ: dict[str, str]) -> None:
        self.environ = ONE_THREAD | environ
        self.at_work: set[subprocess.Popen[str]] = set()

    def run_all(self, files: list[Path]) -> list[Outcome]:
        """Run the files and print a line for each as it ends."""
        outcomes = []
        with ThreadPoolExecutor(max_workers=AT_A_TIME) as pool:
            running = [pool.submit(self.run_file, file) for file in files]
            try:
                for number, future in enumerate(as_completed(running), start=1):
                    outcome = future.result()
                    outcomes.append(outcome)
                    print(f"[{number}/{len(files)}] {outcome.line()}", flush=True)
                    if outcome.failed:
                        print(outcome.output, flush=True)
            except KeyboardInterrupt:
                pool.shutdown(wait=False, cancel_futures=True)
                for process in list(self.at_work):
                    end(process)
                raise
        return outcomes

    def run_file(self, file: Path) -> Outcome:
        """Run one test file in a process group of its own and return what came of it."""
        outcome = Outcome(file)
        report = REPORTS / (shown(file).strip("/").replace("/", ".") + ".xml")
        report.unlink(missing_ok=True)
        start = time.monotonic()
        process = self.start([f"--junitxml={report}", str(file)])
        try:
            outcome.output, _ = process.communicate(timeout=FILE_TIMEOUT_S)
            ending = f"pytest ended with exit code {process.returncode}"
        except subprocess.TimeoutExpired:
            end(process)
            outcome.output, _ = process.communicate()
            ending = f"ended after {FILE_TIMEOUT_S:.0f} s"
        self.at_work.discard(process)
        outcome.seconds = time.monotonic() - start
        if report.is_file():
            read_report(report, outcome)
        if process.returncode and not outcome.failed:
            outcome.failed = 1
            outcome.output += f"{ending}\n"
        return outcome

    def start(self, arguments: list[str]) -> subprocess.Popen[str]:
        """Start pytest."""
        settings = ["-c", str(THIS.root / "pyproject.toml")]
        process = subprocess.Popen(
            [str(THIS.python), "-m", "pytest", *settings, "-q", "--color=no", *arguments],
            cwd=THIS.root,
            env=self.environ,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            text=True,
            errors="replace",
        )
        self.at_work.add(process)
        return process


def end(process: subprocess.Popen[str]) -> None:
    """Interrupt a pytest process as Ctrl-C would; kill its group if it does not end by itself."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGINT)
        try:
            process.wait(FAREWELL_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)


def main() -> int:
    """Run the tests named on the command line, or all, and return the exit code."""
    try:
        files = test_files(sys.argv[1:])
        environ = workspace_environment()
    except SetupError as error:
        sys.stderr.write(f"make test: {error}\n")
        return 2
    REPORTS.mkdir(parents=True, exist_ok=True)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        outcomes = Runner(environ).run_all(files)
    except KeyboardInterrupt:
        sys.stderr.write("make test: interrupted.\n")
        return 130
    summarise(outcomes)
    return 0 if outcomes and not any(outcome.failed for outcome in outcomes) else 1


def summarise(outcomes: list[Outcome]) -> None:
    """Print the skipped tests with their reasons, the files that failed, and the counts."""
    for outcome in outcomes:
        for skip in outcome.skipped:
            print(f"skipped: {skip}")
    for outcome in outcomes:
        if outcome.failed:
            print(f"failed: {shown(outcome.file)}")
    passed, failed = sum(o.passed for o in outcomes), sum(o.failed for o in outcomes)
    print(f"{passed} passed, {failed} failed, {sum(len(o.skipped) for o in outcomes)} skipped")


if __name__ == "__main__":
    sys.exit(main())
