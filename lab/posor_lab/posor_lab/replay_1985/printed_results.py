# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Printed results of the motion tests: result columns of appendix 8B, predicted errors of section 8.4."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from posor.errors import DataFileError

from posor_lab.replay_1985.motion_test import ANGLES, Angle
from posor_lab.thesis_data import URAD, data_path, parse_number, read_table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from posor.numerics.array_types import BoolArray, FloatArray

EndOfBeamTest = Literal["TWIS", "GEN"]
COLUMNS: tuple[Literal["alpha", "z", "y"], ...] = ("alpha", "z", "y")
"""Columns of the tests TWIS and GEN: alpha, and z and y at the end of the measuring beam."""
PRINTED_FILES: Mapping[str, str] = {"ymo": "ymo_output.csv"}  # printed result tables in this repository, by test
EXPECTED_ERRORS_FILE = "expected_errors.csv"
_TERM = re.compile(r"\s*(?P<name>random|increasing|twist stage|stage straightness|table 7\.9 terms)\s+(?P<urad>[\d.]+)")


@dataclass(frozen=True)
class PrintedColumns:
    """The printed result table of one test: alpha, beta, theta [rad], shape (n, 3)."""

    posor: FloatArray  # by the POSOR
    truth: FloatArray  # by the machining centre


@dataclass(frozen=True)
class EndOfBeamResults:
    """The printed result table of TWIS or GEN: alpha [rad], z and y [inch], less step 1, (n, 3); NaN: not legible."""

    measured: FloatArray  # by the machining centre
    posor: FloatArray  # by the POSOR with zero shifts of (0, .2, .3) V

    @property
    def errors(self) -> FloatArray:
        """POSOR less machining centre, shape (n, 3)."""
        return np.asarray(self.posor - self.measured)

    @property
    def legible(self) -> BoolArray:
        """Which errors are legible, shape (n, 3)."""
        return np.asarray(np.isfinite(self.errors))

    @property
    def motion(self) -> FloatArray:
        """The measured columns, each missing cell interpolated between its neighbouring steps, shape (n, 3)."""
        steps = np.arange(len(self.measured), dtype=float)
        filled = [np.interp(steps, steps[known := np.isfinite(column)], column[known]) for column in self.measured.T]
        return np.asarray(np.column_stack(filled))

    def root_mean_square(self, column: int) -> float:
        """Return the root mean square of the legible errors of a column, without step 1."""
        return float(np.sqrt(np.nanmean(np.square(self.errors[1:, column]))))


@dataclass(frozen=True)
class PredictedError:
    """Error that section 8.4 predicts."""

    constant: float  # sum of the constant terms [rad]: random, stage, table 7.9
    increasing: float  # additional error at the end of the motion, in proportion to it [rad]
    terms: str  # the terms as printed

    def half_width(self, truth: FloatArray) -> FloatArray:
        """Return the half-width of the error band [rad] at each step of a motion by the machining centre, (n,)."""
        extent = np.nanmax(np.abs(truth))
        share = np.abs(truth) / extent if extent > 0.0 else np.zeros(len(truth))
        return self.constant + self.increasing * share


def read_printed(path: Path) -> PrintedColumns:
    """Return the columns of a printed result table.

    Raises DataFileError: the file cannot be read, lacks a column, has an invalid number, or its steps are out of order.
    """
    posor, truth = ([f"{angle}_{kind}_urad" for angle in ANGLES] for kind in ("posor", "meas"))
    rows = read_table(path, ["step", *posor, *truth])
    for count, row in enumerate(rows, start=1):
        if row["step"] != str(count):
            raise DataFileError(f"step '{row['step']}' in row {count}", where=str(path), expected=f"step {count}")
    return PrintedColumns(_parse_columns(rows, path, posor) * URAD, _parse_columns(rows, path, truth) * URAD)


def read_end_of_beam(test: EndOfBeamTest) -> EndOfBeamResults:
    """Return the printed results of TWIS or GEN.

    Raises DataFileError: the table cannot be read, or has an invalid number.
    """
    path, scales = data_path(f"{test.lower()}_output.csv"), np.array([URAD, 1.0, 1.0])
    measured, posor = ([f"alpha_{kind}_urad", f"z_{kind}_in", f"y_{kind}_in"] for kind in ("meas", "posor"))
    rows = read_table(path, ["step", *measured, *posor])
    return EndOfBeamResults(_parse_columns(rows, path, measured) * scales, _parse_columns(rows, path, posor) * scales)


def _parse_columns(rows: Sequence[Mapping[str, str]], path: Path, names: Sequence[str]) -> FloatArray:
    return np.array([[parse_number(row, name, f"{path}, step {row['step']}") for name in names] for row in rows])


def read_predicted_errors(path: Path, test: str) -> dict[Angle, PredictedError]:
    """Return the predicted error of each angle in ``test`` ("ymo"); angles without a row in section 8.4 are left out.

    A test without a row of its own has only the random part of the row for all tests: the increasing part depends on
    the travel of the probes.

    Raises DataFileError: the file cannot be read, or a prediction has unknown terms.
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
            where = f"{path}, test {row['test']}, dof {row['dof']}"
            expected = "terms such as 'random 6; increasing 13'"
            raise DataFileError(f"'{part.strip()}' is not a predicted error", where=where, expected=expected)
        terms[match["name"]] = float(match["urad"])
    return terms
