"""Measure which lines of the numerical packages their tests execute: ``make coverage``.

Kernels stay uncompiled (``POSOR_COMPILE=0``), because the lines of compiled code cannot be observed. Tests with the
marker ``long`` are left out: they repeat many times what another test runs. The exit code is 1 if less
than 95 % of the lines of a package are covered or a test fails.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

from environment import THIS, SetupError, workspace_environment

PACKAGES = ("numerics", "model", "sensors", "estimation", "chain", "calibration", "identification", "uncertainty")
LEAST_PERCENT = 95.0
SOURCE = THIS.ros2 / "src" / "posor_estimator" / "posor_estimator"
TESTS = THIS.ros2 / "src" / "posor_estimator" / "test"
REPORT = THIS.root / "build" / "coverage.json"


def run_tests() -> int:
    """Run the tests of the numerical packages under observation, write the report and return pytest's exit code."""
    folders = [str(TESTS / package) for package in PACKAGES if (TESTS / package).is_dir()]
    measured = [f"--cov=posor_estimator.{package}" for package in PACKAGES]
    options = ["-q", "-m", "not long", "--timeout=1200", f"--cov-report=json:{REPORT}"]
    command = [str(THIS.python), "-m", "pytest", *options, *measured, *folders]
    environ = workspace_environment() | {"POSOR_COMPILE": "0", "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(command, cwd=THIS.root, env=environ, check=False).returncode


def print_table() -> float:
    """Print the covered percentage of each package and return the smallest."""
    covered: defaultdict[str, int] = defaultdict(int)
    lines: defaultdict[str, int] = defaultdict(int)
    for name, entry in json.loads(REPORT.read_text(encoding="utf-8"))["files"].items():
        package = Path(name).parent.name
        covered[package] += entry["summary"]["covered_lines"]
        lines[package] += entry["summary"]["num_statements"]
    percentages = {package: 100 * covered[package] / lines[package] for package in PACKAGES if lines[package]}
    for package, percentage in percentages.items():
        print(f"{package:<16}{lines[package]:>7,} lines {percentage:>7.2f} %")
    print(f"{'all':<16}{sum(lines.values()):>7,} lines {100 * sum(covered.values()) / sum(lines.values()):>7.2f} %")
    return min(percentages.values())


def main() -> int:
    """Run the tests, print the table and return the exit code."""
    try:
        code = run_tests()
    except SetupError as error:
        sys.stderr.write(f"make coverage: {error}\n")
        return 2
    least = print_table()
    if least < LEAST_PERCENT:
        sys.stderr.write(f"make coverage: each package must be covered by at least {LEAST_PERCENT:.0f} %.\n")
    return code or int(least < LEAST_PERCENT)


if __name__ == "__main__":
    sys.exit(main())
