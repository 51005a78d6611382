# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Correction and standard uncertainty of a laser interferometer that serves as reference of a calibration.

The interferometer counts wavelengths between its fixed optics and a retroreflector. It converts them with an assumed
refractive index ``n_0``, and was set to zero at a distance, the dead path ``D``, in air of index ``n_1``. In air of
index ``n``, with ``N`` half vacuum wavelengths counted, ``N lambda / 2 = n (D + L) - n_1 D`` gives the displacement

    L = (n_0 / n) l - (n - n_1) D / n,  l the reading.

To it are added the cosine error ``L theta^2 / 2``, and subtracted the Abbe error (offset times angle) and the thermal
growth of the machine between the optics (length times coefficient times change of temperature).

Sources: thesis, appendix 4A (refractive index, dead path, material temperature, cosine error) and sections 4.1 and 7.2
(Abbe offset; size of the terms); JCGM 100, 5.1.2 (independent input quantities) and F.2.4.4 (cosine error). The thesis
states the terms in words; the equations here are derived from them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from posor.errors import ParameterError
from posor.uncertainty.air_index import Air, Range, index_sensitivities

SMALL_ANGLE = Range(-0.02, 0.02, "rad")
"""Misalignment up to which the cosine error is theta^2 / 2 to 1e-7 of the length."""
ASSUMED_INDEX = Range(1.0, 1.001, "")
PLAUSIBLE = {  # what is beyond has another unit, or is no change
    "offset": Range(-1.0, 1.0, "m"),
    "angle": SMALL_ANGLE,
    "length": Range(-10.0, 10.0, "m"),
    "coefficient": Range(-1e-3, 1e-3, "1/K"),
    "temperature_change": Range(-100.0, 100.0, "K"),
    "dead_path": Range(0.0, 10.0, "m"),
    "misalignment": SMALL_ANGLE,
}
"""By field of the dataclasses below: range of the value; the standard uncertainty is at most the upper bound."""


@dataclass(frozen=True)
class Input:
    """Input quantity of the model."""

    value: float  # estimate, in SI units
    uncertainty: float = 0.0  # its standard uncertainty, in the same unit

    def __mul__(self, other: Input) -> Input:
        """Return the product with an independent input; variance with its term of second order (JCGM 100, 5.1.2)."""
        spread = math.hypot(
            self.value * other.uncertainty, other.value * self.uncertainty, self.uncertainty * other.uncertainty
        )
        return Input(self.value * other.value, spread)


ZERO = Input(0.0)


class _Inputs:
    """Base of the dataclasses below: refuses input quantities that are not numbers, or not plausible."""

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]  # subclasses are dataclasses
            content = getattr(self, field.name)
            for quantity in content if isinstance(content, tuple) else (content,):
                if isinstance(quantity, Input):
                    where = f"{type(self).__name__}.{field.name}"
                    _require_finite(quantity, where)
                    if plausible := PLAUSIBLE.get(field.name):
                        plausible.require(quantity.value, where)
                        plausible.require(quantity.uncertainty, f"{where}, standard uncertainty")


def _require_finite(quantity: Input, where: str) -> None:
    if not math.isfinite(quantity.value):
        raise ParameterError(f"value {quantity.value:g}", where=where, expected="a finite number")
    if not (math.isfinite(quantity.uncertainty) and quantity.uncertainty >= 0.0):
        expected = "a finite number of at least zero"
        raise ParameterError(f"standard uncertainty {quantity.uncertainty:g}", where=where, expected=expected)


@dataclass(frozen=True)
class AirQuantities(_Inputs):
    """Air along the beam, or its change."""

    temperature: Input  # [K]
    pressure: Input  # [Pa]
    relative_humidity: Input  # over water, from 0 to 1
    co2_fraction: Input  # molar fraction of carbon dioxide

    @property
    def each(self) -> tuple[Input, Input, Input, Input]:
        """The four quantities, in the order of ``IndexSensitivities``."""
        return (self.temperature, self.pressure, self.relative_humidity, self.co2_fraction)


NO_CHANGE = AirQuantities(ZERO, ZERO, ZERO, ZERO)


@dataclass(frozen=True)
class AbbeOffset(_Inputs):
    """Distance between the axis of measurement and the point of interest, and the turn of the carriage."""

    offset: Input  # distance across the beam [m]
    angle: Input  # turn since the zero [rad], positive if the interferometer reads more than the point moves


@dataclass(frozen=True)
class Expansion(_Inputs):
    """Part of the machine between the optics, whose growth adds to the reading."""

    length: Input  # [m]
    coefficient: Input  # of thermal expansion [1/K]
    temperature_change: Input  # of the part since the zero [K]


@dataclass(frozen=True)
class Interferometer(_Inputs):
    """Set-up of an interferometer. All input quantities are independent."""

    wavelength: Input  # vacuum wavelength [m]
    assumed_index: float  # refractive index by which the instrument divides, the inverse of its compensation factor
    air: AirQuantities  # air along the beam at the reading
    index_uncertainty: float  # standard uncertainty of the equation for the index of air
    # change of the air since the zero. Its uncertainty is that of the change: a constant error of the air sensors does
    # not count
    air_change: AirQuantities = NO_CHANGE
    dead_path: Input = ZERO  # distance of the retroreflector from the interferometer at the zero [m]
    # angles between beam and motion in two perpendicular planes [rad], at most 0.02 rad
    misalignment: tuple[Input, Input] = (ZERO, ZERO)
    abbe_offsets: tuple[AbbeOffset, ...] = ()  # of the planes in which the carriage turns
    expansions: tuple[Expansion, ...] = ()  # parts of the machine that change their length

    def __post_init__(self) -> None:
        super().__post_init__()
        ASSUMED_INDEX.require(self.assumed_index, "Interferometer.assumed_index")
        _require_finite(Input(0.0, self.index_uncertainty), "Interferometer.index_uncertainty")


@dataclass(frozen=True)
class Term:
    """Term of the correction."""

    name: str  # name of the term
    effect: float  # its part of the correction [m]
    standard_uncertainty: float  # its part of the standard uncertainty [m]


@dataclass(frozen=True)
class CorrectedReading:
    """A reading with its correction."""

    reading: float  # displacement that the instrument shows [m]
    # the terms. The effect of the index of air stands in its own term, together with the uncertainty of the equation;
    # temperature, pressure, humidity and carbon dioxide follow with their uncertainties
    terms: tuple[Term, ...]

    @property
    def correction(self) -> float:
        """Sum of all effects, to be added to the reading [m]."""
        return math.fsum(term.effect for term in self.terms)

    @property
    def displacement(self) -> float:
        """Corrected reading [m]."""
        return self.reading + self.correction

    @property
    def standard_uncertainty(self) -> float:
        """Standard uncertainty of the correction [m]: root sum square of all terms (JCGM 100, equation 10)."""
        return math.hypot(*(term.standard_uncertainty for term in self.terms))


def correct_reading(setup: Interferometer, reading: float) -> CorrectedReading:
    """Return the correction of a reading, to first order in each effect: products of two effects are left out.

    ``setup``: the interferometer and its surroundings. ``reading``: displacement since the zero that the instrument
    shows [m]. Raises ParameterError: the reading is not finite, or the air at the reading or at the zero is out of
    range.
    """
    _require_finite(Input(reading), "reading")
    wavelength, air = setup.wavelength.value, Air(*(quantity.value for quantity in setup.air.each))
    index, sensitivities = air.index(wavelength), index_sensitivities(wavelength, air)
    length = reading * setup.assumed_index / index
    names = ("air temperature", "air pressure", "relative humidity", "carbon dioxide")
    return CorrectedReading(
        reading,
        (
            Term("index of air", length - reading, abs(length) * setup.index_uncertainty / index),
            *(
                Term(name, 0.0, abs(length * sensitivity) * quantity.uncertainty / index)
                for name, sensitivity, quantity in zip(names, sensitivities, setup.air.each, strict=True)
            ),
            Term("vacuum wavelength", 0.0, abs(length) * setup.wavelength.uncertainty / wavelength),
            _dead_path(setup, index, sensitivities),
            _cosine_error(setup, length),
            _term("Abbe offset", [abbe.offset * abbe.angle for abbe in setup.abbe_offsets]),
            _term("thermal expansion", [e.length * e.coefficient * e.temperature_change for e in setup.expansions]),
        ),
    )


def _term(name: str, errors: list[Input]) -> Term:
    """Return the term of independent errors of the reading, which the correction takes away."""
    effect = 0.0 - math.fsum(e.value for e in errors)  # the minus sign alone would print -0.0
    return Term(name, effect, math.hypot(*(e.uncertainty for e in errors)))


def _dead_path(setup: Interferometer, index: float, sensitivities: tuple[float, ...]) -> Term:
    """Return the term of the dead path, whose number of wavelengths changes with the air."""
    before = Air(*(now.value - change.value for now, change in zip(setup.air.each, setup.air_change.each, strict=True)))
    change = index - before.index(setup.wavelength.value)
    uncertainties = (s * quantity.uncertainty for s, quantity in zip(sensitivities, setup.air_change.each, strict=True))
    return _term("dead path", [setup.dead_path * Input(change / index, math.hypot(*uncertainties) / index)])


def _cosine_error(setup: Interferometer, length: float) -> Term:
    """Return expectation and standard deviation of L theta^2 / 2, which is never negative (JCGM 100, F.2.4.4).

    For normal deviations u of an angle from its estimate a, the expectation of the square is a^2 + u^2 and its variance
    2 u^4 + 4 a^2 u^2. For a = 0 and equal u in both planes these are the u^2 and u^4 of F.2.4.4.
    """
    mean = math.fsum(a.value**2 + a.uncertainty**2 for a in setup.misalignment) / 2.0
    variance = math.fsum(a.uncertainty**4 / 2.0 + (a.value * a.uncertainty) ** 2 for a in setup.misalignment)
    return Term("cosine error", length * mean, abs(length) * math.sqrt(variance))
