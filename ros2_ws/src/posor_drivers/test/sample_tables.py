# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Small tables for tests, made by hand, with the map of the tests of 1985."""

from __future__ import annotations

from pathlib import Path

import yaml

MAP = Path(__file__).parents[4] / "data/slocum1985/table_map.yaml"
HEADER = "step,y_in,z_in,x_in,l1_v,l2_v,l3_v,dx1,dy1,dx2,dy2,repaired"
ROWS = (
    "1,0.0,0.0,0.0,0.25,0.5,0.75,0.5,0.125,-0.5,0.0625,y_in:absent-implied-zero(output);l1_v:smooth",
    "2,-1.0,0.5,nan,0.26,0.51,0.76,0.51,0.13,-0.51,0.06,l2_v:absent-estimated(both)",
    "3,-2.0,1.0,2.0,0.27,0.52,0.77,0.52,0.14,-0.52,0.05,dy2:absent-estimated(smooth);l3_v:both-ambiguous",
    "5,-3.0,1.5,3.0,0.28,0.53,0.78,0.53,0.15,-0.53,0.04,",
)


def write_table(path: Path, *rows: str, header: str = HEADER) -> Path:
    lines = ["# a test", "# y_in, z_in, x_in: machining centre", header, *(rows or ROWS)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def write_map(path: Path, **changes: object) -> Path:
    """Write the map of 1985 with other keys."""
    content = yaml.safe_load(MAP.read_text(encoding="utf-8")) | changes
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path
