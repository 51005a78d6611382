# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Cost of the start of a program, of which time and memory are known."""

from __future__ import annotations

import sys
from pathlib import Path

from posor_lab.benchmark.start_cost import start_cost

PROGRAM = """\
import time

memory = bytearray(b"1") * 50_000_000
while time.process_time() < 0.3:
    pass
print("ready", flush=True)
while True:
    time.sleep(1.0)
"""


def test_times_and_memory_are_those_of_the_program_at_the_line_ready(tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(PROGRAM, encoding="utf-8")
    cost = start_cost([sys.executable, str(tmp_path / "program.py")], 2)
    assert 0.28 <= cost["cpu_s"] <= cost["wall_s"] + 0.02  # the system counts hundredths of a second
    assert 50.0 <= cost["dirty_mb"] <= cost["memory_mb"] < 200.0
