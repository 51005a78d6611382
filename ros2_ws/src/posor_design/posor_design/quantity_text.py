# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Quantities as text: ``60 in`` to metres, and 2.54e-5 m to ``25.4 um``.

Units, such as ``um``, ``lb/in^3`` or ``N m/rad``: an expression is a product of symbols. A space, ``*`` or ``-``
multiplies, ``/`` divides by the one symbol that follows, and ``^`` raises a symbol to a power. The radian is a
dimension of its own here, so that ``Hz`` and ``rad/s`` cannot be confused. ``lb`` is a mass and ``lbf`` a force.
Source: BIPM, The International System of Units (2019), tables 4 and 7; NIST SP 811 (2008), appendix B.8.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cache

from posor.calibration.quantity import CONVERTED_UNITS
from posor.errors import ParameterError

from posor_design.data_file import read_data

_BASE = ("m", "kg", "s", "A", "K", "rad")
PREFIXES = {"G": 9, "M": 6, "k": 3, "c": -2, "m": -3, "u": -6, "µ": -6, "n": -9, "p": -12, "f": -15}


def _read_definitions() -> dict[str, tuple[Decimal, str]]:
    """Return the amount of each symbol in other units."""
    found = {symbol: (factor, si) for symbol, (si, factor) in CONVERTED_UNITS.items()}
    for symbol, definition in read_data("units").items():
        number, _, unit = str(definition).partition(" ")
        dividend, _, divisor = number.partition("/")
        found[symbol] = Decimal(dividend) / Decimal(divisor or 1), unit
    return found


_DEFINITIONS = _read_definitions()
_WITH_PREFIX = frozenset(("m", "g", "s", "A", "K", "rad", "Hz", "N", "Pa", "J", "W", "V", "Ohm", "F"))
_FACTOR = re.compile(r"(?P<divide>\s*/\s*|[\s*·-]+|^)(?P<symbol>[a-zA-Zµ%]+|1)(?:\^(?P<power>-?\d+(?:\.\d+)?))?")


@dataclass(frozen=True)
class Unit:
    """A unit: its amount in coherent SI units, and the powers of metre, kilogram, second, ampere, kelvin, radian."""

    factor: Decimal = Decimal(1)
    powers: tuple[Fraction, ...] = (Fraction(0),) * len(_BASE)

    def times(self, other: Unit, power: Fraction) -> Unit:
        """Return the product with a power of another unit."""
        return Unit(
            self.factor * other.factor ** (Decimal(power.numerator) / power.denominator),
            tuple(mine + power * others for mine, others in zip(self.powers, other.powers, strict=True)),
        )


@cache
def parse_unit(text: str) -> Unit:
    """Return the unit that an expression names; empty: the number 1.

    Raises ValueError: the expression is malformed, or contains an unknown symbol.
    """
    unit, end = Unit(), 0
    while end < len(text):
        match = _FACTOR.match(text, end) if end else _FACTOR.match(text)
        if match is None or (end and not match["divide"]):
            raise ValueError(f"'{text}' is not a unit")
        power = Fraction(match["power"] or 1)
        unit = unit.times(_symbol(match["symbol"]), -power if "/" in match["divide"] else power)
        end = match.end()
    return unit


def _symbol(symbol: str) -> Unit:
    if symbol in _BASE:
        return Unit(powers=tuple(Fraction(symbol == base) for base in _BASE))
    if symbol in _DEFINITIONS:
        factor, other = _DEFINITIONS[symbol]
        return Unit(factor).times(parse_unit(other), Fraction(1))
    if symbol[1:] in _WITH_PREFIX and symbol[0] in PREFIXES:
        return Unit(Decimal(10) ** PREFIXES[symbol[0]]).times(_symbol(symbol[1:]), Fraction(1))
    raise ValueError(f"there is no unit '{symbol}'")


def similar_units(si: str) -> list[str]:
    """Return the other symbols of the dimension of an SI symbol, such as ``in`` for ``m``; for a product: none."""
    if not re.fullmatch(r"1|[a-zA-Z]+", si):
        return []
    powers = parse_unit(si).powers
    return [symbol for symbol in _DEFINITIONS if symbol not in {si, "1"} and parse_unit(symbol).powers == powers]


_QUANTITY = re.compile(
    r"(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,4})?)(?:/(?P<divisor>[1-9]\d*))?\s*(?P<unit>.*)", re.ASCII
)
_DIGITS = 5
_LARGE_PREFIXES = frozenset(("Hz", "N", "Pa", "Ohm", "W"))
_SMALL_PREFIXES = _LARGE_PREFIXES | {"m", "rad", "s", "V", "A", "F"}
_EXAMPLES = {"m": ("mm", "um"), "rad": ("urad", "deg")}  # units that an error proposes; for other SI units: themselves
_STEP = 3  # digits between two prefixes


def parse_quantity(text: str, si: str, where: str, *, unit_required: bool = False) -> float:
    """Return a number with unit, such as ``60 in`` or ``5/32 in``, in an SI unit.

    ``text``: the quantity. ``si``: the SI unit of the result, and of a number without unit. ``where``: name of the
    argument, for errors. ``unit_required``: whether a number without unit is an error, unless the SI unit is ``1``.
    Raises ParameterError: the text is not a finite number with a unit of the same dimension.
    """
    match = _QUANTITY.fullmatch(text.strip())
    if match is None:
        raise ParameterError(f"'{text}' is not a number with unit", where=where, expected=describe_unit(si))
    if unit_required and si != "1" and not match["unit"]:
        examples = " or ".join(f"'{text.strip()} {unit}'" for unit in _EXAMPLES.get(si, (si,)))
        raise ParameterError(f"'{text}'", where=where, expected=f"a number with a unit, such as {examples}")
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


def split_list(text: str) -> list[str]:
    """Return the quantities of a list; those without unit have the last unit: ``6, 24 in`` is ``6 in``, ``24 in``."""
    entries = [entry.strip() for entry in text.split(",")]
    matches = [_QUANTITY.fullmatch(entry) for entry in entries]
    units = [match["unit"] if match else "" for match in matches]
    return [entry if unit else f"{entry} {units[-1]}".strip() for entry, unit in zip(entries, units, strict=True)]


def describe_unit(si: str) -> str:
    """Return a phrase for the unit of an argument: ``a number in m (mm, um, in)``."""
    others = similar_units(si)
    return ("a number" if si == "1" else f"a number in {si}") + (f" ({', '.join(others)})" if others else "")


def format_quantity(value: float, si: str, digits: int | None = None) -> str:
    """Return a value with its unit and, where usual, a prefix: 2.54e-5 m is ``25.4 um``; ``digits``: fewer than 5."""
    value = (value if digits is None else float(f"{value:.{digits}g}")) + 0.0  # -0.0 is 0.0
    if si == "1":
        return f"{value:.{_DIGITS}g}"
    first = re.match(r"[a-zA-Z]+(?!\^|[a-zA-Z])", si)
    if first and first[0] in _SMALL_PREFIXES and value != 0.0 and math.isfinite(value):
        rounded = float(f"{value:.{_DIGITS}g}")  # 999.999 is 1000, which has the next prefix
        power = _STEP * math.floor(math.log10(abs(rounded)) / _STEP)
        power = min(power, 0) if first[0] not in _LARGE_PREFIXES else power
        prefix = next((prefix for prefix, exponent in PREFIXES.items() if exponent == power), "")
        if prefix:
            return f"{value / 10.0**power:.{_DIGITS}g} {prefix}{si}"
    return f"{value:.{_DIGITS}g} {si}"
