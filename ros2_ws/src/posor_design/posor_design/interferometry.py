# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Effect of the air on a laser interferometer, and the reading of straightness optics."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from posor.uncertainty.air_index import Air

from posor_design.calculators import ACUTE_ANGLE, calculator


@dataclass(frozen=True)
class AirEffects:
    """Change of the refractive index of air, which is the relative error of a length that ignores it."""

    index: Annotated[float, "1", "Refractive index of the air."]
    temperature_effect: Annotated[float, "1", "Its change by that of the temperature, at the same relative humidity."]
    pressure_effect: Annotated[float, "1", "Its change by the change of the pressure."]
    humidity_effect: Annotated[float, "1", "Its change by the change of the relative humidity."]
    total: Annotated[float, "1", "Its change by all three."]


@calculator
def air_effects(
    temperature_change: Annotated[float, "K", "Change of the temperature of the air."],
    pressure_change: Annotated[float, "Pa", "Change of its pressure."],
    humidity_change: Annotated[float, "1", "Change of its relative humidity, of which all is 1."],
    temperature: Annotated[float, "K", "Temperature before the change."] = 293.15,
    pressure: Annotated[float, "Pa", "Pressure before the change."] = 101325.0,
    relative_humidity: Annotated[float, "1", "Relative humidity before the change, from 0 to 1."] = 0.5,
    wavelength: Annotated[float, "m", "Vacuum wavelength."] = 632.99e-9,
) -> AirEffects:
    """Effect of changes of the air on the wavelength of a laser interferometer.

    The default wavelength is that of a helium-neon laser in vacuum.

    Source: thesis, appendix 4A (effects to compare with); index of air: Ciddor, Applied Optics 35(9), 1566-1573, 1996.
    """
    air = Air(temperature, pressure, relative_humidity)
    index = air.index(wavelength)

    def effect(by_temperature: float, by_pressure: float, by_humidity: float) -> float:
        changed = Air(temperature + by_temperature, pressure + by_pressure, relative_humidity + by_humidity)
        return changed.index(wavelength) - index

    return AirEffects(
        index=index,
        temperature_effect=effect(temperature_change, 0.0, 0.0),
        pressure_effect=effect(0.0, pressure_change, 0.0),
        humidity_effect=effect(0.0, 0.0, humidity_change),
        total=effect(temperature_change, pressure_change, humidity_change),
    )


@dataclass(frozen=True)
class StraightnessOptics:
    """Reading of straightness optics."""

    displacement: Annotated[float, "m", "Displacement across the axis."]
    magnification: Annotated[float, "1", "Change of the path over this displacement."]


@calculator
def straightness_optics(
    path_change: Annotated[float, "m", "Change of the difference of the two paths, each counted once."],
    angle: Annotated[float, "rad", ACUTE_ANGLE, "Angle between the two paths."],
) -> StraightnessOptics:
    """Displacement across the axis from the difference of two paths that diverge from a Wollaston prism.

    Each mirror stands square to its path. A displacement lengthens one path and shortens the other, each by its sine of
    half the angle. Equation 4A.1 is printed with displacement and change of the path exchanged.

    Source: thesis, appendix 4A, equation 4A.1 and figure 4A.4.
    """
    magnification = 2.0 * math.sin(0.5 * angle)
    return StraightnessOptics(path_change / magnification, magnification)
