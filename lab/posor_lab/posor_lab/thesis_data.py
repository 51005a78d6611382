"""Printed tables of the thesis that this package installs: CSV files whose comment lines begin with ``#``."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

from ament_index_python.packages import get_package_share_directory
from posor.errors import DataFileError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

URAD = 1e-6


def data_path(name: str) -> Path:
    """Return the path of a table of the thesis."""
    return Path(get_package_share_directory("posor_lab")) / "data" / name


def read_table(path: Path, columns: Iterable[str]) -> list[dict[str, str]]:
    """Return the rows of a table.

    Raises:
        DataFileError: The file cannot be read, or one of ``columns`` is missing.

    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise DataFileError(f"cannot be read: {reason}", where=str(path), expected="a table of the thesis") from error
    reader = csv.DictReader(line for line in lines if not line.startswith("#"))
    missing = [name for name in columns if name not in (reader.fieldnames or ())]
    if missing:
        raise DataFileError(f"column '{missing[0]}' is missing", where=str(path))
    return list(reader)


def parse_number(row: Mapping[str, str], column: str, row_name: str, expected: str = "a number") -> float:
    """Return a cell as a number.

    Raises:
        DataFileError: The cell is not a number; ``row_name`` (file and row) and column say where.

    """
    try:
        return float(row[column])
    except ValueError:
        where = f"{row_name}, column '{column}'"
        raise DataFileError(f"'{row[column]}' is not a number", where=where, expected=expected) from None


def read_numbers(path: Path, key: str, column: str, names: Collection[str] = ()) -> dict[str, float]:
    """Return a column of a table as numbers, by the text of another column; ``names``: only these rows.

    Raises:
        DataFileError: The table cannot be read, lacks a column, or has an invalid number.

    """
    rows = read_table(path, [key, column])
    chosen = [row for row in rows if not names or row[key] in names]
    return {row[key]: parse_number(row, column, f"{path}, {row[key]}") for row in chosen}


def last_digit(text: str) -> float:
    """Return one unit of the last digit of a printed number, such as ``.0065`` or ``5.6e-9``."""
    mantissa, _, exponent = text.lower().partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
