# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
r"""Units in D-SI (Digital SI, PTB), the notation of a DCC: ``\metre\tothe{2}``, made from and compared with symbols.

Source: D-SI 2.1.0 with the units of the SI brochure, 9th edition. Its schema takes any text for a unit.
"""

from __future__ import annotations

import re

SYMBOLS = {
    "1": "one",
    "A": "ampere",
    "C": "coulomb",
    "Hz": "hertz",
    "J": "joule",
    "K": "kelvin",
    "N": "newton",
    "Pa": "pascal",
    "V": "volt",
    "W": "watt",
    "deg": "degree",
    "kg": "kilogram",
    "m": "metre",
    "rad": "radian",
    "s": "second",
    "Ω": "ohm",
    "°C": "degreecelsius",
}
"""Names of the units that files of this project and their users write as symbols."""
_PREFIX_NAMES = (
    "deca hecto kilo mega giga tera peta exa zetta yotta deci centi milli micro nano pico femto atto zepto yocto"
)
_OTHER_NAMES = (
    "mole candela gram steradian farad siemens weber tesla henry lumen lux becquerel gray sievert katal day hour "
    "minute arcminute arcsecond hectare litre tonne electronvolt dalton astronomicalunit neper bel decibel percent ppm "
    "bit byte bar mmHg angstrom nauticalmile knot"
)
_UNIT_NAMES = "|".join(sorted({*SYMBOLS.values(), *_OTHER_NAMES.split()}, key=len, reverse=True))
_FACTOR = (
    rf"(?:\\(?:{'|'.join(_PREFIX_NAMES.split())}))?\\(?:{_UNIT_NAMES})(?![a-zA-Z])(?:\\tothe\{{[-+]?\d+(?:\.\d+)?\}})?"
)
_DSI = re.compile(rf"{_FACTOR}(?:(?:\\per)?{_FACTOR})*")
_SYMBOL = re.compile(r"([^\W\d_]+|°C|1)(?:\^?(-?\d+(?:\.\d+)?))?")


def is_dsi(unit: str) -> bool:
    """Return whether a text is a unit in D-SI."""
    return _DSI.fullmatch(unit) is not None


def to_dsi(unit: str) -> str:
    r"""Return a unit of a file, such as ``m/s^2`` or ``1/K``, in D-SI: ``\metre\second\tothe{-2}``; empty: unknown."""
    found = ""
    for number, factor in enumerate(unit.split("/")):
        match = _SYMBOL.fullmatch(factor.strip())
        if match is None or match[1] not in SYMBOLS:
            return ""
        power = match[2] or "1"
        if number:
            power = power[1:] if power.startswith("-") else f"-{power}"
        if match[1] != "1" and float(power):
            found += rf"\{SYMBOLS[match[1]]}" + ("" if power == "1" else rf"\tothe{{{power}}}")
    return found or r"\one"
