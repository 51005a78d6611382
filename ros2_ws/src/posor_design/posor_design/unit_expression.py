"""Units as a user writes them, such as ``um``, ``lb/in^3`` or ``N m/rad``, and their amount in SI units.

An expression is a product of symbols. A space, ``*`` or ``-`` multiplies, ``/`` divides by the one symbol that follows,
and ``^`` raises a symbol to a power. The radian is a dimension of its own here, so that ``Hz`` and ``rad/s`` cannot be
confused. ``lb`` is a mass and ``lbf`` a force. Source: BIPM, The International System of Units (2019), tables 4 and 7;
NIST SP 811 (2008), appendix B.8.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cache
from pathlib import Path

import yaml
from posor.calibration.quantity import CONVERTED_UNITS

_BASE = ("m", "kg", "s", "A", "K", "rad")
PREFIXES = {"G": 9, "M": 6, "k": 3, "c": -2, "m": -3, "u": -6, "µ": -6, "n": -9, "p": -12, "f": -15}


def _read_definitions() -> dict[str, tuple[Decimal, str]]:
    """Return the amount of each symbol in other units."""
    text = Path(__file__).with_name("units.yaml").read_text(encoding="utf-8")
    found = {symbol: (factor, si) for symbol, (si, factor) in CONVERTED_UNITS.items()}
    for symbol, definition in yaml.safe_load(text).items():
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
