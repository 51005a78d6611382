from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest
from posor_drivers.sources.table_file import read_table
from posor_estimator.errors import DataFileError

from .tables import HEADER, ROWS, write_table

if TYPE_CHECKING:
    from pathlib import Path


def refusal(path: Path) -> str:
    with pytest.raises(DataFileError) as caught:
        read_table(path)
    sentence = str(caught.value)
    assert sentence.startswith(str(path))
    return sentence.removeprefix(str(path))


def test_rows_are_read_in_si_units(tmp_path: Path) -> None:
    rows = read_table(write_table(tmp_path / "t.csv"))
    assert [row.step for row in rows] == [1, 2, 3, 5]
    assert rows[2].truth == pytest.approx((0.0508, -0.0508, 0.0254), abs=0.0, rel=1e-15)
    assert math.isnan(rows[1].truth[0])
    assert rows[0].gap_voltages == (0.25, 0.5, 0.75)
    assert rows[0].ratios == (0.5, 0.125, -0.5, 0.0625)


def test_only_cells_without_any_digit_count_as_estimated(tmp_path: Path) -> None:
    rows = read_table(write_table(tmp_path / "t.csv"))
    assert [row.probes_estimated for row in rows] == [False, True, False, False]
    assert [row.diodes_estimated for row in rows] == [False, False, True, False]


def test_order_of_columns_is_free(tmp_path: Path) -> None:
    backwards = [",".join(reversed(line.split(","))) for line in (HEADER, *ROWS)]
    path = write_table(tmp_path / "t.csv", *backwards[1:], header=backwards[0])
    assert str(read_table(path)) == str(read_table(write_table(tmp_path / "u.csv")))


@pytest.mark.parametrize("column", HEADER.split(","))
def test_missing_column_is_named(tmp_path: Path, column: str) -> None:
    header = HEADER.replace(column, "other", 1)
    path = write_table(tmp_path / "t.csv", header=header)
    assert refusal(path).startswith(f", line 3: column '{column}' is missing; expected columns step, x_in, ")


def test_column_twice_is_refused(tmp_path: Path) -> None:
    assert refusal(write_table(tmp_path / "t.csv", header=HEADER.replace("dy1", "dx1"))).startswith(
        ", line 3: column 'dx1' is there twice; expected columns "
    )


@pytest.mark.parametrize("cell", ["", "abc", "0.2O", "nan", "inf", "1e999", "1_0", "0,5"])
def test_cell_that_is_no_number_is_told_with_file_line_column_and_value(tmp_path: Path, cell: str) -> None:
    row = ROWS[1].replace("0.51", f'"{cell}"', 1)
    path = write_table(tmp_path / "t.csv", ROWS[0], row)
    assert refusal(path) == f", line 5, column 'l2_v': '{cell}' is wrong; expected a finite number."


def test_machining_centre_cell_may_be_nan_but_not_wrong(tmp_path: Path) -> None:
    path = write_table(tmp_path / "t.csv", ROWS[1].replace("nan", "n/a"))
    assert refusal(path) == ", line 4, column 'x_in': 'n/a' is wrong; expected a finite number."


def test_ragged_row_is_refused(tmp_path: Path) -> None:
    path = write_table(tmp_path / "t.csv", ROWS[0], ROWS[1].rsplit(",", 1)[0])
    assert refusal(path) == ", line 5: there are 11 cells; expected 12, as in the header."
    path = write_table(tmp_path / "t.csv", ROWS[0] + ",7")
    assert refusal(path) == ", line 4: there are 13 cells; expected 12, as in the header."


@pytest.mark.parametrize("step", ["-1", "1.5", "", "one", "²"])
def test_step_is_a_whole_number(tmp_path: Path, step: str) -> None:
    path = write_table(tmp_path / "t.csv", step + ROWS[0][1:])
    assert refusal(path) == f", line 4, column 'step': '{step}' is no step number; expected 0, 1, 2...."


def test_steps_rise(tmp_path: Path) -> None:
    path = write_table(tmp_path / "t.csv", ROWS[1], ROWS[1])
    assert refusal(path) == ", line 5, column 'step': step 2 follows step 2; expected a greater one."


def test_ratio_beyond_one_is_refused(tmp_path: Path) -> None:
    path = write_table(tmp_path / "t.csv", ROWS[0].replace("-0.5", "-1.5"))
    assert refusal(path) == ", line 4, column 'dx2': -1.5 is no ratio of currents; expected -1 to 1."


@pytest.mark.parametrize("item", ["l1_v", "l9_v:smooth", ":smooth"])
def test_repair_note_that_names_no_cell_is_refused(tmp_path: Path, item: str) -> None:
    path = write_table(tmp_path / "t.csv", ROWS[3] + item)
    assert refusal(path) == (
        f", line 4, column 'repaired': '{item}' is wrong; expected cell:method with the name of a column."
    )


def test_files_without_content_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    for text in ("", "\n\n", "# only\n# comments\n"):
        path.write_text(text, encoding="utf-8")
        assert refusal(path) == ": is empty; expected a header row and one row per step."
    path.write_text(f"# c\n{HEADER}\n", encoding="utf-8")
    assert refusal(path) == ": holds no steps; expected one row per step after the header."


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path / "none.csv") == ": cannot be read, no such file or directory."
    assert refusal(tmp_path) == ": cannot be read, is a directory."
    path = tmp_path / "t.csv"
    path.write_bytes(b"# \xff\xfe\n")
    assert refusal(path) == ": is not text, byte 2 is no UTF-8."
