"""What the thesis printed about a motion test: result columns of appendix 8B, predicted errors of section 8.4."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor_estimator.errors import DataFileError

from posor_bringup.motion import ANGLES, Angle

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from posor_estimator.core.types import FloatArray

URAD = 1e-6

PRINTED_FILES: Mapping[str, str] = {"ymo": "ymo_output.csv"}
"""Tests whose printed result table is in this repository."""

EXPECTED_ERRORS_FILE = "expected_errors.csv"


@dataclass(frozen=True)
class PrintedColumns:
    """The printed result table of one test.

    Attributes:
        posor: Alpha, beta, theta that the 1985 program printed [rad], shape (n, 3).
        measured: The same by the machining centre [rad], shape (n, 3).

    """

    posor: FloatArray
    measured: FloatArray


@dataclass(frozen=True)
class Band:
    """The error that section 8.4 predicts: ``constant`` at once, ``increasing`` in step with the motion [rad].

    Attributes:
        constant: Sum of the terms that do not grow: random, stage, table 7.9.
        increasing: What is added at the end of the motion.
        terms: The terms as the source has them.

    """

    constant: float
    increasing: float
    terms: str

    def at(self, measured: FloatArray) -> FloatArray:
        """Return the half-width [rad] at each step of a motion ``measured`` by the machining centre, shape (n,)."""
        extent = np.nanmax(np.abs(measured))
        return self.constant + self.increasing * (
            np.abs(measured) / extent if extent > 0.0 else np.zeros(len(measured))
        )


def read_table(path: Path, columns: Iterable[str]) -> list[dict[str, str]]:
    """Return the rows of a CSV file whose comment lines begin with ``#``.

    Raises:
        DataFileError: The file cannot be read or lacks one of ``columns``.

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


def read_printed(path: Path) -> PrintedColumns:
    """Return the columns of a printed result table.

    Raises:
        DataFileError: The file cannot be read, lacks a column, has a cell that is no number, or steps out of order.

    """
    names = {kind: [f"{angle}_{kind}_urad" for angle in ANGLES] for kind in ("posor", "meas")}
    rows = read_table(path, ["step", *names["posor"], *names["meas"]])
    for count, row in enumerate(rows, start=1):
        if row["step"] != str(count):
            raise DataFileError(
                f"step '{row['step']}' stands in row {count}", where=str(path), expected=f"step {count}"
            )
    posor, measured = (
        np.array([[_number(row, name, path) for name in names[kind]] for row in rows]) * URAD
        for kind in ("posor", "meas")
    )
    return PrintedColumns(posor, measured)


def _number(row: Mapping[str, str], column: str, path: Path) -> float:
    try:
        return float(row[column])
    except ValueError:
        raise DataFileError(
            f"'{row[column]}' is no number", where=f"{path}, step {row['step']}, column '{column}'", expected="a number"
        ) from None


_TERM = re.compile(r"\s*(?P<name>random|increasing|twist stage|stage straightness|table 7\.9 terms)\s+(?P<urad>[\d.]+)")


def read_bands(path: Path, test: str) -> dict[Angle, Band]:
    """Return the predicted error of each angle in ``test`` ("ymo"), or none where section 8.4 has no row for it.

    Where a test has no row of its own, only the random part of the row for all tests holds: the increasing part
    depends on how far the probes travel.

    Raises:
        DataFileError: The file cannot be read, or a prediction is not made of known terms.

    """
    bands: dict[Angle, Band] = {}
    rows = read_table(path, ["test", "dof", "unit", "predicted"])
    for angle in ANGLES:
        own = [row for row in rows if row["test"] == test.upper() and row["dof"] == angle]
        shared = [row for row in rows if row["test"] == "all" and row["dof"] == angle]
        for row in (own or shared)[:1]:
            terms = _terms(row["predicted"], path, row)
            if not own:
                terms = {name: size for name, size in terms.items() if name == "random"}
            increasing = terms.pop("increasing", 0.0)
            text = row["predicted"] if own else "; ".join(f"{name} {size:g}" for name, size in terms.items())
            bands[angle] = Band(sum(terms.values()) * URAD, increasing * URAD, text)
    return bands


def _terms(predicted: str, path: Path, row: Mapping[str, str]) -> dict[str, float]:
    terms: dict[str, float] = {}
    for part in predicted.split(";"):
        match = _TERM.match(part)
        if match is None:
            raise DataFileError(
                f"'{part.strip()}' is no predicted error",
                where=f"{path}, test {row['test']}, dof {row['dof']}",
                expected="terms such as 'random 6; increasing 13'",
            )
        terms[match["name"]] = float(match["urad"])
    return terms
