"""The host on which the benchmark runs."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any

from posor.numerics.compiled import COMPILING
from rclpy.utilities import get_rmw_implementation_identifier


def host_description() -> dict[str, Any]:
    """Return hardware, versions and the present load average."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    processors = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return {
        "cores": len(os.sched_getaffinity(0)),
        "processor": next(processors, platform.machine()),
        "kernel": platform.release(),
        "python": platform.python_version(),
        "rmw": get_rmw_implementation_identifier(),
        "compiled": COMPILING,
        "load": os.getloadavg()[0],
    }


def stolen_s() -> float:
    """Return the time [s] since boot in which the host of this virtual machine ran others instead."""
    stolen = int(Path("/proc/stat").read_text(encoding="ascii").split(maxsplit=9)[8])
    return stolen / os.sysconf("SC_CLK_TCK")
