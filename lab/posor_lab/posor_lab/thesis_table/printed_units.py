"""Units in which the thesis prints its numbers, and those of the files of rows, in SI units."""

from __future__ import annotations

import math

from posor.errors import DataFileError
from scipy.constants import arcsec, degree, foot, g, inch, lb, lbf, minute, psi

UNITS: dict[str, float] = (
    dict.fromkeys(("1", "m", "rad", "rad/s", "s", "Hz", "kg", "kg/m^3", "K", "N", "Pa", "V", "W", "A/W", "Ohm"), 1.0)
    | {"in": inch, "uin": 1e-6 * inch, "mm": 1e-3, "um": 1e-6, "ft": foot, "in^2": inch**2, "in^4": inch**4}
    | {"urad": 1e-6, "deg": degree, "arcsec": arcsec, "rev/s": 2.0 * math.pi}
    | {"min": minute, "ms": 1e-3, "us": 1e-6, "g": g, "in/s^2": inch, "1/F": 1.8, "F": 1.0 / 1.8}
    | {"lb": lb, "lb/ft": lb / foot, "lb/in^3": lb / inch**3, "lbf": lbf, "in lbf": lbf * inch, "inHg": 3386.389}
    | {"psi": psi, "ksi": 1e3 * psi, "1e6 psi": 1e6 * psi, "mW": 1e-3, "pF": 1e-12, "nV/Hz^0.5": 1e-9, "ppm": 1e-6}
    | {"in/V": inch, "uin/in": 1e-6, "in/Hz^0.5": inch}
)
"""Amount of each unit; inHg: NIST SP 811, appendix B.8."""


def amount(unit: str) -> float:
    """Return the amount of a unit in SI units; a number stands for itself.

    Raises:
        DataFileError: The unit is unknown.

    """
    try:
        return UNITS[unit] if unit in UNITS else float(unit)
    except ValueError:
        raise DataFileError(f"unit '{unit}' is unknown", expected=f"a number or one of {', '.join(UNITS)}") from None
