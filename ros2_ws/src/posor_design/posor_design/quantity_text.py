"""Quantities as text: ``60 in`` to metres, and 2.54e-5 m to ``25.4 um``."""

from __future__ import annotations

import math
import re
from decimal import Decimal

from posor.errors import ParameterError

from posor_design.unit_expression import PREFIXES, parse_unit, similar_units

_QUANTITY = re.compile(
    r"(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,4})?)(?:/(?P<divisor>[1-9]\d*))?\s*(?P<unit>.*)", re.ASCII
)
_DIGITS = 5
_LARGE_PREFIXES = frozenset(("Hz", "N", "Pa", "Ohm", "W"))
_SMALL_PREFIXES = _LARGE_PREFIXES | {"m", "rad", "s", "V", "A", "F"}
_EXAMPLES = {"m": ("mm", "um"), "rad": ("urad", "deg")}
"""Units that an error proposes; for other SI units: themselves."""
_STEP = 3
"""Digits between two prefixes."""


def parse_quantity(text: str, si: str, where: str) -> float:
    """Return a number with unit, such as ``60 in`` or ``5/32 in``, in an SI unit; without unit it has the SI unit.

    Args:
        text: The quantity.
        si: The SI unit of the result.
        where: Name of the argument, for errors.

    Raises:
        ParameterError: The text is not a finite number with a unit of the same dimension.

    """
    match = _QUANTITY.fullmatch(text.strip())
    if match is None:
        raise ParameterError(f"'{text}' is not a number with unit", where=where, expected=describe_unit(si))
    target = parse_unit(si)
    try:
        unit = parse_unit(match["unit"]) if match["unit"] else target
    except ValueError as error:
        raise ParameterError(f"{error} in '{text}'", where=where, expected=describe_unit(si)) from None
    if unit.powers != target.powers:
        raise ParameterError(f"'{text}' has another dimension", where=where, expected=describe_unit(si))
    value = float(Decimal(match["number"]) / int(match["divisor"] or 1) * unit.factor / target.factor)
    if not math.isfinite(value):
        raise ParameterError(f"'{text}' is too large", where=where, expected=describe_unit(si))
    return value


def parse_quantity_with_unit(text: str, si: str, where: str) -> float:
    """Return a quantity as ``parse_quantity``; unless the SI unit is ``1``, a number without unit is refused.

    Args:
        text: The quantity.
        si: The SI unit of the result.
        where: Name of the argument, for errors.

    Raises:
        ParameterError: The text has no unit, or is not a finite number with a unit of the same dimension.

    """
    value = parse_quantity(text, si, where)
    if si != "1" and not split_unit(text):
        examples = " or ".join(f"'{text.strip()} {unit}'" for unit in _EXAMPLES.get(si, (si,)))
        raise ParameterError(f"'{text}'", where=where, expected=f"a number with a unit, such as {examples}")
    return value


def split_unit(text: str) -> str:
    """Return the unit of a quantity; empty: it has none, or is no quantity."""
    match = _QUANTITY.fullmatch(text.strip())
    return match["unit"] if match else ""


def describe_unit(si: str) -> str:
    """Return a phrase for the unit of an argument: ``a number in m (mm, um, in)``."""
    others = similar_units(si)
    return ("a number" if si == "1" else f"a number in {si}") + (f" ({', '.join(others)})" if others else "")


def format_quantity(value: float, si: str) -> str:
    """Return a value with its unit and, where usual, a prefix: 2.54e-5 m is ``25.4 um``."""
    value += 0.0  # -0.0 is 0.0
    if si == "1":
        return f"{value:.{_DIGITS}g}"
    first = re.match(r"[a-zA-Z]+(?!\^|[a-zA-Z])", si)
    if first and first[0] in _SMALL_PREFIXES and value != 0.0 and math.isfinite(value):
        digits = float(f"{value:.{_DIGITS}g}")  # 999.999 is 1000, which has the next prefix
        power = _STEP * math.floor(math.log10(abs(digits)) / _STEP)
        power = min(power, 0) if first[0] not in _LARGE_PREFIXES else power
        prefix = next((prefix for prefix, exponent in PREFIXES.items() if exponent == power), "")
        if prefix:
            return f"{value / 10.0**power:.{_DIGITS}g} {prefix}{si}"
    return f"{value:.{_DIGITS}g} {si}"
