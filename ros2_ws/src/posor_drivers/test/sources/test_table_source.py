"""Source ``table``: the CSV layout of the 1985 records, as scans and truth."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped
from posor.errors import DataFileError
from posor.messages.message_definitions import MessageTypes
from posor.numerics.stamps import NS
from posor_drivers.sources.source import Topic
from posor_drivers.sources.table_source import TableParameters, TableSource, contact_currents, read_table
from posor_msgs.msg import RawScan
from rclpy.serialization import deserialize_message

from ..sample_tables import HEADER, ROWS, write_table


def open_source(folder: Path, **parameters: Any) -> TableSource:
    source = TableSource(TableParameters(path=str(write_table(folder / "t.csv")), **parameters), MessageTypes())
    raw, truth = source.open()
    assert raw == Topic("raw", "posor_msgs/msg/RawScan")
    assert truth == Topic(parameters.get("truth_topic", "/truth/machining_centre"), "geometry_msgs/msg/PointStamped")
    return source


def messages(folder: Path, **parameters: Any) -> tuple[list[RawScan], list[PointStamped]]:
    scans: list[RawScan] = []
    truths: list[PointStamped] = []
    for message in open_source(folder, **parameters).read_messages():
        is_scan = message.topic == "raw"
        content = deserialize_message(message.data, RawScan if is_scan else PointStamped)
        stamp = content.header.stamp
        assert message.time_ns == stamp.sec * NS + stamp.nanosec
        (scans if is_scan else truths).append(content)
    return scans, truths


def test_scan_holds_the_cells_of_its_row(tmp_path: Path) -> None:
    scans, _ = messages(tmp_path)
    assert [scan.scan for scan in scans] == [1, 2, 3, 5]
    estimated = [0, RawScan.STATUS_PROBES_ESTIMATED, RawScan.STATUS_DIODES_ESTIMATED, 0]
    assert [scan.status for scan in scans] == estimated
    scan = scans[0]
    assert list(scan.gap_voltages) == [0.25, 0.5, 0.75]
    assert list(scan.lit_sources) == [0, 1]
    assert scan.samples == 1
    assert scan.header.frame_id == "posor_receiving"
    assert math.isnan(scan.supply_voltage)
    assert math.isnan(scan.temperature)
    assert [len(scan.ring_voltages), len(scan.gap_voltage_spreads), len(scan.diode_current_spreads)] == [0, 0, 0]


def test_currents_have_the_recorded_ratios_and_the_nominal_total(tmp_path: Path) -> None:
    scans, _ = messages(tmp_path, nominal_total=1e-4)
    currents = np.array(scans[0].diode_currents).reshape(2, 4)
    np.testing.assert_allclose(currents.sum(axis=1), 1e-4, rtol=1e-15)
    a, b, c, d = currents.T
    np.testing.assert_allclose(a + c, 0.5e-4, rtol=1e-15)
    np.testing.assert_allclose((a - c) / (a + c), [0.5, -0.5], rtol=1e-15)
    np.testing.assert_allclose((b - d) / (b + d), [0.125, 0.0625], rtol=1e-15)


def test_ratios_are_recovered_to_the_last_digits() -> None:
    ratios = np.random.default_rng(1985).uniform(-1.0, 1.0, 2000)
    a, b, c, d = contact_currents(list(ratios), 200e-6).reshape(-1, 4).T
    recovered = np.stack([(a - c) / (a + c), (b - d) / (b + d)], axis=1).ravel()
    np.testing.assert_allclose(recovered, ratios, atol=5e-16, rtol=0.0)


def test_stamps_follow_the_parameters_and_scan_and_truth_share_them(tmp_path: Path) -> None:
    scans, truths = messages(tmp_path, start=1000.25, period=0.5)
    stamps = [(scan.header.stamp.sec, scan.header.stamp.nanosec) for scan in scans]
    assert stamps == [(1000, 250_000_000), (1000, 750_000_000), (1001, 250_000_000), (1001, 750_000_000)]
    assert [truth.header.stamp for truth in truths] == [scan.header.stamp for scan in scans]


def test_truth_is_in_metres_with_nan_where_nothing_was_recorded(tmp_path: Path) -> None:
    _, truths = messages(tmp_path, truth_topic="/elsewhere")
    point = truths[2].point
    assert [point.x, point.y, point.z] == pytest.approx([0.0508, -0.0508, 0.0254], rel=1e-15)
    assert math.isnan(truths[1].point.x)
    assert {truth.header.frame_id for truth in truths} == {"machining_centre"}


def test_each_pass_gives_the_same_bytes(tmp_path: Path) -> None:
    source = open_source(tmp_path)
    assert list(source.read_messages()) == list(source.read_messages())


def test_order_of_columns_is_free(tmp_path: Path) -> None:
    header, *rows = [",".join(reversed(line.split(","))) for line in (HEADER, *ROWS)]
    path = write_table(tmp_path / "t.csv", *rows, header=header)
    assert str(read_table(path)) == str(read_table(write_table(tmp_path / "u.csv")))


def refusal(path: Path) -> str:
    with pytest.raises(DataFileError) as caught:
        read_table(path)
    sentence = str(caught.value)
    assert sentence.startswith(str(path))
    return sentence.removeprefix(str(path))


@pytest.mark.parametrize("column", HEADER.split(","))
def test_missing_column_is_named(tmp_path: Path, column: str) -> None:
    path = write_table(tmp_path / "t.csv", header=HEADER.replace(column, "other", 1))
    assert refusal(path).startswith(f", line 3: column '{column}' is missing; expected columns step, x_in, ")


@pytest.mark.parametrize("cell", ["", "abc", "0.2O", "nan", "inf", "1e999", "1_0", "0,5"])
def test_invalid_number_is_reported_with_file_line_column_and_value(tmp_path: Path, cell: str) -> None:
    path = write_table(tmp_path / "t.csv", ROWS[0], ROWS[1].replace("0.51", f'"{cell}"', 1))
    assert refusal(path) == f", line 5, column 'l2_v': '{cell}' is invalid; expected a finite number."


@pytest.mark.parametrize("step", ["-1", "1.5", "", "one", "²"])
def test_step_is_a_whole_number(tmp_path: Path, step: str) -> None:
    path = write_table(tmp_path / "t.csv", step + ROWS[0][1:])
    assert refusal(path) == f", line 4, column 'step': '{step}' is not a step number; expected 0, 1, 2...."


@pytest.mark.parametrize("item", ["l1_v", "l9_v:smooth", ":smooth"])
def test_repair_note_without_a_cell_is_refused(tmp_path: Path, item: str) -> None:
    path = write_table(tmp_path / "t.csv", ROWS[3] + item)
    sentence = f", line 4, column 'repaired': '{item}' is invalid; expected cell:method with the name of a column."
    assert refusal(path) == sentence


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        ([ROWS[0], ROWS[1].rsplit(",", 1)[0]], ", line 5: there are 11 cells; expected 12, as in the header."),
        ([ROWS[0] + ",7"], ", line 4: there are 13 cells; expected 12, as in the header."),
        ([ROWS[1], ROWS[1]], ", line 5, column 'step': step 2 follows step 2; expected ascending steps."),
        ([ROWS[1].replace("nan", "n/a")], ", line 4, column 'x_in': 'n/a' is invalid; expected a finite number."),
        (
            [ROWS[0].replace("-0.5", "-1.5")],
            ", line 4, column 'dx2': -1.5 is not a ratio of currents; expected -1 to 1.",
        ),
    ],
)
def test_invalid_row_is_refused(tmp_path: Path, rows: list[str], sentence: str) -> None:
    assert refusal(write_table(tmp_path / "t.csv", *rows)) == sentence


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", ": is empty; expected a header row and one row per step."),
        (b"\n\n", ": is empty; expected a header row and one row per step."),
        (b"# only\n# comments\n", ": is empty; expected a header row and one row per step."),
        (f"# c\n{HEADER}\n".encode(), ": has no steps; expected one row per step after the header."),
        (b"# \xff\xfe\n", ": is not text, byte 2 is not UTF-8."),
    ],
)
def test_file_without_steps_is_refused(tmp_path: Path, content: bytes, sentence: str) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes(content)
    assert refusal(path) == sentence


def test_unreadable_file_and_doubled_column_are_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path / "none.csv") == ": cannot be read, no such file or directory."
    assert refusal(tmp_path) == ": cannot be read, is a directory."
    doubled = write_table(tmp_path / "t.csv", header=HEADER.replace("dy1", "dx1"))
    assert refusal(doubled).startswith(", line 3: column 'dx1' occurs twice; expected columns ")
