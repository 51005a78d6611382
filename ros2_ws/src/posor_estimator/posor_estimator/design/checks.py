"""Checks of the arguments of design calculators."""

from __future__ import annotations

import math

from posor_estimator.errors import ParameterError


def require_finite(**values: float) -> None:
    """Check numbers, given by the names of the arguments.

    Raises:
        ParameterError: A number is not finite.

    """
    for name, value in values.items():
        if not math.isfinite(value):
            raise ParameterError(f"{value} is not finite", where=name, expected="a finite number")


def require_positive(**values: float) -> None:
    """Check numbers, given by the names of the arguments.

    Raises:
        ParameterError: A number is not finite, or not greater than zero.

    """
    require_finite(**values)
    for name, value in values.items():
        if value <= 0.0:
            raise ParameterError(f"{value:g} is not positive", where=name, expected="a number greater than 0")


def require_non_negative(**values: float) -> None:
    """Check numbers, given by the names of the arguments.

    Raises:
        ParameterError: A number is not finite, or negative.

    """
    require_finite(**values)
    for name, value in values.items():
        if value < 0.0:
            raise ParameterError(f"{value:g} is negative", where=name, expected="0 or more")
