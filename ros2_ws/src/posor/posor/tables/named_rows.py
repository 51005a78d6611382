# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rows of a short table (CSV) whose first line names the columns, such as poses or dwells that a user states.

Columns and cells are taken as they are; ``open_table`` reads files of measurements, with their units and formats.
"""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING, NamedTuple

from posor.errors import DataFileError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


class NamedRow(NamedTuple):
    """One row."""

    line: int  # of the file; of a row over several lines, the last
    cells: dict[str, str]  # by column, without blanks around them


def read_named_rows(path: Path, columns: Sequence[str]) -> list[NamedRow]:
    """Return the rows of a table with these columns, in any order.

    Raises DataFileError: the file cannot be read, has other columns or no row, or a row has another number of cells.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, strict=True, skipinitialspace=True)
            lines = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(map(str.strip, row))]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise DataFileError(f"cannot be read: {reason}", where=str(path), expected="a table (CSV)") from error
    (first, names), *rows = lines or [(1, [])]
    if sorted(names) != sorted(columns):
        expected = f"columns {','.join(columns)}"
        raise DataFileError(f"columns {','.join(names) or 'none'}", where=f"{path}, line {first}", expected=expected)
    if not rows:
        raise DataFileError("no row", where=str(path), expected="a row below the names of the columns")
    for line, row in rows:
        if len(row) != len(names):
            raise DataFileError(f"{len(row)} cells", where=f"{path}, line {line}", expected=str(len(names)))
    return [NamedRow(line, dict(zip(names, row, strict=True))) for line, row in rows]
