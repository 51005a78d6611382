"""On what the benchmark ran."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any

from posor_estimator.core.compiled import COMPILING
from rclpy.utilities import get_rmw_implementation_identifier


def machine() -> dict[str, Any]:
    """Return what makes figures differ between machines, and the load average at this moment."""
    return {
        "cores": len(os.sched_getaffinity(0)),
        "processor": _processor(),
        "kernel": platform.release(),
        "python": platform.python_version(),
        "rmw": get_rmw_implementation_identifier(),
        "compiled": COMPILING,
        "load": os.getloadavg()[0],
    }


def stolen_s() -> float:
    """Return for how long, since it was started, the machine's cores wanted to run and its host let others run [s]."""
    stolen = int(Path("/proc/stat").read_text(encoding="ascii").split(maxsplit=9)[8])
    return stolen / os.sysconf("SC_CLK_TCK")


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.machine())
