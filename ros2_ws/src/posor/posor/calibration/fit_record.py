# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fit records of a calibration file: recording, method, date and quality of each fit whose results it holds."""

from __future__ import annotations

import datetime as dt
import re
from typing import TYPE_CHECKING, Annotated, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from posor.calibration.file_model import EntryError, FrozenModel, format_value

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

_SHA256 = re.compile(r"[0-9a-f]{64}")
_ROUNDING = 1e-6
"""Relative to the largest eigenvalue of the correlations: smaller negative ones are rounding of the file."""

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Count = Annotated[int, Field(strict=True, ge=0)]


class RecordedData(FrozenModel):
    """The fitted recording: name of the bag, and SHA-256 of its files."""

    name: str
    sha256: str

    @field_validator("sha256")
    @classmethod
    def _check_sha256(cls, written: str) -> str:
        if written and not _SHA256.fullmatch(written):
            raise EntryError(f"sha256 {format_value(written)}", expected="64 hexadecimal digits, or empty text")
        return written


class Instrument(FrozenModel):
    """Instrument of the reference measurement.

    ``sigmas`` are the standard uncertainties of the numbers of one message (k = 1), in the SI units of the message: one
    for a number, three for a point, six for a pose: x, y, z [m], about X, Y, Z [rad].
    """

    topic: str
    name: str
    sigmas: Annotated[list[Annotated[Number, Field(ge=0.0)]], Field(min_length=1)]


class Residuals(FrozenModel):
    """Quality of a fit.

    ``spread`` is the square root of chi-square per degree of freedom: 1 if the stated uncertainties of the readings are
    right. ``probability`` is that of a chi-square at least as large. ``outliers`` counts rejected readings.
    """

    readings: Count
    parameters: Count
    freedoms: Count
    spread: Annotated[Number, Field(ge=0.0)]
    probability: Annotated[Number, Field(ge=0.0, le=1.0)]
    outliers: Count


class CovarianceRecord(FrozenModel):
    """Covariance of components of quantities: lower triangle, row by row, SI units."""

    entries: Annotated[list[str], Field(min_length=1)]
    rows: list[list[Number]]

    @model_validator(mode="after")
    def _check_covariance(self) -> Self:
        for index, row in enumerate(self.rows):
            if len(row) != index + 1:
                expected = f"{index + 1}, the lower triangle"
                raise EntryError(f"row has {len(row)} numbers", key=("rows", index), expected=expected)
        if len(self.rows) != len(self.entries):
            expected = f"{len(self.entries)}, one for each entry"
            raise EntryError(f"{len(self.rows)} rows", key=("rows",), expected=expected)
        if len(set(self.entries)) != len(self.entries):
            raise EntryError("entries repeat", key=("entries",), expected="each once")
        matrix = self.matrix
        variances = np.diag(matrix)
        if not np.all(variances > 0.0):
            raise EntryError("a variance is not positive", key=("rows",), expected="more than zero on the diagonal")
        scale = np.sqrt(variances)
        values = np.linalg.eigvalsh(matrix / np.outer(scale, scale))
        if values[0] < -_ROUNDING * values[-1]:
            raise EntryError("it is not a covariance", key=("rows",), expected="a positive semi-definite matrix")
        return self

    @property
    def matrix(self) -> FloatArray:
        """(p, p)."""
        size = len(self.rows)
        matrix = np.zeros((size, size))
        for index, row in enumerate(self.rows):
            matrix[index, : index + 1] = matrix[: index + 1, index] = row
        return matrix


class FitRecord(FrozenModel):
    """One run of a calibration procedure.

    ``replaced`` are the keys of the values from this run; a later run may have replaced some again. ``date`` is UTC,
    ISO 8601.
    """

    procedure: str
    method: str
    date: str
    recording: RecordedData
    former: str = ""
    options: dict[str, str] = Field(default_factory=dict)
    instruments: list[Instrument] = Field(default_factory=list)
    replaced: Annotated[list[str], Field(min_length=1)]
    residuals: dict[str, Residuals] = Field(default_factory=dict)
    covariances: list[CovarianceRecord] = Field(default_factory=list)
    warnings: list[str] = Field(default_factory=list)

    @field_validator("date")
    @classmethod
    def _check_date(cls, written: str) -> str:
        try:
            dt.datetime.fromisoformat(written)
        except ValueError:
            raise EntryError(f"date {format_value(written)}", expected="such as '2026-01-31T12:00:00Z'") from None
        return written

    @field_validator("former")
    @classmethod
    def _check_former(cls, written: str) -> str:
        if written and not _SHA256.fullmatch(written):
            raise EntryError(f"former {format_value(written)}", expected="the content hash of the former calibration")
        return written
