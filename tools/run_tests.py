"""Run the tests: one pytest process for each file, so that no ROS context leaks from one file into another.

Two files at a time. Prints one line for each file when it ends, the whole output of a file that failed, every skipped
test with its reason, and last of all ``N passed, N failed, N skipped``. With paths as arguments, only those.
"""

from __future__ import annotations

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
        return f"{verdict:<6} {self.seconds:6.1f} s  {self.file.relative_to(THIS.root)}: {counts}"


def test_files(wanted: list[str]) -> list[Path]:
    """Return the test files asked for, or all; those that start nodes first, since they take longest.

    Raises:
        SetupError: A path asked for does not exist.

    """
    places = [Path(name).resolve() for name in wanted] or [THIS.root / "tests", *sorted(THIS.ros2.glob("src/*/test"))]
    missing = [str(place) for place in places if not place.exists()]
    if missing:
        raise SetupError(f"{missing[0]}: no such test file or folder.")
    return [file for place in places for file in ([place] if place.is_file() else sorted(place.rglob("test_*.py")))]


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


def run_file(file: Path, environ: dict[str, str]) -> Outcome:
    """Run one test file in a process group of its own and return what came of it."""
    outcome = Outcome(file)
    report = REPORTS / (str(file.relative_to(THIS.root)).replace("/", ".") + ".xml")
    report.unlink(missing_ok=True)
    start = time.monotonic()
    command = [str(THIS.python), "-m", "pytest", "-q", "--color=no", f"--junitxml={report}", str(file)]
    with subprocess.Popen(
        command,
        cwd=THIS.root,
        env=environ,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        text=True,
        errors="replace",
    ) as process:
        try:
            outcome.output, _ = process.communicate(timeout=FILE_TIMEOUT_S)
            ending = f"pytest ended with exit code {process.returncode}"
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            outcome.output, _ = process.communicate()
            ending = f"killed after {FILE_TIMEOUT_S:.0f} s"
    outcome.seconds = time.monotonic() - start
    if report.is_file():
        read_report(report, outcome)
    if process.returncode and not outcome.failed:
        outcome.failed = 1
        outcome.output += f"{ending}\n"
    return outcome


def run_all(files: list[Path], environ: dict[str, str]) -> list[Outcome]:
    """Run the files and print a line for each as it ends."""
    outcomes = []
    with ThreadPoolExecutor(max_workers=AT_A_TIME) as pool:
        running = [pool.submit(run_file, file, environ) for file in files]
        try:
            for number, future in enumerate(as_completed(running), start=1):
                outcome = future.result()
                outcomes.append(outcome)
                print(f"[{number}/{len(files)}] {outcome.line()}", flush=True)
                if outcome.failed:
                    print(outcome.output, flush=True)
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
            raise
    return outcomes


def main() -> int:
    """Run the tests named on the command line, or all, and return the exit code."""
    try:
        files = test_files(sys.argv[1:])
        environ = workspace_environment()
    except SetupError as error:
        sys.stderr.write(f"make test: {error}\n")
        return 2
    REPORTS.mkdir(parents=True, exist_ok=True)
    outcomes = run_all(files, environ)
    for outcome in outcomes:
        for skip in outcome.skipped:
            print(f"skipped: {skip}")
    for outcome in outcomes:
        if outcome.failed:
            print(f"failed: {outcome.file.relative_to(THIS.root)}")
    failed = sum(outcome.failed for outcome in outcomes)
    passed = sum(outcome.passed for outcome in outcomes)
    print(f"{passed} passed, {failed} failed, {sum(len(outcome.skipped) for outcome in outcomes)} skipped")
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    sys.exit(main())
