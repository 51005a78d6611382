"""Reads the CSV layout of the 1985 test records.

Comment lines begin with ``#``; then a header row; then one row per step. Columns: step; y_in, z_in, x_in (readings of
the machining centre [inch], NaN where not recorded); l1_v, l2_v, l3_v (gap probe outputs [V]); dx1, dy1, dx2, dy2
(contact current ratios of the two diodes [-]); repaired (``cell:method`` parted by semicolons; a method that begins
with ``absent`` marks a cell that was filled in, not read).
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor_estimator.errors import DataFileError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

METRES_PER_INCH = 0.0254
TRUTH_COLUMNS = ("x_in", "y_in", "z_in")
PROBE_COLUMNS = ("l1_v", "l2_v", "l3_v")
DIODE_COLUMNS = ("dx1", "dy1", "dx2", "dy2")
COLUMNS = ("step", *TRUTH_COLUMNS, *PROBE_COLUMNS, *DIODE_COLUMNS, "repaired")


@dataclass(frozen=True)
class TableRow:
    """One step of a recorded test, in SI units."""

    step: int
    truth: tuple[float, float, float]
    """Machining centre's x, y, z [m]; NaN where not recorded."""
    gap_voltages: tuple[float, ...]
    """[V]."""
    ratios: tuple[float, ...]
    """Contact current ratios dx1, dy1, dx2, dy2 [-]."""
    probes_estimated: bool
    """Whether a probe voltage was filled in."""
    diodes_estimated: bool
    """Whether a diode ratio was filled in."""


def read_table(path: Path) -> list[TableRow]:
    """Return the rows of a table.

    Raises:
        DataFileError: the file cannot be read, a column is missing, a row is ragged, or a cell is wrong.

    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise DataFileError(f"cannot be read, {(error.strerror or str(error)).lower()}", where=str(path)) from None
    except UnicodeDecodeError as error:
        raise DataFileError(f"is not text, byte {error.start} is no UTF-8", where=str(path)) from None
    lines = _cells(text)
    number, header = next(lines, (0, []))
    if not header:
        raise DataFileError("is empty", where=str(path), expected="a header row and one row per step")
    for column in COLUMNS:
        if header.count(column) != 1:
            what = f"column '{column}' is missing" if column not in header else f"column '{column}' is there twice"
            raise DataFileError(what, where=f"{path}, line {number}", expected="columns " + ", ".join(COLUMNS))
    rows: list[TableRow] = []
    for number, cells in lines:
        where = f"{path}, line {number}"
        if len(cells) != len(header):
            raise DataFileError(
                f"there are {len(cells)} cells", where=where, expected=f"{len(header)}, as in the header"
            )
        row = _row(dict(zip(header, cells, strict=True)), where)
        if rows and row.step <= rows[-1].step:
            raise DataFileError(
                f"step {row.step} follows step {rows[-1].step}",
                where=f"{where}, column 'step'",
                expected="a greater one",
            )
        rows.append(row)
    if not rows:
        raise DataFileError("holds no steps", where=str(path), expected="one row per step after the header")
    return rows


def _cells(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of every line that is neither empty nor a comment."""
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip() and not line.startswith("#"):
            yield number, [cell.strip() for cell in next(csv.reader([line]))]


def _row(cells: Mapping[str, str], where: str) -> TableRow:
    def finite(column: str) -> float:
        return _number(cells[column], f"{where}, column '{column}'")

    def reading(column: str) -> float:
        return math.nan if cells[column].lower() == "nan" else finite(column) * METRES_PER_INCH

    step = cells["step"]
    if not (step.isascii() and step.isdigit()):
        raise DataFileError(f"'{step}' is no step number", where=f"{where}, column 'step'", expected="0, 1, 2...")
    ratios = {column: finite(column) for column in DIODE_COLUMNS}
    for column, ratio in ratios.items():
        if abs(ratio) > 1.0:
            raise DataFileError(
                f"{cells[column]} is no ratio of currents", where=f"{where}, column '{column}'", expected="-1 to 1"
            )
    absent = _absent_cells(cells["repaired"], f"{where}, column 'repaired'")
    x, y, z = (reading(column) for column in TRUTH_COLUMNS)
    return TableRow(
        step=int(step),
        truth=(x, y, z),
        gap_voltages=tuple(finite(column) for column in PROBE_COLUMNS),
        ratios=tuple(ratios.values()),
        probes_estimated=not absent.isdisjoint(PROBE_COLUMNS),
        diodes_estimated=not absent.isdisjoint(DIODE_COLUMNS),
    )


def _number(cell: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in cell:
        raise DataFileError(f"'{cell}' is wrong", where=where, expected="a finite number")
    return value


def _absent_cells(text: str, where: str) -> set[str]:
    """Return the columns whose cell was filled in rather than read."""
    absent = set()
    for item in filter(None, text.split(";")):
        column, colon, method = item.partition(":")
        if not colon or column not in COLUMNS:
            raise DataFileError(f"'{item}' is wrong", where=where, expected="cell:method with the name of a column")
        if method.startswith("absent"):
            absent.add(column)
    return absent
