"""What a calibration file says of each fit whose results stand in it: from what, how, when, and how well it fitted."""

from __future__ import annotations

import datetime as dt
import re
from typing import TYPE_CHECKING, Annotated, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from posor_estimator.core.calibration.entry import EntryError, shown
from posor_estimator.core.calibration.part import FrozenModel

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray

_SHA256 = re.compile(r"[0-9a-f]{64}")
_ROUNDING = 1e-6
"""Of the largest eigenvalue of the correlations: a smaller negative one comes from the digits written."""

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Count = Annotated[int, Field(strict=True, ge=0)]


class RecordedData(FrozenModel):
    """The recording that was fitted: name of the bag, and SHA-256 of its files."""

    name: str
    sha256: str

    @field_validator("sha256")
    @classmethod
    def _hexadecimal(cls, written: str) -> str:
        if written and not _SHA256.fullmatch(written):
            raise EntryError(f"sha256 {shown(written)}", expected="64 hexadecimal digits, or nothing")
        return written


class Instrument(FrozenModel):
    """What the reference was measured with.

    ``sigmas`` are the standard uncertainties of the numbers of one message (k = 1), in the SI units of the message: one
    for a number, three for a point, six for a pose: x, y, z [m], about X, Y, Z [rad].
    """

    topic: str
    name: str
    sigmas: Annotated[list[Annotated[Number, Field(ge=0.0)]], Field(min_length=1)]


class Residuals(FrozenModel):
    """How well a fit fitted.

    ``spread`` is the root of chi-square over the degrees of freedom, 1 where the stated uncertainties of the readings
    are right; ``probability`` that of a chi-square at least as large; ``outliers`` the readings beyond all likelihood.
    """

    readings: Count
    parameters: Count
    freedoms: Count
    spread: Annotated[Number, Field(ge=0.0)]
    probability: Annotated[Number, Field(ge=0.0, le=1.0)]
    outliers: Count


class CovarianceRecord(FrozenModel):
    """How components of quantities vary together: the lower triangle of their covariance, row by row, SI units."""

    entries: Annotated[list[str], Field(min_length=1)]
    rows: list[list[Number]]

    @model_validator(mode="after")
    def _covariance(self) -> Self:
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
            raise EntryError("it is no covariance", key=("rows",), expected="a positive semi-definite matrix")
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
    """One run of a calibration procedure whose results the file holds.

    ``replaced`` are the keys that the run gave their present values; a later run may have replaced some again.
    ``date`` is UTC, ISO 8601.
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
    def _moment(cls, written: str) -> str:
        try:
            dt.datetime.fromisoformat(written)
        except ValueError:
            raise EntryError(f"date {shown(written)}", expected="such as '2026-01-31T12:00:00Z'") from None
        return written

    @field_validator("former")
    @classmethod
    def _hash(cls, written: str) -> str:
        if written and not _SHA256.fullmatch(written):
            raise EntryError(f"former {shown(written)}", expected="the content hash of the calibration before")
        return written
