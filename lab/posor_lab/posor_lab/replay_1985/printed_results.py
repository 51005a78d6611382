"""Printed results of a motion test: result columns of appendix 8B, predicted errors of section 8.4."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.errors import DataFileError

from posor_lab.replay_1985.motion_test import ANGLES, Angle
from posor_lab.thesis_data import URAD, parse_number, read_table

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from posor.numerics.array_types import FloatArray

PRINTED_FILES: Mapping[str, str] = {"ymo": "ymo_output.csv"}
"""Printed result tables in this repository, by test."""
EXPECTED_ERRORS_FILE = "expected_errors.csv"


@dataclass(frozen=True)
class PrintedColumns:
    """The printed result table of one test.

    Attributes:
        posor: Alpha, beta, theta of the POSOR [rad], shape (n, 3).
        truth: The same by the machining centre [rad], shape (n, 3).

    """

    posor: FloatArray
    truth: FloatArray


@dataclass(frozen=True)
class PredictedError:
    """Error that section 8.4 predicts.

    Attributes:
        constant: Sum of the constant terms [rad]: random, stage, table 7.9.
        increasing: Additional error at the end of the motion, in proportion to it [rad].
        terms: The terms as printed.

    """

    constant: float
    increasing: float
    terms: str

    def half_width(self, truth: FloatArray) -> FloatArray:
        """Return the half-width of the error band [rad] at each step of a motion by the machining centre, (n,)."""
        extent = np.nanmax(np.abs(truth))
        share = np.abs(truth) / extent if extent > 0.0 else np.zeros(len(truth))
        return self.constant + self.increasing * share


def read_printed(path: Path) -> PrintedColumns:
    """Return the columns of a printed result table.

    Raises:
        DataFileError: The file cannot be read, lacks a column, has an invalid number, or its steps are out of order.

    """
    names = {kind: [f"{angle}_{kind}_urad" for angle in ANGLES] for kind in ("posor", "meas")}
    rows = read_table(path, ["step", *names["posor"], *names["meas"]])
    for count, row in enumerate(rows, start=1):
        if row["step"] != str(count):
            raise DataFileError(f"step '{row['step']}' in row {count}", where=str(path), expected=f"step {count}")

    def columns(kind: str) -> FloatArray:
        values = [[parse_number(row, name, f"{path}, step {row['step']}") for name in names[kind]] for row in rows]
        return np.array(values) * URAD

    return PrintedColumns(columns("posor"), columns("meas"))


_TERM = re.compile(r"\s*(?P<name>random|increasing|twist stage|stage straightness|table 7\.9 terms)\s+(?P<urad>[\d.]+)")


def read_predicted_errors(path: Path, test: str) -> dict[Angle, PredictedError]:
    """Return the predicted error of each angle in ``test`` ("ymo"); angles without a row in section 8.4 are left out.

    A test without a row of its own has only the random part of the row for all tests: the increasing part depends on
    the travel of the probes.

    Raises:
        DataFileError: The file cannot be read, or a prediction has unknown terms.

    """
    predictions: dict[Angle, PredictedError] = {}
    rows = read_table(path, ["test", "dof", "unit", "predicted"])
    for angle in ANGLES:
        own = [row for row in rows if row["test"] == test.upper() and row["dof"] == angle]
        shared = [row for row in rows if row["test"] == "all" and row["dof"] == angle]
        for row in (own or shared)[:1]:
            terms, text = _parse_terms(row["predicted"], path, row), row["predicted"]
            if not own:
                terms = {name: size for name, size in terms.items() if name == "random"}
                text = "; ".join(f"{name} {size:g}" for name, size in terms.items())
            increasing = terms.pop("increasing", 0.0)
            predictions[angle] = PredictedError(sum(terms.values()) * URAD, increasing * URAD, text)
    return predictions


def _parse_terms(predicted: str, path: Path, row: Mapping[str, str]) -> dict[str, float]:
    """Return the terms of a prediction [urad]."""
    terms: dict[str, float] = {}
    for part in predicted.split(";"):
        match = _TERM.match(part)
        if match is None:
            raise DataFileError(
                f"'{part.strip()}' is not a predicted error",
                where=f"{path}, test {row['test']}, dof {row['dof']}",
                expected="terms such as 'random 6; increasing 13'",
            )
        terms[match["name"]] = float(match["urad"])
    return terms
