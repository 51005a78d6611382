"""Effect of the air on a laser interferometer, and the reading of straightness optics."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor.errors import ParameterError
from posor.uncertainty.air_index import Air

from posor_design.checks import require_finite, require_positive

if TYPE_CHECKING:
    from posor_design.units import Kelvin, Metre, Number, Pascal, Radian


@dataclass(frozen=True)
class AirEffects:
    """Change of the refractive index of air, which is the relative error of a length that ignores it.

    Attributes:
        index: Refractive index of the air.
        temperature_effect: Its change by the change of the temperature, at the same relative humidity.
        pressure_effect: Its change by the change of the pressure.
        humidity_effect: Its change by the change of the relative humidity.
        total: Its change by all three.

    """

    index: Number
    temperature_effect: Number
    pressure_effect: Number
    humidity_effect: Number
    total: Number


def air_effects(
    temperature_change: Kelvin,
    pressure_change: Pascal,
    humidity_change: Number,
    temperature: Kelvin = 293.15,
    pressure: Pascal = 101325.0,
    relative_humidity: Number = 0.5,
    wavelength: Metre = 632.99e-9,
) -> AirEffects:
    """Effect of changes of the air on the wavelength of a laser interferometer.

    The default wavelength is that of a helium-neon laser in vacuum.

    Args:
        temperature_change: Change of the temperature of the air.
        pressure_change: Change of its pressure.
        humidity_change: Change of its relative humidity, of which all is 1.
        temperature: Temperature before the change.
        pressure: Pressure before the change.
        relative_humidity: Relative humidity before the change, from 0 to 1.
        wavelength: Vacuum wavelength.

    Raises:
        ParameterError: The air before or after a change, or the wavelength, is out of the range of the equations.

    Source: thesis, appendix 4A (effects to compare with); index of air: Ciddor, Applied Optics 35(9), 1566-1573, 1996.

    Example:
        posor design air-effects --temperature-change '1 K' --pressure-change '.1 inHg' --humidity-change '30 %'

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
    """Reading of straightness optics.

    Attributes:
        displacement: Displacement across the axis.
        magnification: Change of the path over this displacement.

    """

    displacement: Metre
    magnification: Number


def straightness_optics(path_change: Metre, angle: Radian) -> StraightnessOptics:
    """Displacement across the axis from the difference of two paths that diverge from a Wollaston prism.

    Each mirror stands square to its path. A displacement lengthens one path and shortens the other, each by its sine of
    half the angle. Equation 4A.1 is printed with displacement and change of the path exchanged.

    Args:
        path_change: Change of the difference of the two paths, each counted once.
        angle: Angle between the two paths.

    Raises:
        ParameterError: An argument is not finite, or the angle is not between zero and a right angle.

    Source: thesis, appendix 4A, equation 4A.1 and figure 4A.4.

    Example:
        posor design straightness-optics --path-change '1 um' --angle '1.6 deg'

    """
    require_finite(path_change=path_change)
    require_positive(angle=angle)
    if angle >= math.pi / 2.0:
        raise ParameterError(f"{angle:g} rad", where="angle", expected="less than a right angle")
    magnification = 2.0 * math.sin(0.5 * angle)
    return StraightnessOptics(path_change / magnification, magnification)
