# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rows that cannot be used: none is lost unseen, and the others keep their times and numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from posor import DataFileError, read_table
from posor.tables.table_readings import load_readings

from .sample_files import COUNT, START, START_NS, write_csv, write_map

AT_RATE = {"rate": {"value": 500.0, "unit": "Hz"}, "start": START}
LEFT_OUT = 2  # row from 0


@pytest.mark.parametrize(
    ("kind", "row"), [("missing_cells", "0.0040,,-254.000,20.20,ok"), ("incomplete_rows", "0.0040,712.000")]
)
def test_the_rows_after_one_that_is_left_out_keep_their_times_and_numbers(kind: str, row: str, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "daq.csv")
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[1 + LEFT_OUT] = row
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    readings = load_readings(path, write_map(tmp_path, time=AT_RATE, leave_out=[kind]))
    kept = np.delete(np.arange(COUNT), LEFT_OUT)
    scans = readings.joints["elbow"].scans
    assert readings.left_out == {kind: 1}
    np.testing.assert_array_equal(scans.stamps_ns, START_NS + 2_000_000 * kept)
    np.testing.assert_array_equal(scans.numbers, kept + 1)


@pytest.mark.parametrize("cell", ["#N/A", "#n/a", "#REF!", "#DIV/0!", "#NV", "#WERT!", "#NAME?"])
def test_a_row_that_begins_with_an_error_of_a_spreadsheet_is_no_comment(cell: str, tmp_path: Path) -> None:
    path = tmp_path / "daq.csv"
    path.write_text(f"a [V],b [V]\n# a comment\n1,2\n{cell},2\n3,4\n", encoding="utf-8")
    columns = [{"column": name, "unit": "V"} for name in ("a [V]", "b [V]")]
    joints = {"elbow": {"frame_id": "plate", "gap_voltages": columns}}
    with pytest.raises(DataFileError, match=r"daq\.csv, line 4, column 'a \[V\]'"):
        read_table(path, write_map(tmp_path, time=AT_RATE, joints=joints))
