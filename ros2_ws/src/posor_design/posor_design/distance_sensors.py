# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Response of distance sensors without contact: fibre optic lever, capacitance probe, area and linearity of a probe."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from posor.errors import ParameterError
from scipy.constants import epsilon_0
from scipy.optimize import brentq
from scipy.special import j1

from posor_design.calculators import ACUTE_ANGLE, NON_NEGATIVE, POSITIVE, SHARE, at_least, calculator, require_as_many
from posor_design.line_fit import fit_line

_LARGEST_GAP = 0.2
"""Of a disc without guard, over its radius: Kirchhoff's formula is then 1 % too low (test with Love's equation)."""
_LARGEST_CURVATURE = 0.2
"""Radius of a probe over that of the target: the series is then exact to 1e-4 of its first term."""


@dataclass(frozen=True)
class FibreLever:
    """Response of a fibre optic lever."""

    illuminated_radius: Annotated[float, "m", "Radius of the reflected light in the plane of the fibre ends."]
    collected: Annotated[float, "1", "Received power over transmitted power."]
    slope: Annotated[float, "1/m", "Derivative of ``collected`` with respect to the distance."]
    dead_distance: Annotated[float, "m", "Distance below which no light reaches the receiving fibres."]
    peak_distance: Annotated[float, "m", "Distance of the largest received power: the response rises, then falls."]
    peak_collected: Annotated[float, "1", "Largest received power over transmitted power."]


@calculator
def fibre_lever(
    distance: Annotated[float, "m", NON_NEGATIVE, "Distance of the target."],
    core_radius: Annotated[float, "m", POSITIVE, "Radius of the core of each fibre."],
    spacing: Annotated[float, "m", "Distance between the axes of the transmitting and a receiving fibre."],
    half_angle: Annotated[float, "rad", ACUTE_ANGLE, "Half angle of the light cone, arcsine of numerical aperture."],
    receivers: Annotated[int, POSITIVE, "Number of receiving fibres."] = 6,
    reflectivity: Annotated[float, "1", SHARE, "Reflectivity of the target."] = 1.0,
) -> FibreLever:
    """Response of a fibre optic lever: one transmitting fibre with receiving fibres around it.

    The target is a mirror, level with the fibre ends. The light fills its cone evenly, so that a receiving fibre gets
    the share of the illuminated circle that its core covers.

    Source: thesis 4.2.1 (the geometry, after Cook and Hamm, Applied Optics 18(19), 3230-3241, 1979); the equations
        follow from the area that two circles share.
    """
    room = 2.0 if receivers == 1 else max(2.0, 1.0 / math.sin(math.pi / receivers))
    if spacing < room * core_radius * (1.0 - 1e-9):
        expected = f"at least {room * core_radius:g} m, where the cores touch"
        raise ParameterError(f"{spacing:g} m", where="spacing", expected=expected)
    growth = 2.0 * math.tan(half_angle)

    def collect(radius: float) -> tuple[float, float]:
        """Return the received share at a radius of the light, and its derivative with respect to the radius."""
        area, arc = _shared_area(radius, core_radius, spacing)
        scale = receivers * reflectivity / math.pi
        return scale * area / radius**2, scale * (arc / radius**2 - 2.0 * area / radius**3)

    radius = core_radius + growth * distance
    collected, by_radius = collect(radius)
    near, far = spacing - core_radius, spacing + core_radius
    peak = float(brentq(lambda r: collect(r)[1], near + 1e-3 * core_radius, far, xtol=1e-12 * far))
    return FibreLever(
        illuminated_radius=radius,
        collected=collected,
        slope=growth * by_radius,
        dead_distance=(near - core_radius) / growth,
        peak_distance=(peak - core_radius) / growth,
        peak_collected=collect(peak)[0],
    )


def _shared_area(radius: float, other_radius: float, spacing: float) -> tuple[float, float]:
    """Return the area that two circles share, and the arc of the first within the second (its derivative by radius)."""
    if radius <= spacing - other_radius:
        return 0.0, 0.0
    if radius >= spacing + other_radius:
        return math.pi * other_radius**2, 0.0
    angle = math.acos((spacing**2 + radius**2 - other_radius**2) / (2.0 * spacing * radius))
    other_angle = math.acos((spacing**2 + other_radius**2 - radius**2) / (2.0 * spacing * other_radius))
    kite = spacing * radius * math.sin(angle)
    return radius**2 * angle + other_radius**2 * other_angle - kite, 2.0 * radius * angle


@dataclass(frozen=True)
class CapacitanceProbe:
    """Response of a capacitance probe."""

    capacitance: Annotated[float, "F", "Capacitance between probe and level target."]
    slope: Annotated[float, "F/m", "Derivative of the capacitance with respect to the gap."]
    resolution: Annotated[float, "m", "Change of the gap that the resolution of the capacitance is worth."]
    tilt_error: Annotated[float, "m", "Gap read less gap at the axis, because the target is tilted."]
    permittivity_error: Annotated[float, "m", "Gap read less gap, because the permittivity has changed."]


@calculator
def capacitance_probe(
    gap: Annotated[float, "m", POSITIVE, "Distance of the target at the axis of the probe."],
    radius: Annotated[float, "m", POSITIVE, "Radius of the disc; with a guard, to the middle of the slit."],
    capacitance_resolution: Annotated[float, "F", NON_NEGATIVE, "Change of the capacitance that is resolved."] = 0.0,
    tilt: Annotated[float, "rad", "Angle between target and disc; its error is that of an even field."] = 0.0,
    permittivity: Annotated[float, "1", POSITIVE, "Relative permittivity of the medium; default: air."] = 1.0006,
    permittivity_change: Annotated[float, "1", "Change of the relative permittivity since the calibration."] = 0.0,
    edge: Annotated[Literal["guarded", "free"], "Guarded: even field up to the edge; free: stray field."] = "guarded",
) -> CapacitanceProbe:
    """Response of a capacitance probe, a disc in front of a conducting plane.

    Source: thesis 4.2.2 (capacitance as the inverse of the gap). Stray field: Kirchhoff's formula for two discs, in
        Landau and Lifshitz, Electrodynamics of Continuous Media, section 3, with the image of the disc in the plane.
        Tilt: integral of the inverse gap over the disc.
    """
    if permittivity + permittivity_change <= 0.0:
        expected = f"more than {-permittivity:g}, so that a permittivity remains"
        raise ParameterError(f"{permittivity_change:g}", where="permittivity_change", expected=expected)
    rise = radius * math.tan(abs(tilt))
    if abs(tilt) >= 0.5 * math.pi or rise >= gap:
        expected = f"less than {math.atan(gap / radius):g} rad, where the edge touches the target"
        raise ParameterError(f"{tilt:g} rad", where="tilt", expected=expected)
    if edge == "free" and gap > _LARGEST_GAP * radius:
        expected = f"at most {_LARGEST_GAP * radius:g} m, a fifth of the radius, for a free disc"
        raise ParameterError(f"{gap:g} m", where="gap", expected=expected)
    absolute = permittivity * epsilon_0
    capacitance = absolute * math.pi * radius**2 / gap
    slope = -capacitance / gap
    if edge == "free":
        capacitance += 2.0 * absolute * radius * (math.log(8.0 * math.pi * radius / gap) - 1.0)
        slope -= 2.0 * absolute * radius / gap
    read_at = capacitance * (1.0 + permittivity_change / permittivity)
    return CapacitanceProbe(
        capacitance=capacitance,
        slope=slope,
        resolution=capacitance_resolution / -slope,
        tilt_error=-0.5 * rise**2 / (gap + math.sqrt(gap**2 - rise**2)),
        permittivity_error=(read_at - capacitance) / slope,
    )


@dataclass(frozen=True)
class ProbeArea:
    """Effect of the area over which a probe averages."""

    curvature_error: Annotated[float, "m", "Mean gap less gap at the axis, before a convex cylinder."]
    amplitude_ratio: Annotated[float, "1", "Amplitude of the target's waves that the probe shows, over theirs."]


@calculator
def probe_area(
    radius: Annotated[float, "m", POSITIVE, "Radius of the disc over which the probe averages."],
    target_radius: Annotated[float, "m", POSITIVE, "Radius of the cylinder."],
    wavelength: Annotated[float, "m", POSITIVE, "Length of the waves of the target."],
) -> ProbeArea:
    """Effect of the area of a probe on the gap before a cylinder, and on the bumps of a ring.

    The probe shows the mean gap over a disc. Waves shorter than its diameter nearly vanish in this mean.

    Source: mean of the height of a circle, and of a wave, over a disc; J1: Bessel function, NIST DLMF 10.9.
    """
    share = radius / target_radius
    if share > _LARGEST_CURVATURE:
        expected = f"at most {_LARGEST_CURVATURE * target_radius:g} m, a fifth of the radius of the target"
        raise ParameterError(f"{radius:g} m", where="radius", expected=expected)
    phase = math.tau * radius / wavelength
    return ProbeArea(
        curvature_error=radius * share / 8.0 * (1.0 + share**2 / 8.0), amplitude_ratio=2.0 * float(j1(phase)) / phase
    )


@dataclass(frozen=True)
class Linearity:
    """Deviation of a sensor from a straight line."""

    sensitivity: Annotated[float, "m/V", "Displacement over reading of the least squares line."]
    deviation: Annotated[float, "m", "Standard deviation of the displacements from this line."]
    largest_deviation: Annotated[float, "m", "Largest deviation from this line."]
    linearity: Annotated[float, "m", "Half width of the narrowest band with all displacements, along the displacement."]
    relative_linearity: Annotated[float, "1", "Linearity over the range of the displacements."]


@calculator
def linearity(
    readings: Annotated[tuple[float, ...], "V", at_least(3), "Readings of the sensor."],
    displacements: Annotated[tuple[float, ...], "m", "Displacement of the target at each reading."],
) -> Linearity:
    """Linearity of a sensor: deviations of displacements from a straight line over the readings.

    Source: thesis 4.4 and 7.5.1 (linearisation); narrowest band: ISA S37.1, independent linearity.
    """
    require_as_many("readings", readings=readings, displacements=displacements)
    line = fit_line(readings, displacements, "readings")
    span = max(displacements) - min(displacements)
    if span == 0.0:
        raise ParameterError("all values are equal", where="displacements", expected="different values")
    half = 0.5 * line.band
    return Linearity(line.slope, line.standard_deviation, line.largest_residual, half, half / span)
