# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Printed tables of the thesis, CSV files whose comment lines begin with ``#``, and the units of its numbers."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import TYPE_CHECKING

from ament_index_python.packages import get_package_share_directory
from posor.errors import DataFileError
from scipy.constants import arcsec, degree, foot, g, inch, lb, lbf, minute, psi

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

URAD, MICROINCH = 1e-6, 1e-6 * inch
UNITS: dict[str, float] = (  # amount of each unit; inHg: NIST SP 811, appendix B.8
    dict.fromkeys(("1", "m", "rad", "rad/s", "s", "Hz", "kg", "kg/m^3", "K", "N", "Pa", "V", "W", "A/W", "Ohm"), 1.0)
    | {"in": inch, "uin": MICROINCH, "mm": 1e-3, "um": 1e-6, "ft": foot, "in^2": inch**2, "in^4": inch**4}
    | {"urad": URAD, "deg": degree, "arcsec": arcsec, "rev/s": 2.0 * math.pi}
    | {"min": minute, "ms": 1e-3, "us": 1e-6, "g": g, "in/s^2": inch, "1/F": 1.8, "F": 1.0 / 1.8}
    | {"lb": lb, "lb/ft": lb / foot, "lb/in^3": lb / inch**3, "lbf": lbf, "in lbf": lbf * inch, "inHg": 3386.389}
    | {"psi": psi, "ksi": 1e3 * psi, "1e6 psi": 1e6 * psi, "mW": 1e-3, "pF": 1e-12, "nV/Hz^0.5": 1e-9, "ppm": 1e-6}
    | {"in/V": inch, "uin/in": 1e-6, "in/Hz^0.5": inch}
)


def amount(unit: str) -> float:
    """Return the amount of a unit in SI units; a number stands for itself.

    Raises DataFileError: the unit is unknown.
    """
    try:
        return UNITS[unit] if unit in UNITS else float(unit)
    except ValueError:
        raise DataFileError(f"unit '{unit}' is unknown", expected=f"a number or one of {', '.join(UNITS)}") from None


def data_path(name: str) -> Path:
    """Return the path of a table of the thesis."""
    return Path(get_package_share_directory("posor_lab")) / "data" / name


def read_table(path: Path, columns: Iterable[str]) -> list[dict[str, str]]:
    """Return the rows of a table.

    Raises DataFileError: the file cannot be read, lacks one of ``columns``, or has a row of another length.
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
    rows = list(reader)
    for row in rows:
        if None in row or None in row.values():
            expected = f"{len(reader.fieldnames or ())} cells; a text with a comma is in quotation marks"
            raise DataFileError(
                "another number of cells", where=f"{path}, row {next(iter(row.values()))}", expected=expected
            )
    return rows


def parse_number(row: Mapping[str, str], column: str, row_name: str, expected: str = "a number") -> float:
    """Return a cell as a number.

    Raises DataFileError: the cell is not a number; ``row_name`` (file and row) and column name the place.
    """
    try:
        return float(row[column])
    except ValueError:
        where = f"{row_name}, column '{column}'"
        raise DataFileError(f"'{row[column]}' is not a number", where=where, expected=expected) from None


def read_numbers(path: Path, key: str, column: str, names: Collection[str] = ()) -> dict[str, float]:
    """Return a column of a table as numbers, by the text of another column; ``names``: only these rows.

    Raises DataFileError: the table cannot be read, lacks a column, or has an invalid number.
    """
    rows = read_table(path, [key, column])
    selected = [row for row in rows if not names or row[key] in names]
    return {row[key]: parse_number(row, column, f"{path}, {row[key]}") for row in selected}


def last_digit(text: str) -> float:
    """Return one unit of the last digit of a printed number, such as ``.0065`` or ``5.6e-9``."""
    mantissa, _, exponent = text.lower().partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
