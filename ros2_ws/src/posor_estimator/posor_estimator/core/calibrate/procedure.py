"""What a calibration procedure is to the command line: a name, options, and a function from a recording to an outcome.

A module of this package that defines ``PROCEDURE`` is a procedure; nothing else has to be told of it.
"""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from pydantic import BaseModel, ConfigDict

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from posor_estimator.core.calibrate.fit import Fit
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibrate.replacement import JointCovariance, Part, Replacement
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray


class Options(BaseModel):
    """Base of a procedure's options: one field for each, with its description, range and default."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


OptionsT = TypeVar("OptionsT", bound=Options)


@dataclass(frozen=True)
class Table:
    """A table to print.

    Attributes:
        title: What it shows.
        columns: Head of each column.
        units: Unit of each column, empty for text and counts.
        rows: Numbers or texts, one for each column.

    """

    title: str
    columns: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[float | int | str, ...], ...]


@dataclass(frozen=True)
class Figure:
    """A chart as plain data.

    Attributes:
        title: What it shows.
        x_label: Quantity and unit along x.
        y_label: Quantity and unit along y.
        series: By name, the points x (n,) and y (n,).

    """

    title: str
    x_label: str
    y_label: str
    series: Mapping[str, tuple[FloatArray, FloatArray]]


@dataclass(frozen=True)
class Outcome:
    """What a procedure found.

    Attributes:
        method: One sentence on what was done, for the calibration file.
        fits: The fits, by what was fitted.
        replacements: New values for the calibration file.
        parts: New parts of the calibration file.
        covariances: How the new values vary together, where it matters.
        tables: To be printed.
        warnings: Sentences on what the user should know before trusting it.
        figures: For the report.

    """

    method: str
    fits: Mapping[str, Fit]
    replacements: tuple[Replacement, ...] = ()
    parts: tuple[Part, ...] = ()
    covariances: tuple[JointCovariance, ...] = ()
    tables: tuple[Table, ...] = ()
    warnings: tuple[str, ...] = ()
    figures: tuple[Figure, ...] = field(default=())


@dataclass(frozen=True)
class Procedure(Generic[OptionsT]):
    """One calibration procedure.

    Attributes:
        name: By which the command line finds it.
        summary: What it does, one line.
        options: Model of its options.
        run: Does it; raises FitError or TrackError where the data do not serve.

    """

    name: str
    summary: str
    options: type[OptionsT]
    run: Callable[[Recording, Calibration, OptionsT], Outcome]


def procedures() -> dict[str, Procedure[Any]]:
    """Return all procedures by name."""
    package = importlib.import_module("posor_estimator.core.calibrate")
    modules = [importlib.import_module(f"{package.__name__}.{m.name}") for m in pkgutil.iter_modules(package.__path__)]
    found: list[Procedure[Any]] = [module.PROCEDURE for module in modules if hasattr(module, "PROCEDURE")]
    return {procedure.name: procedure for procedure in sorted(found, key=lambda procedure: procedure.name)}
