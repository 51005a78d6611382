# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Time, processor time and memory of a program from its exec to the line *ready*."""

from __future__ import annotations

import re
import time
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from posor_lab.harness.program import Program
from posor_lab.soak.process_sample import MEGABYTE, ProcessSample

if TYPE_CHECKING:
    from collections.abc import Sequence

READY = "ready"


def start_cost(command: Sequence[str], starts: int) -> dict[str, float]:
    """Return the medians of some starts of a program: times [s], resident and private dirty memory [MB]."""
    figures = [_start_once(command) for _ in range(starts)]
    return {name: median(each[name] for each in figures) for name in figures[0]}


def _start_once(command: Sequence[str]) -> dict[str, float]:
    begin_s = time.monotonic()
    with Program(command) as program:
        program.wait_for_line(READY)
        wall_s, pid = time.monotonic() - begin_s, program.process.pid
        sample = ProcessSample.take(pid, wall_s)
        memory = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii")
        (kilobytes,) = re.findall(r"Private_Dirty:\s+(\d+)", memory)
        program.end()
    dirty_mb = int(kilobytes) * 1024 / MEGABYTE
    return {"wall_s": wall_s, "cpu_s": sample.used_s, "memory_mb": sample.memory_mb, "dirty_mb": dirty_mb}
