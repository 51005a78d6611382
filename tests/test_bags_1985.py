# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The committed bags equal those of their script and hold the recorded tables."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import pytest
from geometry_msgs.msg import PointStamped
from posor_lab.harness.recorded_messages import read_bag
from posor_lab.thesis_data import read_table
from posor_msgs.msg import RawScan
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader
from scipy.constants import inch

ROOT = Path(__file__).resolve().parent.parent
BAGS = ROOT / "bags"
START_NS = 486_432_000_000_000_000
STEP_NS = 200_000_000
ESTIMATED = {
    "ymo": {14: RawScan.STATUS_DIODES_ESTIMATED},
    "yzmo": {
        6: RawScan.STATUS_PROBES_ESTIMATED,
        13: RawScan.STATUS_DIODES_ESTIMATED,
        14: RawScan.STATUS_DIODES_ESTIMATED,
    },
    "zmo": dict.fromkeys((3, 6, 9, 11, 14, 17), RawScan.STATUS_DIODES_ESTIMATED),
}


def test_script_makes_the_committed_messages(tmp_path: Path) -> None:
    subprocess.run([sys.executable, str(BAGS / "make_bags.py"), str(tmp_path)], check=True, capture_output=True)
    for test in ESTIMATED:
        made, committed = tmp_path / test, BAGS / test  # the files differ: the committed ones hold their former name
        assert read_bag(made) == read_bag(committed)
        assert (made / "metadata.yaml").read_bytes() == (committed / "metadata.yaml").read_bytes(), test


@pytest.mark.parametrize(("test", "steps"), [("ymo", 15), ("yzmo", 14), ("zmo", 20)])
def test_bag_holds_the_record(test: str, steps: int) -> None:
    scans: list[RawScan] = []
    truths: list[PointStamped] = []
    with Reader(BAGS / test) as reader:
        types = {connection.topic: connection.msgtype for connection in reader.connections}
        assert types == {
            "/joint1/raw": "posor_msgs/msg/RawScan",
            "/truth/machining_centre": "geometry_msgs/msg/PointStamped",
        }
        for connection, time_ns, data in reader.messages():
            raw = connection.topic == "/joint1/raw"
            content = deserialize_message(bytes(data), RawScan if raw else PointStamped)
            stamp = content.header.stamp
            assert stamp.sec * 1_000_000_000 + stamp.nanosec == time_ns
            (scans if raw else truths).append(content)
    rows = read_table(ROOT / f"data/slocum1985/{test}_input.csv", ())
    assert len(rows) == len(scans) == len(truths) == steps
    for index, (row, scan, truth) in enumerate(zip(rows, scans, truths, strict=True)):
        assert scan.scan == int(row["step"]) == index + 1
        assert scan.status == ESTIMATED[test].get(index + 1, 0)
        assert list(scan.gap_voltages) == [float(row[column]) for column in ("l1_v", "l2_v", "l3_v")]
        a, b, c, d = (scan.diode_currents[contact::4] for contact in range(4))
        assert [x + z for x, z in zip(a, c, strict=True)] == pytest.approx([1e-4, 1e-4], rel=1e-14)
        assert [y + z for y, z in zip(b, d, strict=True)] == pytest.approx([1e-4, 1e-4], rel=1e-14)
        ratios = [(one - other) / (one + other) for k in range(2) for one, other in ((a[k], c[k]), (b[k], d[k]))]
        assert ratios == pytest.approx([float(row[column]) for column in ("dx1", "dy1", "dx2", "dy2")], abs=1e-15)
        for axis in "xyz":
            place, reading = getattr(truth.point, axis), float(row[f"{axis}_in"]) * inch
            assert place == reading or (math.isnan(place) and math.isnan(reading))
        assert truth.header.stamp == scan.header.stamp
        assert scan.header.stamp.sec * 1_000_000_000 + scan.header.stamp.nanosec == START_NS + index * STEP_NS
