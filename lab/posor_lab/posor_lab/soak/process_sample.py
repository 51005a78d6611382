# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Memory, descriptors, threads and processor time of a process at one moment, from /proc."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from scipy.stats import theilslopes

if TYPE_CHECKING:
    from collections.abc import Sequence

MEGABYTE = 1e6


@dataclass(frozen=True)
class ProcessSample:
    """Resources of a process at one moment."""

    seconds: float  # since the warm-up
    memory_mb: float  # resident
    descriptors: int
    threads: int
    used_s: float = 0.0  # processor time, user and system

    @classmethod
    def take(cls, pid: int, seconds: float) -> ProcessSample:
        """Return a sample of a running process."""
        folder = Path(f"/proc/{pid}")
        status = (folder / "status").read_text(encoding="ascii")
        kilobytes, threads = (int(re.findall(rf"{name}:\s+(\d+)", status)[0]) for name in ("VmRSS", "Threads"))
        fields = (folder / "stat").read_text(encoding="ascii").rpartition(")")[2].split()
        used_s = sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")
        return cls(seconds, kilobytes * 1024 / MEGABYTE, len(list((folder / "fd").iterdir())), threads, used_s)


def growth_mb(samples: Sequence[ProcessSample]) -> float:
    """Return the growth of the memory [MB] along the median of the slopes between all pairs of samples (Theil, Sen)."""
    seconds, memory = [each.seconds for each in samples], [each.memory_mb for each in samples]
    return float(theilslopes(memory, seconds).slope) * (seconds[-1] - seconds[0])
