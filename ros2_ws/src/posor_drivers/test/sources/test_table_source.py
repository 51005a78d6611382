# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Source ``table`` and the program ``import``: the messages of a table by its map."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PointStamped, TransformStamped
from posor import read_scans, read_table
from posor.bags.provenance import custom_data
from posor.errors import DataFileError, ParameterError
from posor.messages.message_definitions import MessageTypes
from posor.numerics.stamps import NS
from posor_drivers.driver_parameters import ReplayParameters
from posor_drivers.import_command import main
from posor_drivers.replay_publisher import schedule_replay
from posor_drivers.sources.source import Topic
from posor_drivers.sources.table_source import TableParameters, TableSource
from posor_msgs.msg import RawScan, ReferenceReading
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader

from ..sample_tables import HEADER, MAP, ROWS, write_map, write_table

START_S = 486_432_000
CLASSES = {"raw": RawScan, "/truth/machining_centre": PointStamped}


def messages(table: Path) -> dict[str, list[Any]]:
    source = TableSource(TableParameters(path=str(table), map=str(MAP)), MessageTypes())
    raw, truth = source.open()
    assert raw == Topic("raw", "posor_msgs/msg/RawScan")
    assert truth == Topic("/truth/machining_centre", "geometry_msgs/msg/PointStamped")
    found: dict[str, list[Any]] = {topic: [] for topic in CLASSES}
    assert list(source.read_messages()) == list(source.read_messages())
    for message in source.read_messages():
        content = deserialize_message(message.data, CLASSES[message.topic])
        assert message.time_ns == content.header.stamp.sec * NS + content.header.stamp.nanosec
        found[message.topic].append(content)
    return found


def test_scan_and_truth_hold_the_cells_of_their_row(tmp_path: Path) -> None:
    found = messages(write_table(tmp_path / "t.csv"))
    scans, truths = found["raw"], found["/truth/machining_centre"]
    assert [scan.scan for scan in scans] == [1, 2, 3, 5]
    assert [scan.status for scan in scans] == [0, RawScan.STATUS_PROBES_ESTIMATED, RawScan.STATUS_DIODES_ESTIMATED, 0]
    stamps = [(scan.header.stamp.sec - START_S, scan.header.stamp.nanosec) for scan in scans]
    assert stamps == [(0, 0), (0, 200_000_000), (0, 400_000_000), (0, 600_000_000)]
    assert [truth.header.stamp for truth in truths] == [scan.header.stamp for scan in scans]
    scan = scans[0]
    assert (list(scan.gap_voltages), list(scan.lit_sources)) == ([0.25, 0.5, 0.75], [0, 1])
    assert (scan.samples, scan.header.frame_id) == (1, "posor_receiving")
    assert math.isnan(scan.supply_voltage)
    assert math.isnan(scan.temperature)
    assert [len(scan.ring_voltages), len(scan.gap_voltage_spreads), len(scan.diode_current_spreads)] == [0, 0, 0]
    a, b, c, d = np.array(scan.diode_currents).reshape(2, 4).T
    np.testing.assert_allclose([a + c, b + d], 1e-4, rtol=1e-15)
    np.testing.assert_allclose([(a - c) / (a + c), (b - d) / (b + d)], [[0.5, -0.5], [0.125, 0.0625]], rtol=1e-15)
    point = truths[2].point
    assert [point.x, point.y, point.z] == pytest.approx([0.0508, -0.0508, 0.0254], rel=1e-15)
    assert math.isnan(truths[1].point.x)
    assert {truth.header.frame_id for truth in truths} == {"machining_centre"}


@pytest.mark.parametrize(
    ("row", "sentence"),
    [
        (ROWS[0].replace("-0.5", "-1.5"), "column 'dx2' holds -1.5, which is no ratio of currents; expected -1 to 1."),
        ("1.5" + ROWS[0][1:], "column 'step': scan number 1.5; expected ascending whole numbers."),
        (ROWS[0].replace("0.25", "x"), "line 4, column 'l1_v': 'x' is invalid; expected a number, or leave_out"),
        (ROWS[1].replace("nan", "n.a."), "column 'x_in': 'n.a.' is invalid"),
        (ROWS[0] + "\n" + ROWS[0], "line 5, column 'step': scan number 1 after 1; expected ascending"),
    ],
)
def test_invalid_row_is_refused(row: str, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(DataFileError) as caught:
        messages(write_table(tmp_path / "t.csv", row))
    assert sentence in str(caught.value)


def followed_table(path: Path, follow: float) -> tuple[TableSource, Iterator[int]]:
    """Return a source that follows a table, and an iterator of its scan numbers."""
    source = TableSource(TableParameters(path=str(path), map=str(MAP), follow=follow), MessageTypes())
    source.open()
    messages = schedule_replay(source, CLASSES, ReplayParameters(), 0)
    scans = ((each.after_s, deserialize_message(each.data, RawScan).scan) for each in messages if each.topic == "raw")
    return source, (number for after_s, number in scans if after_s == 0.0)


def test_rows_that_another_program_adds_are_followed_until_there_are_none(tmp_path: Path) -> None:
    path = write_table(tmp_path / "t.csv", *ROWS[:2])
    with path.open("a", encoding="utf-8") as table:
        _, numbers = followed_table(path, 0.3)
        assert list(islice(numbers, 2)) == [1, 2]
        table.write(f"{ROWS[2]}\n{ROWS[3][:9]}")  # a row, and a part of the next one
        table.flush()
        assert next(numbers) == 3
        table.write(f"{ROWS[3][9:]}\n")
        table.flush()
        assert list(numbers) == [5]


def test_a_followed_table_must_only_grow(tmp_path: Path) -> None:
    path = write_table(tmp_path / "t.csv", *ROWS[:2])
    source, numbers = followed_table(path, math.inf)
    assert list(islice(numbers, 2)) == [1, 2]
    write_table(path, ROWS[1])
    with pytest.raises(DataFileError, match=r"no longer begins with the 2 rows that were read; expected a table to"):
        next(numbers)
    source.stopping = lambda: True
    assert len(list(source.read_messages())) == 4  # scans and truths
    path.write_bytes(b"PAR1 and more")
    with pytest.raises(DataFileError, match=r"is a Parquet file, which cannot be read while another program writes it"):
        source.open()


def test_joint_of_the_map_is_checked(tmp_path: Path) -> None:
    table = str(write_table(tmp_path / "t.csv"))
    with pytest.raises(ParameterError, match="joint 'elbow' is not in the map; expected one of joint1"):
        TableSource(TableParameters(path=table, map=str(MAP), joint="elbow"), MessageTypes()).open()


def write_two_joints(folder: Path) -> tuple[Path, Path]:
    """Write a table of two joints with a laser and a tracker, and its map."""
    table, table_map = folder / "two.csv", folder / "two.yaml"
    rows = [f"{n / 10},{n / 100},{-n / 100},{n},1,2,3,0,0,0,1,over" for n in range(4)]
    table.write_text("\n".join(["t,a,b,laser,x,y,z,qx,qy,qz,qw,note", *rows, "0.4,1"]) + "\n", encoding="utf-8")
    gap = {
        joint: {"frame_id": f"{joint}_receiving", "gap_voltages": [{"column": joint, "unit": "V"}]} for joint in "ab"
    }
    laser = {"reading": {"column": "laser", "unit": "um"}, "standard_uncertainty": {"value": 2e-8, "unit": "m"}}
    tracker = {
        "position": [{"column": axis, "unit": "mm"} for axis in "xyz"],
        "quaternion": [{"column": f"q{axis}", "unit": "1"} for axis in "xyzw"],
        "child_frame_id": "target",
    }
    content = {
        "format": "posor_table_map",
        "version": 1,
        "name": "rig",
        "time": {"column": "t", "unit": "s", "start": "2026-11-25T10:00:00Z"},
        "leave_out": ["incomplete_rows"],
        "joints": gap,
        "references": {
            "laser": {"frame_id": "table", **laser},
            "tracker": {"joint": "b", "frame_id": "table", **tracker},
        },
    }
    table_map.write_text(yaml.safe_dump(content), encoding="utf-8")
    return table, table_map


def test_import_writes_all_joints_and_references(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, table_map = write_two_joints(tmp_path)
    bag = tmp_path / "bag"
    assert main([str(table), "--map", str(table_map), "--output", str(bag)]) == 0
    printed = capsys.readouterr().out
    assert "/rig/a/raw: <4 scans: 1 gap voltages over 0.300 s> of joint a" in printed
    assert "columns left out: note" in printed
    assert "rows left out: 1 (incomplete_rows)" in printed
    for joint in "ab":
        recorded = read_scans(bag, f"/rig/{joint}/raw")
        expected = read_table(table, table_map, joint)
        np.testing.assert_array_equal(recorded.gap_voltages, expected.gap_voltages)
        np.testing.assert_array_equal(recorded.stamps_ns, expected.stamps_ns)
    with Reader(bag) as reader:
        found: dict[str, list[Any]] = {}
        kinds = {"/reference/laser": ReferenceReading, "/reference/tracker": TransformStamped}
        for connection, _, data in reader.messages():
            if connection.topic in kinds:
                found.setdefault(connection.topic, []).append(deserialize_message(bytes(data), kinds[connection.topic]))
    laser, tracker = found["/reference/laser"], found["/reference/tracker"]
    assert [each.value for each in laser] == pytest.approx([0.0, 1e-6, 2e-6, 3e-6])
    assert {(each.unit, each.standard_uncertainty, each.header.frame_id) for each in laser} == {("m", 2e-8, "table")}
    assert (tracker[0].child_frame_id, tracker[0].transform.translation.y) == ("target", pytest.approx(2e-3))
    assert main([str(table), "--map", str(table_map), "--output", str(bag), "--force"]) == 0
    stated = custom_data(bag)
    assert stated["posor.table"].startswith("two.csv sha256 ")
    assert "incomplete_rows" in stated["posor.table_left_out"]


def test_import_counts_flagged_scans_and_names_a_pattern_that_matches_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = write_table(tmp_path / "t.csv")
    flags = {"saturated": {"column": "repaired", "pattern": "OVER"}}
    flags["probes_estimated"] = {"column": "repaired", "pattern": "l[123]_v:absent"}
    joints = yaml.safe_load(MAP.read_text(encoding="utf-8"))["joints"]
    joints["joint1"]["flags"] = flags
    assert main([str(table), "--map", str(write_map(tmp_path / "map.yaml", joints=joints))]) == 0
    printed = capsys.readouterr().out
    assert "/joint1/raw: saturated in 0 of 4 scans\n" in printed
    assert "/joint1/raw: probes_estimated in 1 of 4 scans\n" in printed
    note = (
        "note: saturated of joint joint1 is set in no scan: pattern 'OVER' is in no cell of column 'repaired', which "
    )
    assert note + "holds 'y_in:absent-implied-zero(output);l1_v:smooth', " in printed
    assert printed.count("is set in no scan") == 1


@pytest.mark.parametrize(
    ("options", "code", "sentence"),
    [
        (["--map", "{map}", "--output", "{folder}"], 1, "exists already; expected a new folder, or --force."),
        (
            ["--map", "{map}", "--output", "{folder}", "--force"],
            1,
            "is not a bag of this program alone; expected a new",
        ),
        (["--map", "{map}", "--output", "/proc/bag"], 1, "/proc/bag: cannot be written, "),
        ([], 2, "import: --map is missing; expected --map MAP.yaml, or --propose to make one."),
        (["--propose"], 2, "import --propose: no calibration is named; expected --arm or --calibration."),
        (["--propose", "--calibration", "x"], 2, "import --calibration: 'x'; expected JOINT=FILE."),
        (["--propose", "--map", "{map}"], 2, "import: --propose with --map or --output; expected "),
        (["--map", "{map}", "--calibration", "a=b"], 2, "expected calibration: in the map."),
    ],
)
def test_import_refuses_wrong_options(
    options: list[str], code: int, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, table_map = write_two_joints(tmp_path)
    assert main([str(table), *(option.format(map=table_map, folder=tmp_path) for option in options)]) == code
    errors = capsys.readouterr().err
    assert sentence in errors
    assert errors.count("\n") == 1


def test_a_table_that_is_refused_leaves_no_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = write_table(tmp_path / "t.csv", header=HEADER.replace("l1_v", "L1"))
    table_map, bag = write_map(tmp_path / "m.yaml"), tmp_path / "bag"
    assert main([str(table), "--map", str(table_map), "--output", str(bag)]) == 1
    assert "column 'l1_v' of" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["m.yaml", "t.csv"]
