"""Interface of a calibration procedure: options in, fits and changes to the calibration file out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Generic, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration
    from posor.calibration.quantity import Nested
    from posor.numerics.array_types import FloatArray

    from posor_calibration.least_squares import Fit


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


@dataclass(frozen=True)
class Procedure(Generic[OptionsT]):
    """A calibration procedure of the command line."""

    name: str
    summary: str  # one line
    options: type[OptionsT]
    identify: Callable[[Recording, Calibration, OptionsT], Outcome]
    """Fits the parameters; raises FitError or TrackError for unusable data, CalibrationError for an unknown session."""
