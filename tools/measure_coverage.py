# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Measure which lines of the numerical packages tests execute: ``make coverage``.

Kernels stay uncompiled, because the lines of compiled code cannot be observed. That makes them hundreds of times
slower, so a test is interrupted after TEST_LIMIT_S and a file of tests after FILE_LIMIT_S; the file runs again with
compiled kernels, because tests of thousands of scans repeat what shorter ones execute. Tests with the marker ``long``
are left out. The exit code is 1 if less than 95 % of the lines of a package are covered or a test fails.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from environment import END_S, THIS, exit_with, workspace_environment
from run_tests import NO_TESTS

LEAST_PERCENT = 95.0
TEST_LIMIT_S, FILE_LIMIT_S = 15, 90  # with uncompiled kernels
SOURCE = THIS.ros2 / "src"
LAB_TESTS = THIS.root / "lab" / "posor_lab" / "test"
PARTS = ("numerics", "model", "sensors", "estimation", "chain", "calibration", "uncertainty")
PACKAGES = {
    **{SOURCE / "posor" / "posor" / part: SOURCE / "posor" / "test" / part for part in PARTS},
    SOURCE / "posor_calibration" / "posor_calibration": SOURCE / "posor_calibration" / "test",
}
"""Folders of the numerical packages, and those of their tests."""
OTHER_FILES = (
    SOURCE / "posor_estimator" / "test" / "test_message_stream.py",
    THIS.root / "tests" / "test_calibrate_command.py",
    THIS.root / "tests" / "test_public_api.py",
    LAB_TESTS / "commissioning" / "test_commissioning_command.py",
    LAB_TESTS / "arm_study" / "test_calibration_truth.py",
    LAB_TESTS / "arm_study" / "test_prediction_truth.py",
    LAB_TESTS / "health" / "test_health.py",
    SOURCE / "posor_design" / "test" / "test_endpoint_budget.py",
    SOURCE / "posor_design" / "test" / "test_arm_allotment.py",
)
"""Tests outside the folders of the packages: of messages, reports on a calibration, whole arms, health, and budgets."""
COVERAGE = (str(THIS.python), "-m", "coverage")
REPORT = THIS.root / "build" / "coverage.json"


def run_pytest(
    file: Path, environ: dict[str, str], limit_s: float | None = None, options: tuple[str, ...] = ()
) -> tuple[int | None, str]:
    """Run a test file under observation; return pytest's exit code (None: interrupted at the limit) and output."""
    process = subprocess.Popen(
        [*COVERAGE, "run", "-m", "pytest", "-q", "--no-header", "-m", "not long", *options, str(file)],
        cwd=THIS.root,
        env=environ,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        output, _ = process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)
        try:
            output, _ = process.communicate(timeout=END_S)
        except subprocess.TimeoutExpired:  # the interruption came while the observer held a lock
            process.kill()
            output, _ = process.communicate()
        return None, output
    return process.returncode, output


def run_test_file(file: Path, environ: dict[str, str]) -> bool:
    """Run a test file without, or where that takes too long also with compiled kernels; return whether none failed."""
    uncompiled = environ | {"POSOR_KERNELS": "python"}
    code, output = run_pytest(file, uncompiled, FILE_LIMIT_S, (f"--timeout={TEST_LIMIT_S}", "--timeout-method=signal"))
    if code not in {0, NO_TESTS}:
        code, output = run_pytest(file, environ)
    if code not in {0, NO_TESTS}:
        print(f"{file.relative_to(THIS.root)}: failed\n{output}", flush=True)
        return False
    return True


def run_tests() -> bool:
    """Run the tests of the numerical packages and write the report; return whether no test failed."""
    files = [file for tests in PACKAGES.values() for file in sorted(tests.rglob("test_*.py"))]
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
        environ = workspace_environment() | {"OPENBLAS_NUM_THREADS": "1", "COVERAGE_FILE": str(Path(folder, "data"))}
        passed = list(pool.map(lambda file: run_test_file(file, environ), [*OTHER_FILES, *files]))
        for arguments in (["combine", "-q"], ["json", "-q", "-i", f"--include={SOURCE}/*", "-o", str(REPORT)]):
            subprocess.run([*COVERAGE, *arguments], cwd=THIS.root, env=environ, check=True)
    return all(passed)


def print_table() -> float:
    """Print the covered percentage of each package and return the smallest."""
    covered, lines = Counter[Path](), Counter[Path]()
    for name, entry in json.loads(REPORT.read_text(encoding="utf-8"))["files"].items():
        for package in PACKAGES:
            if (THIS.root / name).resolve().is_relative_to(package):
                covered[package] += entry["summary"]["covered_lines"]
                lines[package] += entry["summary"]["num_statements"]
    percentages = {package: 100 * covered[package] / lines[package] for package in lines}
    for package, percentage in percentages.items():
        print(f"{package.name:<18}{lines[package]:>7,} lines {percentage:>7.2f} %")
    print(f"{'all':<18}{lines.total():>7,} lines {100 * covered.total() / lines.total():>7.2f} %")
    return min(percentages.values())


def main() -> int:
    """Run the tests, print the table and return the exit code."""
    passed = run_tests()
    least = print_table()
    if least < LEAST_PERCENT:
        sys.stderr.write(f"make coverage: each package must be covered by at least {LEAST_PERCENT:.0f} %.\n")
    return int(not passed or least < LEAST_PERCENT)


if __name__ == "__main__":
    exit_with("make coverage", main)
