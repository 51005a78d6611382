# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables for tests: ten scans of two gap probes and a temperature, in every way that a program may write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

START = "2026-11-25T10:00:00Z"
START_NS = 1_795_600_800_000_000_000
COUNT = 10
TIMES = np.arange(COUNT) * 0.002
VOLTS = np.column_stack([0.71 + 0.001 * np.arange(COUNT), -0.25 - 0.002 * np.arange(COUNT)])  # [V]
CELSIUS = 20.0 + 0.1 * np.arange(COUNT)
NAMES = ("Time (s)", "AI0 (mV)", "AI1 (mV)", "Plate [°C]", "Remark")
READINGS: dict[str, Any] = {
    "gap_voltages": [{"column": "AI0 (mV)", "unit": "mV"}, {"column": "AI1 (mV)", "unit": "mV"}],
    "temperature": {"column": "Plate [°C]", "unit": "degC"},
}


def rows(decimal: str = ".") -> list[list[str]]:
    """Return the cells of all rows."""
    numbers = [
        [f"{time:.4f}", *(f"{1e3 * volt:.3f}" for volt in volts), f"{celsius:.2f}"]
        for time, volts, celsius in zip(TIMES, VOLTS, CELSIUS, strict=True)
    ]
    return [[*(cell.replace(".", decimal) for cell in row), "ok"] for row in numbers]


def write_csv(path: Path) -> Path:
    """Write the table as CSV."""
    lines = [",".join(row) for row in [list(NAMES), *rows()]]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def write_map(folder: Path, **changes: Any) -> Path:
    """Write the map of the table; ``changes`` replace keys, None removes one."""
    content: dict[str, Any] = {
        "format": "posor_table_map",
        "version": 1,
        "name": "rig",
        "time": {"column": "Time (s)", "unit": "s", "start": START},
        "joints": {"elbow": {"frame_id": "plate", **READINGS}},
    }
    content = {key: value for key, value in (content | changes).items() if value is not None}
    path = folder / "map.yaml"
    path.write_text(yaml.safe_dump(content, allow_unicode=True), encoding="utf-8")
    return path
