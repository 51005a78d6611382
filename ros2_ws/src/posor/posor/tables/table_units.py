# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Units of the columns of a table, and how they become those of SI."""

from __future__ import annotations

import math
import re
from decimal import Decimal
from typing import NamedTuple

_PREFIXES = {"p": "1e-12", "n": "1e-9", "u": "1e-6", "\N{MICRO SIGN}": "1e-6", "\N{GREEK SMALL LETTER MU}": "1e-6"}
_PREFIXES |= {"m": "1e-3", "": "1", "k": "1e3"}
_OTHERS = {  # SI unit, its amount in one of the unit, and the SI value at zero
    "in": ("m", "0.0254", "0"),
    "mil": ("m", "0.0254e-3", "0"),
    "cm": ("m", "0.01", "0"),
    "deg": ("rad", str(Decimal(math.pi) / 180), "0"),
    "arcmin": ("rad", str(Decimal(math.pi) / 180 / 60), "0"),
    "arcsec": ("rad", str(Decimal(math.pi) / 180 / 3600), "0"),
    "min": ("s", "60", "0"),
    "h": ("s", "3600", "0"),
    "d": ("s", "86400", "0"),
    "degC": ("K", "1", "273.15"),
    "degF": ("K", str(Decimal(5) / 9), str(Decimal("459.67") * 5 / 9)),
    "K": ("K", "1", "0"),
    "mK": ("K", "1e-3", "0"),
    "1": ("1", "1", "0"),
    "%": ("1", "0.01", "0"),
}
_ALIASES = {
    "volt": "V",
    "volts": "V",
    "amp": "A",
    "amps": "A",
    "ampere": "A",
    "sec": "s",
    "second": "s",
    "seconds": "s",
}
_ALIASES |= {"msec": "ms", "usec": "us", "kelvin": "K", "celsius": "degC", "c": "degC", "f": "degF", "inch": "in"}
_ALIASES |= {"°c": "degC", "°f": "degF", "°": "deg", "degrees": "deg", "v": "V", "a": "A", "-": "1", "inches": "in"}
_ALIASES |= {"mv": "mV", "uv": "uV", "ma": "mA", "ua": "uA"}
_ALIASES |= {
    f"{prefix}{word}{plural}": f"{sign}{si}"
    for prefix, sign in (("milli", "m"), ("micro", "u"), ("nano", "n"))
    for word, si in (("volt", "V"), ("amp", "A"), ("ampere", "A"), ("second", "s"), ("meter", "m"), ("metre", "m"))
    for plural in ("", "s")
}
_DIRECT = re.compile(r"\s*DC$", re.IGNORECASE)
_IN_BRACKETS = re.compile(r"[\[({]\s*([^\[\](){}]+?)\s*[\])}]")
_AFTER_WORD = re.compile(r"(\S*)\s+/\s*(\S+)\s*$|\s(in)\s+(\S+)\s*$")  # U / V, gap in V
_LAST_PART = re.compile(r"(?:_|,\s*|(?:^|\s)([^\s/]+)/)([^\W_]+)\s*$")  # gap_mV, AI0/mV, but no path
_LABELS = {"1", "A", "K", "d", "h", "in", "m", "mil", "min", "pm"}
"""Last parts of names that mean something else, such as the contact of a diode or the type of a thermocouple."""


class Unit(NamedTuple):
    """A unit as text, its SI unit, the amount of SI units in one, and the SI value at its zero."""

    name: str
    si: str
    factor: Decimal
    shift: Decimal


UNITS = {
    f"{prefix}{si}": Unit(f"{prefix}{si}", si, Decimal(factor), Decimal(0))
    for si in ("V", "A", "m", "rad", "s")
    for prefix, factor in _PREFIXES.items()
} | {name: Unit(name, si, Decimal(factor), Decimal(shift)) for name, (si, factor, shift) in _OTHERS.items()}


def find_unit(text: str) -> Unit | None:
    """Return a unit by its name, or by a usual other spelling of it; None: unknown."""
    text = _DIRECT.sub("", text)
    return UNITS.get(text) or UNITS.get(_ALIASES.get(text.lower(), ""))


def unit_in_name(name: str) -> Unit | None:
    """Return the unit in a column's name: ``AI0 (mV)``, ``AI0/mV``, ``AI0 in mV``, ``AI0_mV``; None: there is none."""
    units = [unit for text in _IN_BRACKETS.findall(name) if text != "1" and (unit := find_unit(text))]  # 1: an index
    if units:
        return units[-1]
    if match := _AFTER_WORD.search(name):
        return None if find_unit(match[1] or "") else find_unit(match[2] or match[4])
    match = _LAST_PART.search(name)
    if match is None or match[2] in _LABELS or find_unit(match[1] or ""):  # V/m is another quantity
        return None
    return UNITS.get(match[2])


def units_of(si: str) -> list[str]:
    """Return the names of all units that become an SI unit."""
    return [name for name, unit in UNITS.items() if unit.si == si and name.isascii()]
