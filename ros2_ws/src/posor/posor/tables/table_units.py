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
    "uin": ("m", "0.0254e-6", "0"),
    "ft": ("m", "0.3048", "0"),
    "dm": ("m", "0.1", "0"),
    "cm": ("m", "0.01", "0"),
    "angstrom": ("m", "1e-10", "0"),
    "deg": ("rad", str(Decimal(math.pi) / 180), "0"),
    "mdeg": ("rad", str(Decimal(math.pi) / 180 / 1000), "0"),
    "arcmin": ("rad", str(Decimal(math.pi) / 180 / 60), "0"),
    "arcsec": ("rad", str(Decimal(math.pi) / 180 / 3600), "0"),
    "mas": ("rad", str(Decimal(math.pi) / 180 / 3600 / 1000), "0"),
    "gon": ("rad", str(Decimal(math.pi) / 200), "0"),
    "mgon": ("rad", str(Decimal(math.pi) / 200 / 1000), "0"),
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
_SPELLINGS = {  # other spellings of a unit, in lower case
    "V": "v volt volts",
    "mV": "mv",
    "uV": "uv",
    "A": "a amp amps ampere amperes",
    "mA": "ma",
    "uA": "ua",
    "m": "meter meters metre metres",
    "mm": "mm",
    "um": "um micron microns",
    "in": "inch inches zoll",
    "mil": "mils thou thous",
    "uin": "\N{MICRO SIGN}in \N{GREEK SMALL LETTER MU}in uinch microinch microinches",
    "ft": "foot feet",
    "angstrom": "\N{LATIN SMALL LETTER A WITH RING ABOVE} angstroms",
    "rad": "rad rads radian radians",
    "deg": "deg degs degree degrees \N{DEGREE SIGN}",
    "mdeg": "millideg millidegree millidegrees",
    "arcmin": "arcmin arcmins arcminute arcminutes",
    "arcsec": "arcsec arcsecs arcsecond arcseconds",
    "gon": "gons gradian gradians",
    "s": "sec secs second seconds",
    "min": "mins minute minutes",
    "h": "hr hrs hour hours",
    "d": "day days",
    "degC": "c \N{DEGREE SIGN}c degc celsius degcelsius degreec degreesc degreecelsius degreescelsius",
    "degF": "f \N{DEGREE SIGN}f degf fahrenheit degfahrenheit degreef degreesf degreefahrenheit degreesfahrenheit",
    "K": "kelvin kelvins",
    "1": "-",
    "%": "percent",
}
_WORDS = {"V": "volt", "A": "amp ampere", "m": "meter metre", "rad": "radian", "s": "sec second"}
_ALIASES = {spelling: name for name, spellings in _SPELLINGS.items() for spelling in spellings.split()}
_ALIASES |= {  # mVolt, msecs, milliseconds
    f"{prefix}{word}{plural}": f"{sign}{si}"
    for sign, word_prefix in (("k", "kilo"), ("m", "milli"), ("u", "micro"), ("n", "nano"), ("p", "pico"))
    for prefix in (sign, word_prefix)
    for si, words in _WORDS.items()
    for word in words.split()
    for plural in ("", "s")
}
_QUALIFIER = re.compile(r"\s*(DC|rms|peak|pp|p-p|pk-pk)$", re.IGNORECASE)
_IN_BRACKETS = re.compile(r"[\[({]\s*([^\[\](){}]+?)\s*[\])}]")
_AFTER_WORD = re.compile(r"(\S*)\s+/\s*(\S+)\s*$|\s(in)\s+(\S+)\s*$")  # U / V, gap in V
_LAST_PART = re.compile(r"(?:[_\s,]|(?:^|\s)([^\s/]+)/)([^\W_]+)\s*$")  # gap_mV, gap mV, AI0/mV, but no path
_TEMPERATURE = re.compile(r"temp[^\W_]*[\s_]+([CF])\s*$", re.IGNORECASE)  # temp_F, but the contact C of a diode
_LABELS = {"1", "a", "d", "h", "k", "m", "in", "mil", "min", "pm", "mas"}
_LABELS |= {"amp", "degree", "foot", "meter", "micrometer", "second", "minute", "hour", "day"}
"""Last parts of names that mean something else, such as the contact of a diode or an instrument; in lower case."""
_NO_UNIT = re.compile(r"[\d\s:,+-]*|(?:\w*/)?[^\W\d_]+[\s_]*\d+")
"""Texts in brackets that are no unit: an index, and a name with a number, such as probe 1."""


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
    """Return a unit by its name, or by a usual other spelling of it: ``mVDC``, ``deg C``; None: unknown."""
    text = _QUALIFIER.sub("", text.strip().rstrip("."))
    return UNITS.get(text) or UNITS.get(_ALIASES.get(re.sub(r"(?<=\w)[\s.-]+", "", text).lower(), ""))


def unit_in_name(name: str) -> Unit | None:
    """Return the unit in a column's name: ``AI0 (mV)``, ``AI0/mV``, ``AI0 in mV``, ``AI0_mV``; None: there is none."""
    units = [unit for text in _IN_BRACKETS.findall(name) if text != "1" and (unit := _unit_in_brackets(text))]
    if units:
        return units[-1]
    if match := _AFTER_WORD.search(name):
        return None if find_unit(match[1] or "") else find_unit(match[2] or match[4])
    if match := _TEMPERATURE.search(name):
        return find_unit(match[1])
    match = _LAST_PART.search(name)
    if match is None or match[2].lower() in _LABELS or find_unit(match[1] or ""):  # V/m is another quantity
        return None
    return UNITS.get(match[2]) if len(match[2]) == 1 else find_unit(match[2])


def _unit_in_brackets(text: str) -> Unit | None:
    """Return the unit that a text in brackets is, or begins with: ``mV``, ``mV, filtered``."""
    first, *rest = re.split(r"[\s,;]+", text, maxsplit=1)
    return find_unit(text) or (UNITS.get(first) if rest and first.lower() not in _LABELS else None)


def unknown_unit_in_name(name: str) -> str:
    """Return the text in brackets that may be an unknown unit, as in ``x [cubit]``; empty: none, or a known unit."""
    texts = [] if unit_in_name(name) else _IN_BRACKETS.findall(name)
    return next((text for text in texts if not _NO_UNIT.fullmatch(text)), "")


def _contains_unit(text: str) -> bool:
    """Return whether a text that is no known unit contains one, as ``V/m`` or ``1/100 mm``."""
    return any(word in UNITS and word.lower() not in _LABELS for word in re.findall(r"[^\W\d_]+", text))


def stated_unit(name: str, stated: str = "") -> tuple[Unit | None, str]:
    """Return the unit of a column, or what its file states in place of a known unit.

    ``name``: of the column. ``stated``: text at a place for units alone, such as ``unit_string`` of TDMS.
    """
    unit = find_unit(stated) or unit_in_name(name)
    unknown = stated.strip() or next((text for text in _IN_BRACKETS.findall(name) if _contains_unit(text)), "")
    return (unit, "") if unit else (None, unknown)


def units_of(si: str) -> list[str]:
    """Return the names of all units that become an SI unit."""
    return [name for name, unit in UNITS.items() if unit.si == si and name.isascii()]
