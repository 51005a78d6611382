"""Checks of the arguments of design calculators."""

from __future__ import annotations

import math

from posor.errors import ParameterError

INCOMPRESSIBLE = 0.5
"""Largest Poisson's ratio of a material."""
SMALL_ANGLE = 0.2
"""Angles of misalignment [rad] are smaller; a larger one is a wrong unit."""


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


def require_small_angle(**values: float) -> None:
    """Check angles of misalignment, given by the names of the arguments.

    Raises:
        ParameterError: An angle is not finite, or exceeds ``SMALL_ANGLE``.

    """
    require_finite(**values)
    for name, value in values.items():
        if abs(value) > SMALL_ANGLE:
            raise ParameterError(f"{value:g} rad", where=name, expected=f"at most {SMALL_ANGLE} rad")


def require_poisson_ratio(**values: float) -> None:
    """Check Poisson's ratios, given by the names of the arguments.

    Raises:
        ParameterError: A ratio is not finite, negative, or exceeds ``INCOMPRESSIBLE``.

    """
    require_finite(**values)
    for name, value in values.items():
        if not 0.0 <= value <= INCOMPRESSIBLE:
            raise ParameterError(
                f"{value:g} is outside of 0 to {INCOMPRESSIBLE}", where=name, expected=f"0 to {INCOMPRESSIBLE}"
            )
