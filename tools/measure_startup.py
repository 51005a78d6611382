"""Measure how long a node's program takes from its start to the lifecycle state active, and the memory it holds then.

Usage: ``.venv/bin/python -E tools/in_workspace.py tools/measure_startup.py [--runs 10] EXECUTABLE [ARGUMENTS]``.
EXECUTABLE is the path of an installed program, ``ros2_ws/install/posor_estimator/lib/posor_estimator/posor_node``.

Every node program freezes its heap once its nodes are active (``prepare_heap`` in ``realtime_process.py``).
A ``sitecustomize`` module replaces ``gc.freeze`` in the measured process, to report this moment to this process.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import NamedTuple

ACTIVE = b"measured program is active\n"
SITECUSTOMIZE = f"""\
import gc, os
freeze = gc.freeze
def report_and_freeze():
    freeze()
    os.write(2, {ACTIVE!r})
gc.freeze = report_and_freeze
"""


class Startup(NamedTuple):
    """One start of the program."""

    wall_s: float
    cpu_s: float
    resident_mb: float
    peak_mb: float


def measure(command: list[str], hook_folder: str) -> Startup:
    """Start the program with cached byte code, wait until it is active, read its figures and end it.

    Raises:
        RuntimeError: The program ended before it was active.

    """
    environ = os.environ | {"PYTHONPATH": os.pathsep.join([hook_folder, os.environ.get("PYTHONPATH", "")])}
    begin_s = time.monotonic()
    with subprocess.Popen(command, stderr=subprocess.PIPE, env=environ) as program:
        if program.stderr is None or not any(line == ACTIVE for line in program.stderr):
            message = f"{command[0]} ended before it was active"
            raise RuntimeError(message)
        wall_s = time.monotonic() - begin_s
        process = Path("/proc", str(program.pid))
        status = dict(line.split(":", 1) for line in (process / "status").read_text().splitlines())
        ticks = (process / "stat").read_text().rpartition(")")[2].split()
        program.send_signal(signal.SIGINT)
        program.stderr.read()
    cpu_s = (int(ticks[11]) + int(ticks[12])) / os.sysconf("SC_CLK_TCK")
    return Startup(wall_s, cpu_s, *(int(status[key].split()[0]) / 1000.0 for key in ("VmRSS", "VmHWM")))


def main() -> int:
    """Print the median figures of several starts; the first start, which fills the caches, is not counted."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("command", nargs=argparse.REMAINDER)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "sitecustomize.py").write_text(SITECUSTOMIZE, encoding="utf-8")
        starts = [measure(options.command, folder) for _ in range(options.runs + 1)][1:]
    medians = Startup(*map(median, zip(*starts, strict=True)))
    print(
        f"median of {options.runs}: {medians.wall_s:.2f} s from start to active, {medians.cpu_s:.2f} s of CPU time, "
        f"resident {medians.resident_mb:.0f} MB (peak {medians.peak_mb:.0f} MB)"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
