# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Interface of a calibration procedure: options in, fits and changes to the calibration file out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Generic, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration
    from posor.calibration.quantity import Nested
    from posor.numerics.array_types import FloatArray

    from posor_calibration.least_squares import Fit


CLEAR_DRIFT = 4.0  # drift in its standard uncertainties that noise exceeds with a probability of 6e-5
CERTAIN_DRIFT = 6.0  # likewise, 2e-9: also where the fit absorbs nearly all of a drift, and model errors look alike
LARGEST_DRIFT = 10.0  # drift in standard uncertainties of the reference beyond which the recording is refused


class Options(BaseModel):
    """Base of a procedure's options: one field each, with description, range and default."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


OptionsT = TypeVar("OptionsT", bound=Options)

LossOption = Annotated[
    Literal["linear", "huber", "soft_l1", "cauchy"],
    Field(description="loss of the fit; soft_l1, huber and cauchy are robust against outliers"),
]
SessionOption = Annotated[
    str, Field(description="session of the file in force during the recording, with its zero shifts and maps")
]
LongestGapOption = Annotated[
    float, Field(gt=0.0, description="no interpolation between reference values further apart than this [s]")
]
TrustSigmasOption = Annotated[
    bool, Field(description="whether the stated uncertainties of the readings hold; if not, they follow the residuals")
]


@dataclass(frozen=True)
class Replacement:
    """A new value of one quantity of a calibration file; its unit stays."""

    key: str  # path of the quantity: ``sensors[0].probes[1].volts_to_gap``
    value: Nested  # number, list or table in the quantity's unit
    sigma: Nested  # standard uncertainty, one number or one for each component


@dataclass(frozen=True)
class Part:
    """A part of a calibration file that is inserted or replaced as a whole, such as a new map of a diode."""

    key: str  # where it goes: ``sensors[1].maps.fitted``
    content: Any  # mappings, lists, numbers and texts


@dataclass(frozen=True)
class JointCovariance:
    """Covariance of components of a calibration file (JCGM 102, 3.11)."""

    entries: tuple[str, ...]  # key and index of each component: ``sensors[0].target_plane.tilt[0]``, (p,)
    matrix: FloatArray  # in the units of the components, (p, p)


@dataclass(frozen=True)
class Table:
    """A table for terminal and report."""

    title: str
    columns: tuple[str, ...]
    units: tuple[str, ...]  # of each column; empty for text and counts
    rows: tuple[tuple[float | int | str, ...], ...]


@dataclass(frozen=True)
class Figure:
    """A chart as plain data."""

    title: str
    x_label: str  # with unit
    y_label: str  # with unit
    series: Mapping[str, tuple[FloatArray, FloatArray]]  # by name: x (n,) and y (n,)


@dataclass(frozen=True)
class DriftTest:
    """Drift of one quantity of a reference against the readings, in proportion to time, over the recording."""

    topic: str
    quantity: str
    unit: str
    drift: float
    sigma: float  # its standard uncertainty; infinite: the recording does not show it
    stated: float  # standard uncertainty of the reference; 0: not stated

    @property
    def text(self) -> str:
        """Drift and standard uncertainty, with the name of the quantity."""
        name = f" of {self.quantity}" if self.quantity else ""
        return f"{self.drift:.2g} +- {self.sigma:.2g} {self.unit}{name}"

    @property
    def is_tested(self) -> bool:
        """Whether a drift of ``LARGEST_DRIFT`` is clear."""
        limit = LARGEST_DRIFT * self.stated if self.stated else np.inf
        return bool(np.isfinite(self.sigma) and CLEAR_DRIFT * self.sigma <= limit)

    @property
    def is_found(self) -> bool:
        """Whether the reference clearly drifts by more than its stated uncertainty."""
        return self.is_tested and abs(self.drift) > max(CLEAR_DRIFT * self.sigma, self.stated)

    @property
    def is_refused(self) -> bool:
        """Whether the reference drifts too far for a calibration; without a stated uncertainty no drift is refused."""
        return self.stated > 0.0 and abs(self.drift) > max(CERTAIN_DRIFT * self.sigma, LARGEST_DRIFT * self.stated)


@dataclass(frozen=True)
class Outcome:
    """Result of a procedure."""

    method: str  # one sentence for the fit record
    fits: Mapping[str, Fit]  # by what was fitted
    replacements: tuple[Replacement, ...] = ()
    parts: tuple[Part, ...] = ()
    covariances: tuple[JointCovariance, ...] = ()
    tables: tuple[Table, ...] = ()
    warnings: tuple[str, ...] = ()  # sentences to read before trusting the result
    figures: tuple[Figure, ...] = field(default=())
    drifts: tuple[DriftTest, ...] = ()  # of the references that the result depends on


ANGLES = ("rotation about x", "rotation about y", "rotation about z")
DRIFTING = ("", "x", "y", "z", *ANGLES)
"""Quantities of a reference: of a single number, of a point or a pose, of a pose."""


@dataclass(frozen=True)
class Procedure(Generic[OptionsT]):
    """A calibration procedure of the command line."""

    name: str
    summary: str  # one line
    options: type[OptionsT]
    identify: Callable[[Recording, Calibration, OptionsT], Outcome]
    """Fits the parameters; raises FitError or TrackError for unusable data, CalibrationError for an unknown session."""
    drift_of: tuple[str, ...] = DRIFTING  # quantities of a reference whose drift a second fit tests
