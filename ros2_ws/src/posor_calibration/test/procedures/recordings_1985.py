# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The motion tests of 1985 as calibration procedures take them, from the recorded tables."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from posor.bags.recording import Recording, Track
from posor.model.scan import PROBES_ESTIMATED, Scan, Scans

DATA = Path(__file__).resolve().parents[5] / "data/slocum1985"
INCH = 0.0254
LEVER = 31.43 * INCH
TOPIC = "/truth"
STEP_NS = 100_000_000


def recorded(test: str) -> Recording:
    """Return a test of 1985 as the bags have it."""
    with (DATA / f"{test}_input.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    scans, statuses = [], []
    for i, row in enumerate(rows):
        ratios = np.array([[float(row[f"d{axis}{k}"]) for axis in "xy"] for k in (1, 2)])
        scans.append(
            Scan(
                number=i + 1,
                stamp_ns=(i + 1) * STEP_NS,
                gap_voltages=np.array([float(row[f"l{k}_v"]) for k in (1, 2, 3)]),
                diode_currents=np.column_stack([1.0 + ratios, 1.0 - ratios]) * 5e-5,
                lit_sources=(0, 1),
            )
        )
        statuses.append(PROBES_ESTIMATED if "l1_v:absent" in row["repaired"] else 0)
    together = Scans.of(scans)
    values = np.array([[float(row[f"{axis}_in"]) for axis in "xyz"] for row in rows]) * INCH
    track = Track(together.stamps_ns, values, np.full(3, 2e-4 * INCH), TOPIC)
    return Recording(together, {TOPIC: track}, test, statuses=np.array(statuses))
