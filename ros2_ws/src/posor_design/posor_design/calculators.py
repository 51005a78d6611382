"""What makes a function a design calculator: its registration, and the checks of its arguments and of its result.

The annotation of an argument states its unit, limits and meaning (``argument_types.py``); an argument with a default
may be left out. The result is a frozen dataclass with fields annotated alike. The first line of the docstring is the
summary, and its section ``Source:`` names the equation. ``calculator_examples.yaml`` has a command line of each.

A calculator raises a ParameterError for an argument that is not finite or out of its limits, and where its numbers
exceed the floating point, such as for a length of 1e30 in.
"""

from __future__ import annotations

import inspect
import math
from functools import cache, wraps
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, get_type_hints

import numpy as np
from posor.errors import ParameterError, PosorError

from posor_design import argument_types
from posor_design.argument_types import FINITE, Limit, unit_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

P = ParamSpec("P")
R = TypeVar("R")

CALCULATORS: dict[str, Callable[..., Any]] = {}
"""All calculators by the name that ``posor design`` gives them; ``posor_design`` registers them."""


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
    """Return the annotations of a calculator or of its result; modules import limits for type checkers only."""
    return get_type_hints(item, localns=vars(argument_types), include_extras=True)


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

    Raises:
        ParameterError: An argument has more or fewer values.

    """
    for name, each in values.items():
        if len(each) != len(values[first]):
            expected = f"{len(values[first])}, as many as {first}"
            raise ParameterError(f"{len(each)} values", where=name, expected=expected)


def _no_solution(name: str) -> ParameterError:
    return ParameterError(
        "no solution for these arguments",
        where=f"design {name}",
        expected="quantities of a usual size; check the units",
    )


def _is_finite(value: Any) -> bool:
    """Return whether all numbers of a field are finite."""
    if isinstance(value, tuple):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)
