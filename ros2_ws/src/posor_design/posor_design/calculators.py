# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What makes a function a design calculator: types of its arguments, its registration, and the checks of a call.

``Annotated[float, "m", POSITIVE, "Length of the beam."]`` states SI unit, limits and meaning of an argument; unit and
limits of a tuple hold for each of its numbers. An argument with a default may be left out. The result is a frozen
dataclass with fields annotated alike. The first line of the docstring is the summary, and its section ``Source:`` names
the equation. ``calculator_examples.yaml`` has a command line of each.

A calculator raises a ParameterError for an argument that is not finite or out of its limits, and where its numbers
exceed the floating point, such as for a length of 1e30 in. Source of the units: BIPM, The International System of Units
(2019).
"""

from __future__ import annotations

import inspect
import math
from dataclasses import dataclass
from functools import cache, wraps
from typing import TYPE_CHECKING, Annotated, Any, Literal, ParamSpec, TypeVar, get_origin, get_type_hints

import numpy as np
from posor.errors import ParameterError, PosorError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

P = ParamSpec("P")
R = TypeVar("R")

CALCULATORS: dict[str, Callable[..., Any]] = {}
"""All calculators by the name that ``posor design`` gives them; ``posor_design`` registers them."""


@dataclass(frozen=True)
class Limit:
    """Limit of an argument: what it accepts, in words for errors, and whether it limits the count of a tuple."""

    accepts: Callable[[float], bool]
    expected: str
    of_count: bool = False


def at_least(count: int) -> Limit:
    """Return the limit of a tuple that has a number of values or more."""
    return Limit(lambda found: found >= count, f"at least {count}", of_count=True)


def more_than(low: float) -> Limit:
    """Return the limit of numbers that exceed ``low``."""
    return Limit(lambda value: value > low, f"more than {low:g}")


FINITE = Limit(math.isfinite, "a finite number")  # holds for all arguments
POSITIVE = more_than(0.0)
NON_NEGATIVE = Limit(lambda value: value >= 0.0, "0 or more")
NON_ZERO = Limit(lambda value: value != 0.0, "a number other than 0")
SMALL_ANGLE = Limit(lambda angle: abs(angle) <= 0.2, "at most 0.2 rad")  # noqa: PLR2004  a larger one is a wrong unit
ACUTE_ANGLE = Limit(lambda angle: 0.0 < angle < 0.5 * math.pi, "more than 0, less than a right angle")
SHARE = Limit(lambda share: 0.0 < share <= 1.0, "more than 0, at most 1")
PROPER_SHARE = Limit(lambda share: 0.0 <= share < 1.0, "0 to less than 1")
POISSON_RATIO = Limit(lambda ratio: 0.0 <= ratio <= 0.5, "0 to 0.5")  # noqa: PLR2004  0.5: incompressible


def type_of(kind: Any) -> Any:
    """Return the type of an annotation without unit, limits and meaning."""
    return kind.__origin__ if get_origin(kind) is Annotated else kind


def unit_of(kind: Any) -> str:
    """Return the SI unit of a number or of the numbers of a tuple; ``1`` for everything without unit."""
    has_unit = type_of(kind) is float or get_origin(type_of(kind)) is tuple
    return str(kind.__metadata__[0]) if has_unit else "1"


# Arguments that calculators of beams share.
MOST_MODES = 20
"""Largest number of modes; beam theory fails for higher ones, whose waves are shorter than usual sections are high."""
MODES = Limit(lambda modes: 1 <= modes <= MOST_MODES, f"1 to {MOST_MODES}")
_BOTH = Limit(lambda count: count in {0, 2}, "a value for each of the two gimbals", of_count=True)

Shape = Annotated[Literal["tube", "box"], "Section of the beam."]
Height = Annotated[float, "m", POSITIVE, "Outer height of the section in the plane of bending; diameter of a tube."]
Wall = Annotated[float, "m", POSITIVE, "Thickness of the walls."]
BoxWidth = Annotated[float, "m", NON_NEGATIVE, "Outer width of a box."]
BeamLength = Annotated[float, "m", POSITIVE, "Length of the beam."]
Modulus = Annotated[float, "Pa", POSITIVE, "Young's modulus."]
BeamDensity = Annotated[float, "kg/m^3", POSITIVE, "Density of the beam."]
WeightDensity = Annotated[float, "kg/m^3", NON_NEGATIVE, "Density; 0: the beam has no weight."]
PoissonRatio = Annotated[float, "1", POISSON_RATIO, "Poisson's ratio."]
GimbalPlaces = Annotated[tuple[float, float], "m", NON_NEGATIVE, "Distances of gimbals from the start, nearer first."]
PlateInertias = Annotated[
    tuple[float, float],
    "kg m^2",
    NON_NEGATIVE,
    "Moments of inertia of these masses about the axis across the plane of bending.",
]
PlateMasses = Annotated[tuple[float, float], "kg", NON_NEGATIVE, "Masses at start and end of the beam."]
GimbalStiffness = Annotated[tuple[float, ...], "N/m", POSITIVE, _BOTH, "Stiffness against deflection; left out: rigid."]
GimbalTurningStiffness = Annotated[
    tuple[float, ...],
    "N m/rad",
    POSITIVE,
    _BOTH,
    "Stiffness of each gimbal against turning; left out: the gimbals turn freely.",
]


def calculator(calculate: Callable[P, R]) -> Callable[P, R]:
    """Register a function as a calculator, and check its arguments and its result."""
    name = calculate.__name__.replace("_", "-")
    parameters = inspect.signature(calculate)

    @wraps(calculate)
    def checked(*arguments: P.args, **named: P.kwargs) -> R:
        kinds = annotations_of(calculate)
        for argument, value in parameters.bind(*arguments, **named).arguments.items():
            _check_argument(argument, kinds[argument], value)
        try:
            with np.errstate(over="raise", divide="raise", invalid="raise"):
                result = calculate(*arguments, **named)
        except PosorError:
            raise
        # A ValueError: math, numpy.linalg and scipy.optimize report by it that a number or a matrix is degenerate.
        except (ArithmeticError, ValueError) as error:
            raise _no_solution(name) from error
        if not all(map(_is_finite, vars(result).values())):
            raise _no_solution(name)
        return result

    CALCULATORS[name] = checked
    return checked


@cache
def annotations_of(item: Any) -> dict[str, Any]:
    """Return the annotations of a calculator or of its result."""
    return get_type_hints(item, include_extras=True)


def _check_argument(name: str, kind: Any, value: Any) -> None:
    """Check the numbers of an argument, and their count, against the limits of its annotation."""
    numbers = [each for each in (value if isinstance(value, tuple) else (value,)) if not isinstance(each, str)]
    for limit in (FINITE, *(each for each in kind.__metadata__ if isinstance(each, Limit))):
        unit = "values" if limit.of_count else unit_of(kind)
        for number in [len(numbers)] if limit.of_count else numbers:
            if not limit.accepts(number):
                what = f"{number:g} {unit}".removesuffix(" 1")
                raise ParameterError(what, where=name, expected=limit.expected)


def require_as_many(first: str, **values: Sequence[float]) -> None:
    """Check that arguments have as many values as the one named ``first``.

    Raises ParameterError: an argument has more or fewer values.
    """
    for name, each in values.items():
        if len(each) != len(values[first]):
            expected = f"{len(values[first])}, as many as {first}"
            raise ParameterError(f"{len(each)} values", where=name, expected=expected)


def _no_solution(name: str) -> ParameterError:
    expected = "quantities of a usual size; check the units"
    return ParameterError("no solution for these arguments", where=f"design {name}", expected=expected)


def _is_finite(value: Any) -> bool:
    """Return whether all numbers of a field are finite."""
    if isinstance(value, tuple):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)
