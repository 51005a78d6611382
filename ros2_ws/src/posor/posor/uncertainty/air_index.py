# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Refractive index of air (phase index) from wavelength, temperature, pressure, humidity and carbon dioxide.

Sources: P. E. Ciddor, *Refractive index of air: new equations for the visible and near infrared*, Applied Optics 35(9),
1566-1573, 1996: dispersion, density, compressibility, enhancement factor. Saturation vapour pressure: IAPWS-IF97,
region 4, as in J. A. Stone and J. H. Zimmerman, *Index of Refraction of Air*, NIST Engineering Metrology Toolbox; their
ranges are the ranges here. Ciddor takes an older equation for it: the index differs by less than 1e-9 up to 60 C.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from posor.errors import ParameterError

ICE_POINT = 273.15  # 0 C [K]
CO2_FRACTION = 450e-6  # carbon dioxide of Ciddor's standard air, molar fraction


class Range(NamedTuple):
    """Range of a quantity in which the equations are valid."""

    lower: float
    upper: float
    unit: str

    def require(self, value: float, where: str) -> None:
        """Refuse a value outside the range, or one that is not a number."""
        if not self.lower <= value <= self.upper:
            expected = f"a value from {self.lower:g} to {self.upper:g} {self.unit}".rstrip()
            raise ParameterError(f"{value:g} {self.unit}".rstrip(), where=where, expected=expected)


WAVELENGTH = Range(300e-9, 1700e-9, "m")
TEMPERATURE = Range(ICE_POINT - 40.0, ICE_POINT + 100.0, "K")
MOIST_TEMPERATURE = Range(ICE_POINT, ICE_POINT + 100.0, "K")
PRESSURE = Range(10e3, 140e3, "Pa")
FRACTION = Range(0.0, 1.0, "")
CO2_FRACTIONS = Range(0.0, 2000e-6, "")

_IF97 = (  # IAPWS-IF97, table 34
    1.1670521452767e3,
    -7.2421316703206e5,
    -1.7073846940092e1,
    1.2020824702470e4,
    -3.2325550322333e6,
    1.4915108613530e1,
    -4.8232657361591e3,
    4.0511340542057e5,
    -2.3855557567849e-1,
    6.5017534844798e2,
)


def saturation_pressure(temperature: float) -> float:
    """Return the pressure of saturated water vapour over water [Pa] at a temperature [K] (IAPWS-IF97, equation 30)."""
    n = _IF97
    theta = temperature + n[8] / (temperature - n[9])
    a = theta * theta + n[0] * theta + n[1]
    b = n[2] * theta * theta + n[3] * theta + n[4]
    c = n[5] * theta * theta + n[6] * theta + n[7]
    return 1e6 * (2.0 * c / (math.sqrt(b * b - 4.0 * a * c) - b)) ** 4


def vapour_fraction(relative_humidity: float, temperature: float, pressure: float) -> float:
    """Return the molar fraction of water vapour in moist air (Ciddor 1996, appendix A, with the enhancement factor).

    ``relative_humidity``: over water, from 0 to 1. ``temperature``: of the air [K], at least 273.15 K. ``pressure``: of
    the air [Pa]. Raises ParameterError: a value is out of range, or the vapour pressure exceeds the pressure of the
    air.
    """
    FRACTION.require(relative_humidity, "relative humidity")
    MOIST_TEMPERATURE.require(temperature, "temperature of moist air")
    PRESSURE.require(pressure, "pressure")
    fraction = _vapour_fraction(relative_humidity, temperature, pressure)
    FRACTION.require(fraction, "water vapour fraction")
    return fraction


def _vapour_fraction(relative_humidity: float, temperature: float, pressure: float) -> float:
    celsius = temperature - ICE_POINT
    enhancement = 1.00062 + 3.14e-8 * pressure + 5.6e-7 * celsius * celsius
    return enhancement * relative_humidity * saturation_pressure(temperature) / pressure


def air_index(
    wavelength: float,
    temperature: float,
    pressure: float,
    vapour_fraction: float = 0.0,
    co2_fraction: float = CO2_FRACTION,
) -> float:
    """Return the refractive index of air (Ciddor 1996, equations 1 to 5 and appendices A and B).

    ``wavelength``: in vacuum [m], 300 nm to 1700 nm. ``temperature``: of the air [K], 233.15 K to 373.15 K (ITS-90).
    ``pressure``: of the air [Pa], 10 kPa to 140 kPa. ``vapour_fraction``: molar fraction of water vapour, as
    ``vapour_fraction`` returns it. ``co2_fraction``: molar fraction of carbon dioxide, 0 to 2000e-6. Raises
    ParameterError: a value is out of range.
    """
    WAVELENGTH.require(wavelength, "wavelength")
    TEMPERATURE.require(temperature, "temperature")
    PRESSURE.require(pressure, "pressure")
    FRACTION.require(vapour_fraction, "water vapour fraction")
    CO2_FRACTIONS.require(co2_fraction, "carbon dioxide fraction")
    return _air_index(wavelength, temperature, pressure, vapour_fraction, co2_fraction)


def _air_index(
    wavelength: float, temperature: float, pressure: float, vapour_fraction: float, co2_fraction: float
) -> float:
    s = (1e-6 / wavelength) ** 2  # square of the wavenumber [1/um^2]
    dry = 1e-8 * (5792105.0 / (238.0185 - s) + 167917.0 / (57.362 - s))  # 15 C, 101325 Pa, 450 ppm
    dry *= 1.0 + 0.534 * (co2_fraction - CO2_FRACTION)
    vapour = 1.022e-8 * (295.235 + s * (2.6422 + s * (-0.032380 + s * 0.004028)))  # pure, 20 C, 1333 Pa
    amount = _molar_density(temperature, pressure, vapour_fraction)
    dry_share = (1.0 - vapour_fraction) * amount / _molar_density(288.15, 101325.0, 0.0)
    vapour_share = vapour_fraction * amount / _molar_density(293.15, 1333.0, 1.0)
    return 1.0 + dry_share * dry + vapour_share * vapour


def _molar_density(temperature: float, pressure: float, vapour_fraction: float) -> float:
    """Return p / (Z T) [Pa/K]: the density without the molar mass and the gas constant, which cancel in the ratios.

    Z is the compressibility of moist air of the BIPM (1991), in Ciddor's appendix A.
    """
    celsius, ratio, x = temperature - ICE_POINT, pressure / temperature, vapour_fraction
    linear = 1.58123e-6 + celsius * (-2.9331e-8 + celsius * 1.1043e-10)
    linear += x * (5.707e-6 - 2.051e-8 * celsius) + x * x * (1.9898e-4 - 2.376e-6 * celsius)
    return ratio / (1.0 - ratio * linear + ratio * ratio * (1.83e-11 - 0.765e-8 * x * x))


@dataclass(frozen=True)
class Air:
    """State of the air as its instruments show it."""

    temperature: float  # [K], 273.15 K to 373.15 K
    pressure: float  # [Pa], 10 kPa to 140 kPa
    relative_humidity: float  # over water, from 0 to 1
    co2_fraction: float = CO2_FRACTION  # molar fraction of carbon dioxide

    def index(self, wavelength: float) -> float:
        """Return the refractive index at a vacuum wavelength [m]; errors as ``air_index``."""
        moisture = vapour_fraction(self.relative_humidity, self.temperature, self.pressure)
        return air_index(wavelength, self.temperature, self.pressure, moisture, self.co2_fraction)


class IndexSensitivities(NamedTuple):
    """Derivatives of the refractive index with respect to the state of the air, each with the others constant."""

    temperature: float  # at constant relative humidity [1/K]
    pressure: float  # at constant relative humidity [1/Pa]
    relative_humidity: float  # for a change from 0 to 1
    co2_fraction: float  # for a change from 0 to 1


STEPS = IndexSensitivities(temperature=0.05, pressure=50.0, relative_humidity=0.01, co2_fraction=50e-6)
"""Of the central differences: what they leave of third order is below 1e-6 of the derivative, rounding below 1e-7."""


def index_sensitivities(wavelength: float, air: Air) -> IndexSensitivities:
    """Return the derivatives of ``Air.index`` by central differences; a step may leave the range by its size.

    Raises ParameterError: the wavelength or the air is out of range.
    """
    air.index(wavelength)

    def index(temperature: float, pressure: float, relative_humidity: float, co2_fraction: float) -> float:
        moisture = _vapour_fraction(relative_humidity, temperature, pressure)
        return _air_index(wavelength, temperature, pressure, moisture, co2_fraction)

    state = (air.temperature, air.pressure, air.relative_humidity, air.co2_fraction)
    derivatives = []
    for i, step in enumerate(STEPS):
        above = index(*(value + step * (i == j) for j, value in enumerate(state)))
        below = index(*(value - step * (i == j) for j, value in enumerate(state)))
        derivatives.append((above - below) / (2.0 * step))
    return IndexSensitivities(*derivatives)
