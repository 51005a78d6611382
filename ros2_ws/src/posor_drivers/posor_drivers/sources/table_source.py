"""Source ``table``: a recorded test in the CSV layout of the 1985 records.

Comment lines start with ``#``; then follow a header row and one row per step. Columns: step; y_in, z_in, x_in (readings
of the machining centre [inch], NaN where not recorded); l1_v, l2_v, l3_v (gap probe outputs [V]); dx1, dy1, dx2, dy2
(contact current ratios of the two diodes [-]); repaired (``cell:method`` separated by semicolons; a method that starts
with ``absent`` marks a cell that was filled in, not read).
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from posor.errors import DataFileError
from posor.input_text import read_input_text
from posor.model.scan import DIODES_ESTIMATED, PROBES_ESTIMATED
from posor.parameter_model import ParameterGroup
from posor.ros_names import POINT_STAMPED, RAW_SCAN, RAW_TOPIC, TRUTH_TOPIC
from pydantic import Field
from scipy.constants import inch

from posor_drivers.message_builder import point_stamped, raw_scan
from posor_drivers.sources.source import RecordedSource, SourceMessage, Topic

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from posor.numerics.array_types import FloatArray

TRUTH_COLUMNS = ("x_in", "y_in", "z_in")
PROBE_COLUMNS = ("l1_v", "l2_v", "l3_v")
DIODE_COLUMNS = ("dx1", "dy1", "dx2", "dy2")
COLUMNS = ("step", *TRUTH_COLUMNS, *PROBE_COLUMNS, *DIODE_COLUMNS, "repaired")

LIT_SOURCES = np.array([0, 1], dtype=np.uint8)
"""Diode 1 sees light source 1, diode 2 light source 2; both were lit throughout."""


class TableParameters(ParameterGroup):
    """Parameters of the source ``table``."""

    path: Annotated[str, Field(min_length=1)] = Field(description="CSV file of the recorded test")
    frame_id: Annotated[str, Field(min_length=1)] = Field(
        default="posor_receiving", description="frame of the receiving plate, as in the calibration file"
    )
    nominal_total: Annotated[float, Field(gt=0.0)] = Field(
        default=200e-6,
        description="sum of the four contact currents of a diode [A]; the record holds their ratios only",
    )
    start: Annotated[float, Field(gt=0.0, lt=2**31)] = Field(
        default=486_432_000.0, description="stamp of the first step [s since 1970]; default 1985-06-01 00:00:00 UTC"
    )
    period: Annotated[float, Field(gt=0.0)] = Field(default=0.2, description="time from step to step [s]")
    truth_topic: Annotated[str, Field(min_length=1)] = Field(
        default=TRUTH_TOPIC, description="topic of the machining centre's readings"
    )


class TableSource(RecordedSource[TableParameters]):
    """Turns each row into a scan and the machining centre's reading with the same stamp.

    The contact currents are computed from the recorded ratios and a nominal total: A + C = B + D = total / 2. Status
    flags mark scans with cells that were filled in.
    """

    Parameters = TableParameters

    _rows: list[TableRow]

    @property
    def record(self) -> str:
        """The file."""
        return self.parameters.path

    def open(self) -> Sequence[Topic]:
        """Read the whole table."""
        self._rows = read_table(Path(self.parameters.path))
        return (Topic(RAW_TOPIC, RAW_SCAN), Topic(self.parameters.truth_topic, POINT_STAMPED))

    def read_messages(self) -> Iterator[SourceMessage]:
        """Yield scan and truth of each step."""
        parameters, types = self.parameters, self.types
        start_ns, period_ns = (round(1e9 * seconds) for seconds in (parameters.start, parameters.period))
        for index, row in enumerate(self._rows):
            time_ns = start_ns + index * period_ns
            status = PROBES_ESTIMATED * row.probes_estimated | DIODES_ESTIMATED * row.diodes_estimated
            scan = raw_scan(
                types,
                time_ns,
                parameters.frame_id,
                scan=row.step,
                status=status,
                gap_voltages=np.array(row.gap_voltages),
                diode_currents=contact_currents(row.ratios, parameters.nominal_total),
                lit_sources=LIT_SOURCES,
            )
            truth = point_stamped(types, time_ns, "machining_centre", row.truth)
            yield SourceMessage(RAW_TOPIC, time_ns, types.serialize(scan, RAW_SCAN))
            yield SourceMessage(parameters.truth_topic, time_ns, types.serialize(truth, POINT_STAMPED))


def contact_currents(ratios: Sequence[float], total: float) -> FloatArray:
    """Return the currents A, B, C, D [A] of each diode in turn.

    Their ratios are dx = (A - C) / (A + C) and dy = (B - D) / (B + D) [-] of each diode in turn, and half of their
    ``total`` [A] falls on either axis.
    """
    dx, dy = np.asarray(ratios, dtype=np.float64).reshape(-1, 2).T
    return total / 4.0 * np.stack([1.0 + dx, 1.0 + dy, 1.0 - dx, 1.0 - dy], axis=1).ravel()


@dataclass(frozen=True)
class TableRow:
    """One step of a recorded test, in SI units."""

    step: int  # number of the step
    truth: tuple[float, ...]  # machining centre's x, y, z [m]; NaN where not recorded
    gap_voltages: tuple[float, ...]  # [V]
    ratios: tuple[float, ...]  # contact current ratios dx1, dy1, dx2, dy2 [-]
    probes_estimated: bool  # whether a probe voltage was filled in
    diodes_estimated: bool  # whether a diode ratio was filled in


def read_table(path: Path) -> list[TableRow]:
    """Return the rows of a table.

    Raises:
        DataFileError: The file cannot be read, a column is missing, a row is ragged, or a cell is invalid.

    """
    try:
        text = read_input_text(path)
    except OSError as error:
        raise DataFileError(f"cannot be read, {(error.strerror or str(error)).lower()}", where=str(path)) from None
    except UnicodeDecodeError as error:
        raise DataFileError(f"is not text, byte {error.start} is not UTF-8", where=str(path)) from None
    lines = _numbered_rows(text)
    number, header = next(lines, (0, []))
    if not header:
        raise DataFileError("is empty", where=str(path), expected="a header row and one row per step")
    for column in COLUMNS:
        if header.count(column) != 1:
            what = f"column '{column}' is missing" if column not in header else f"column '{column}' occurs twice"
            raise DataFileError(what, where=f"{path}, line {number}", expected="columns " + ", ".join(COLUMNS))
    rows: list[TableRow] = []
    for number, cells in lines:
        where = f"{path}, line {number}"
        if len(cells) != len(header):
            expected = f"{len(header)}, as in the header"
            raise DataFileError(f"there are {len(cells)} cells", where=where, expected=expected)
        row = _parse_row(dict(zip(header, cells, strict=True)), where)
        if rows and row.step <= rows[-1].step:
            what = f"step {row.step} follows step {rows[-1].step}"
            raise DataFileError(what, where=f"{where}, column 'step'", expected="ascending steps")
        rows.append(row)
    if not rows:
        raise DataFileError("has no steps", where=str(path), expected="one row per step after the header")
    return rows


def _numbered_rows(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of every line that is neither empty nor a comment."""
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip() and not line.startswith("#"):
            yield number, [cell.strip() for cell in next(csv.reader([line]))]


def _parse_row(cells: Mapping[str, str], where: str) -> TableRow:
    """Return one step from the cells of its row by column."""

    def finite(column: str) -> float:
        cell = cells[column]
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or "_" in cell:
            raise DataFileError(f"'{cell}' is invalid", where=f"{where}, column '{column}'", expected="a finite number")
        return value

    def metres(column: str) -> float:
        return math.nan if cells[column].lower() == "nan" else finite(column) * inch

    step = cells["step"]
    if not (step.isascii() and step.isdigit()):
        raise DataFileError(f"'{step}' is not a step number", where=f"{where}, column 'step'", expected="0, 1, 2...")
    ratios = {column: finite(column) for column in DIODE_COLUMNS}
    for column, ratio in ratios.items():
        if abs(ratio) > 1.0:
            what = f"{cells[column]} is not a ratio of currents"
            raise DataFileError(what, where=f"{where}, column '{column}'", expected="-1 to 1")
    absent = _absent_columns(cells["repaired"], f"{where}, column 'repaired'")
    return TableRow(
        step=int(step),
        truth=tuple(map(metres, TRUTH_COLUMNS)),
        gap_voltages=tuple(map(finite, PROBE_COLUMNS)),
        ratios=tuple(ratios.values()),
        probes_estimated=not absent.isdisjoint(PROBE_COLUMNS),
        diodes_estimated=not absent.isdisjoint(DIODE_COLUMNS),
    )


def _absent_columns(text: str, where: str) -> set[str]:
    """Return the columns whose cell was filled in rather than read."""
    absent = set()
    for item in filter(None, text.split(";")):
        column, colon, method = item.partition(":")
        if not colon or column not in COLUMNS:
            raise DataFileError(f"'{item}' is invalid", where=where, expected="cell:method with the name of a column")
        if method.startswith("absent"):
            absent.add(column)
    return absent
