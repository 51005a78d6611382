# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Aerostatic journal bearing with a ring of orifices: feed pressure, load, stiffness and flow."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from posor.errors import ParameterError
from scipy.optimize import brentq
from scipy.special import dawsn, erfcx

from posor_design.calculators import POSITIVE, PROPER_SHARE, SHARE, calculator

HEAT_CAPACITY_RATIO = 1.4  # of air
CRITICAL_RATIO = (2.0 / (HEAT_CAPACITY_RATIO + 1.0)) ** (HEAT_CAPACITY_RATIO / (HEAT_CAPACITY_RATIO - 1.0))
"""Ratio of the pressures behind and before an orifice below which its flow is choked."""
CRITICAL_HEAD = (HEAT_CAPACITY_RATIO - 1.0) / (HEAT_CAPACITY_RATIO + 1.0)
"""Velocity head above which the flow of an orifice is choked."""


@dataclass(frozen=True)
class AirBearing:
    """Aerostatic journal bearing."""

    feed_pressure: Annotated[float, "Pa", "Pressure at the orifices, in the film of the centred bearing."]
    load: Annotated[float, "N", "Load at the given eccentricity."]
    stiffness: Annotated[float, "N/m", "Load over eccentricity."]
    mass_flow: Annotated[float, "kg/s", "Flow of the centred bearing."]
    orifice_flow: Annotated[Literal["choked", "subsonic"], "Whether the flow of the orifices is choked or subsonic."]


class _Bearing(NamedTuple):
    """Arguments of ``aerostatic_bearing`` that the models share."""

    length: float
    diameter: float
    clearance: float
    orifice_radius: float
    orifices: int
    discharge_coefficient: float
    supply_pressure: float
    ambient_pressure: float
    viscosity: float
    density: float


class _Feed(NamedTuple):
    """Pressure at the orifices, and how far their flow yields to it.

    ``yielding`` is -(u - u_a) d(log flow)/du, with u the square of the pressure at the orifices if the film is
    compressible, and this pressure if it is not; u_a is u at the ends.
    """

    pressure: float
    yielding: float


@calculator
def aerostatic_bearing(
    diameter: Annotated[float, "m", POSITIVE, "Diameter of the shaft."],
    length: Annotated[float, "m", POSITIVE, "Length of the bearing."],
    clearance: Annotated[float, "m", POSITIVE, "Radius of the housing minus radius of the shaft."],
    orifice_radius: Annotated[float, "m", POSITIVE, "Radius of an orifice."],
    orifices: Annotated[int, POSITIVE, "Number of orifices."],
    supply_pressure: Annotated[float, "Pa", POSITIVE, "Absolute pressure before the orifices."],
    ambient_pressure: Annotated[float, "Pa", POSITIVE, "Absolute pressure at the ends."] = 101325.0,
    discharge_coefficient: Annotated[float, "1", SHARE, "Flow of an orifice over that without losses."] = 0.6,
    eccentricity_ratio: Annotated[float, "1", PROPER_SHARE, "Eccentricity over clearance, 0 to less than 1."] = 0.1,
    viscosity: Annotated[float, "Pa s", POSITIVE, "Dynamic viscosity."] = 1.853e-5,
    density: Annotated[float, "kg/m^3", POSITIVE, "Density at ambient pressure."] = 1.183,
    method: Annotated[Literal["nozzle", "thesis", "incompressible"], "Model of film and orifices."] = "nozzle",
) -> AirBearing:
    """Load, stiffness and flow of a journal bearing with one central ring of orifices and without pockets.

    The film is laminar and isothermal, and the ring acts as a line. The load is linear in the eccentricity: that of the
    example exceeds the solution of Reynolds' equation by 1 % at an eccentricity ratio of 0.1, by 4 % at 0.2 and by 25 %
    at 0.5. There are three models:

    * ``nozzle``: the film is compressible, and the orifices are ideal nozzles, which choke;
    * ``thesis``: the film is compressible, and the orifices follow AIR.FOR, which takes their number where continuity
      of the flow has its square, and twice the yielding of an orifice;
    * ``incompressible``: a liquid of the given density.

    Source: thesis equations 6.12 to 6.21 and AIR.FOR (after Pinkus and Sternlicht, Theory of Hydrodynamic Lubrication,
        1961); nozzle: Powell, Design of Aerostatic Bearings (1970), and ISO 9300 (2022).
    """
    if supply_pressure <= ambient_pressure:
        expected = f"an absolute pressure of more than the ambient one, {ambient_pressure:g} Pa"
        raise ParameterError(f"{supply_pressure:g} Pa", where="supply_pressure", expected=expected)
    bearing = _Bearing(
        length=length,
        diameter=diameter,
        clearance=clearance,
        orifice_radius=orifice_radius,
        orifices=orifices,
        discharge_coefficient=discharge_coefficient,
        supply_pressure=supply_pressure,
        ambient_pressure=ambient_pressure,
        viscosity=viscosity,
        density=density,
    )
    feed = {"nozzle": _nozzle_feed, "thesis": _thesis_feed, "incompressible": _liquid_feed}[method](bearing)
    compressible = method != "incompressible"
    slope = (_gas_load if compressible else _liquid_load)(bearing, feed)
    chokes = method == "nozzle" and feed.pressure < CRITICAL_RATIO * supply_pressure
    return AirBearing(
        feed_pressure=feed.pressure,
        load=slope * eccentricity_ratio,
        stiffness=slope / clearance,
        mass_flow=_film_flow(bearing, feed.pressure, compressible=compressible),
        orifice_flow="choked" if chokes else "subsonic",
    )


def _film_flow(bearing: _Bearing, feed_pressure: float, *, compressible: bool) -> float:
    """Return the mass flow of the centred film to both ends."""
    ambient = bearing.ambient_pressure
    mean_density = bearing.density * (0.5 * (feed_pressure + ambient) / ambient if compressible else 1.0)
    conductance = math.pi * bearing.diameter * bearing.clearance**3 / (3.0 * bearing.viscosity * bearing.length)
    return conductance * mean_density * (feed_pressure - ambient)


def _feed_parameter(bearing: _Bearing, number: float) -> float:
    """Return the parameter of equation 6.19, with the square of the radius that dimensions require in 6.18."""
    difference = bearing.supply_pressure - bearing.ambient_pressure
    flow = bearing.discharge_coefficient * bearing.orifice_radius**2 * bearing.length * bearing.viscosity
    scale = 0.5 * bearing.diameter * bearing.clearance**3
    squared = 2.25 * number * (flow / scale) ** 2 / (bearing.density * difference)
    return squared * (1.0 + math.sqrt(1.0 + 2.0 / squared))


def _thesis_feed(bearing: _Bearing) -> _Feed:
    parameter = _feed_parameter(bearing, bearing.orifices)
    supply, ambient = bearing.supply_pressure**2, bearing.ambient_pressure**2
    return _Feed(math.sqrt(ambient + parameter / (1.0 + parameter) * (supply - ambient)), parameter)


def _liquid_feed(bearing: _Bearing) -> _Feed:
    parameter = _feed_parameter(bearing, bearing.orifices**2)
    difference = bearing.supply_pressure - bearing.ambient_pressure
    return _Feed(bearing.ambient_pressure + parameter / (1.0 + parameter) * difference, 0.5 * parameter)


def _nozzle_feed(bearing: _Bearing) -> _Feed:
    """Return the pressure at which film and nozzles have the same flow."""
    supply, ambient = bearing.supply_pressure, bearing.ambient_pressure
    area = bearing.orifices * bearing.discharge_coefficient * math.pi * bearing.orifice_radius**2
    capacity = area * supply * math.sqrt(bearing.density / ambient)

    exponent = HEAT_CAPACITY_RATIO / (HEAT_CAPACITY_RATIO - 1.0)

    def excess(head: float) -> float:
        pressure = supply * (1.0 - head) ** exponent
        return capacity * nozzle_function(head) - _film_flow(bearing, pressure, compressible=True)

    greatest = velocity_head(ambient / supply)
    head = float(brentq(excess, 0.0, greatest, xtol=1e-300, rtol=1e-13, maxiter=2000))
    pressure = supply * (1.0 - head) ** exponent
    if head >= CRITICAL_HEAD:
        return _Feed(pressure, 0.0)
    logarithmic_slope = 1.0 / HEAT_CAPACITY_RATIO - (1.0 - head) / (2.0 * exponent * head)
    return _Feed(pressure, -logarithmic_slope * (pressure**2 - ambient**2) / (2.0 * pressure**2))


def velocity_head(pressure_ratio: float) -> float:
    """Return the share of the enthalpy that an ideal nozzle turns into velocity.

    ``pressure_ratio``: pressure behind the nozzle over pressure before it.
    """
    return float(1.0 - pressure_ratio ** ((HEAT_CAPACITY_RATIO - 1.0) / HEAT_CAPACITY_RATIO))


def nozzle_function(head: float) -> float:
    """Return the mass flow of an ideal nozzle, times the root of gas constant and temperature, over area and pressure.

    ``head``: velocity head; the flow stays the same above the critical one.
    """
    exponent = HEAT_CAPACITY_RATIO / (HEAT_CAPACITY_RATIO - 1.0)
    head = min(head, CRITICAL_HEAD)
    return float((1.0 - head) ** (exponent / HEAT_CAPACITY_RATIO) * math.sqrt(2.0 * exponent * head))


def _gas_load(bearing: _Bearing, feed: _Feed) -> float:
    """Return the load over the eccentricity ratio, equation 6.21; each factor stays finite for every length."""
    aspect = bearing.length / bearing.diameter
    ambient = bearing.ambient_pressure
    y_squared = aspect * ambient**2 / (feed.pressure**2 - ambient**2)
    near, far = math.sqrt(y_squared), math.sqrt(y_squared + aspect)
    decay = math.exp(-aspect)
    growing = dawsn(far) - decay * dawsn(near)
    falling = 0.5 * math.sqrt(math.pi) * decay * (erfcx(near) - decay * erfcx(far))
    area = bearing.length * bearing.diameter
    return float(0.75 * math.pi * area * ambient * (growing - falling) / (_resistance(aspect, feed) * near))


def _liquid_load(bearing: _Bearing, feed: _Feed) -> float:
    """Return the load over the eccentricity ratio; equation 6.21 with the pressure in place of its square."""
    aspect = bearing.length / bearing.diameter
    difference = feed.pressure - bearing.ambient_pressure
    rise = 0.5 * math.expm1(-aspect) ** 2
    return 1.5 * math.pi * bearing.diameter**2 * difference * rise / _resistance(aspect, feed)


def _resistance(aspect: float, feed: _Feed) -> float:
    """Return the denominator of equation 6.21, times the exponential of minus the aspect."""
    decay = math.exp(-2.0 * aspect)
    return 0.5 * (aspect * (1.0 + decay) + feed.yielding * (1.0 - decay))
