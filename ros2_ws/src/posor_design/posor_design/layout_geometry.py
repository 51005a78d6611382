# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Arrange the sensors of a POSOR between its inside and outside diameter, for a range of motion.

Seen along the axis, the parts are discs (gap probes, diodes) and bars (the probes of a bumpy ring) that must not
overlap. Light sources and bumps pass around with the target: the gap probes stay clear of their whole circle. All sizes
of parts are assumed; they are those of common probes and diodes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.calibration.design_parts import coded_places, ring_azimuths
from posor.calibration.designs import STANDOFF

from posor_design.posor_layout import BUMP_SLOPE, NOMINAL_RANGE, PosorLayout, ThetaSensor, gap_azimuths

if TYPE_CHECKING:
    from posor_design.requirement import Requirement

EDGE = 2e-3  # material between a part and the inside or outside diameter [m]
PROBE_RADIUS, PROBE_LENGTH = 4e-3, 12e-3  # of a probe's body [m]
DIODE_FRAME = 1.5e-3  # around the calibrated surface of a diode [m]
SOURCE_RADIUS, SMALLEST_SOURCE_PITCH = 1.5e-3, 3e-3
"""Of a light source in the target plate, and from source to source [m]."""
HALF_WIDTHS = (2.5e-3, 10e-3)  # of the calibrated surface of a diode [m]
BUMP_PITCHES = (2e-3, 8e-3)
RING_WALL = 3e-3  # of a bumpy ring [m]
PROBE_RANGES = (0.25, 3.0)  # least and greatest range of a probe, see ``PosorLayout.probe_range``
MOST_SOURCES = 240
LARGEST_GROWTH = 1.18  # largest pitch of a coded ring over its mean (``coded_azimuths``)
RAY_LENGTH = 3e-3  # from a light source to its diode, beside the gap [m]
RING_PLANE = 5e-3  # height of the ring probes above the receiving plate [m]
COUNTED = 0.25  # largest motion of the ring from scan to scan, in bumps: half a bump is ambiguous
FIXED_SOURCES_TURN = 0.5  # largest theta that fixed light sources are tried for [rad]
LEAST_RADIUS = 0.25  # smallest share of the largest possible ring radius that is tried
_DIAGONAL = math.sqrt(2.0)
_FOUR = 4


@dataclass(frozen=True)
class LayoutKind:
    """The discrete choices: the sensor for theta and its number of probes, the gap probes, which ring is outside."""

    theta_sensor: ThetaSensor
    theta_probes: int
    gap_probes: int
    gap_outside: bool

    @property
    def name(self) -> str:
        """Name for tables: ``4 gap probes outside, light ring with 3 diodes``."""
        place = "outside" if self.gap_outside else "inside"
        parts = "probes" if self.theta_sensor == "bumpy_ring" else "diodes"
        sensor = "fixed light sources" if self.theta_sensor == "diodes" else self.theta_sensor.replace("_", " ")
        return f"{self.gap_probes} gap probes {place}, {sensor} with {self.theta_probes} {parts}"


def layout_kinds(requirement: Requirement) -> list[LayoutKind]:
    """Return all combinations of the discrete choices that suit the rotation."""
    sensors: list[tuple[ThetaSensor, int]] = [
        ("light_ring", 2),
        ("light_ring", 3),
        ("bumpy_ring", 4),
        ("bumpy_ring", 5),
        ("bumpy_ring", 8),
    ]
    if requirement.rotation <= FIXED_SOURCES_TURN:
        sensors += [("diodes", 2), ("diodes", 3)]
    return [
        LayoutKind(sensor, count, gaps, outside)
        for sensor, count in sensors
        for gaps in (4, 3)
        for outside in (True, False)
    ]


@dataclass(frozen=True)
class Shares:
    """The continuous choices, each a share of what is possible: radius of the ring, and size of its parts, 0 to 1."""

    radius: float = 1.0
    size: float = 0.3


def arrange(requirement: Requirement, kind: LayoutKind, diameter: float, shares: Shares) -> PosorLayout | None:
    """Return the layout of a kind within an outside diameter [m], with the largest circle of gap probes.

    Returns the layout, of noise 1; None: the parts do not fit, or no probe has the range.
    """
    builder = _bumpy_ring if kind.theta_sensor == "bumpy_ring" else _diodes
    return builder(requirement, kind, diameter, shares)


def _tilt_reach(requirement: Requirement) -> float:
    """Return the largest slope of the target plane in any direction."""
    return _DIAGONAL * math.tan(requirement.range.tilt.number) + requirement.target_tilt.number


def _gap_range(requirement: Requirement, circle: float) -> float:
    """Return the range that gap probes on a circle need."""
    motion = requirement.range.gap.number + _tilt_reach(requirement) * (circle + requirement.range.runout.number)
    return max(PROBE_RANGES[0], motion / NOMINAL_RANGE)


def _largest_circle(requirement: Requirement) -> float:
    """Return the largest circle on which the probe of the greatest range measures all tilts."""
    left = PROBE_RANGES[1] * NOMINAL_RANGE - requirement.range.gap.number
    return left / _tilt_reach(requirement) - requirement.range.runout.number


def _outer_circle(requirement: Requirement, diameter: float) -> float:
    """Return the circle of gap probes at the rim."""
    return min(0.5 * diameter - EDGE - PROBE_RADIUS, _largest_circle(requirement))


def _circle_fits(requirement: Requirement, circle: float) -> bool:
    return circle >= max(0.5 * requirement.inside_diameter.number + EDGE, 0.0) + PROBE_RADIUS


def _at(radius: float, azimuth: float) -> complex:
    return complex(radius * math.cos(azimuth), radius * math.sin(azimuth))


def _interpolate(limits: tuple[float, float], share: float) -> float:
    low, high = limits
    return low * math.pow(high / low, share)


def _diodes(requirement: Requirement, kind: LayoutKind, diameter: float, shares: Shares) -> PosorLayout | None:
    inside, outside = 0.5 * requirement.inside_diameter.number, 0.5 * diameter
    runout = requirement.range.runout.number
    spot_motion = runout + math.tan(requirement.range.tilt.number) * (RAY_LENGTH + requirement.range.gap.number)
    fixed = kind.theta_sensor == "diodes"
    least = spot_motion + (0.0 if fixed else 0.5 * LARGEST_GROWTH * SMALLEST_SOURCE_PITCH)
    limits = (max(HALF_WIDTHS[0], least), HALF_WIDTHS[1])
    if limits[0] > limits[1]:
        return None
    half_width = _interpolate(limits, shares.size)
    frame = _DIAGONAL * (half_width + DIODE_FRAME)
    circle = _outer_circle(requirement, diameter)
    clear = PROBE_RADIUS + SOURCE_RADIUS + runout
    ring = outside - EDGE - frame
    if kind.gap_outside:
        ring = min(ring, circle - clear)
    if fixed:  # the spots must stay on the diodes at all angles
        ring = min(ring, (half_width - spot_motion) / (2.0 * math.sin(0.5 * requirement.rotation)))
    ring *= LEAST_RADIUS + (1.0 - LEAST_RADIUS) * shares.radius
    if not kind.gap_outside:
        circle = min(circle, ring - clear)
    marks = kind.theta_probes
    if not fixed:
        pitch = 2.0 * (half_width - spot_motion) / LARGEST_GROWTH
        marks = 4 * math.ceil(2.0 * math.pi * ring / pitch / 4.0)
    layout = _layout(requirement, kind, diameter, circle, ring, half_width, marks)
    spread = 2.0 * ring * math.sin(math.pi / 3.0)  # from diode to diode
    bodies = [abs(_at(circle, a) - _at(ring, b)) for a in layout.gap_azimuths for b in layout.diode_azimuths]
    fits = (
        ring - frame >= inside + EDGE
        and _circle_fits(requirement, circle)
        and min(bodies) >= PROBE_RADIUS + frame
        and spread >= 2.0 * frame
        and kind.theta_probes <= marks <= MOST_SOURCES
    )
    return layout if fits else None


def _bumpy_ring(requirement: Requirement, kind: LayoutKind, diameter: float, shares: Shares) -> PosorLayout | None:
    inside, outside = 0.5 * requirement.inside_diameter.number, 0.5 * diameter
    runout = requirement.range.runout.number
    pitch = _interpolate(BUMP_PITCHES, shares.size)
    motion = BUMP_SLOPE * pitch * 1.05 + _DIAGONAL * runout + math.tan(requirement.range.tilt.number) * RING_PLANE
    ring_range = max(PROBE_RANGES[0], motion / NOMINAL_RANGE)
    standoff = ring_range * STANDOFF
    circle = _outer_circle(requirement, diameter)
    clear = PROBE_RADIUS + standoff
    ring = outside - EDGE - PROBE_LENGTH - standoff
    if kind.gap_outside:
        ring = min(ring, circle - clear)
    ring *= LEAST_RADIUS + (1.0 - LEAST_RADIUS) * shares.radius
    if not kind.gap_outside:
        circle = min(circle, ring - RING_WALL - clear)
    bumps = kind.theta_probes * round(2.0 * math.pi * max(ring, 0.0) / pitch / kind.theta_probes)
    if ring_range > PROBE_RANGES[1] or bumps < _FOUR * _FOUR or ring - RING_WALL < inside + EDGE:
        return None
    layout = _layout(requirement, kind, diameter, circle, ring, 2.0 * math.pi * ring / bumps, bumps, ring_range)
    step = requirement.speed.number / requirement.scan_rate.number * bumps / (2.0 * math.pi)
    neighbours = 2.0 * (ring + standoff) * math.sin(math.pi / kind.theta_probes)
    fits = (
        _circle_fits(requirement, circle)
        and step <= COUNTED
        and neighbours >= 2.0 * PROBE_RADIUS
        and (not kind.gap_outside or _probes_clear(layout, ring + standoff))
    )
    return layout if fits else None


def _probes_clear(layout: PosorLayout, tips: float) -> bool:
    """Return whether gap probes stand clear of ring probes that begin at a radius."""
    radii = np.linspace(tips, tips + PROBE_LENGTH, 7)
    distances = [
        abs(_at(layout.probe_circle, a) - _at(float(radius), b))
        for a in layout.gap_azimuths
        for b in ring_azimuths(layout.marks, layout.theta_probes)
        for radius in radii
    ]
    return min(distances) >= 2.0 * PROBE_RADIUS


def _layout(
    requirement: Requirement,
    kind: LayoutKind,
    diameter: float,
    circle: float,
    ring: float,
    size: float,
    marks: int,
    ring_range: float = 1.0,
) -> PosorLayout:
    obstacles = () if kind.theta_sensor == "bumpy_ring" else coded_places(kind.theta_probes)
    return PosorLayout(
        theta_sensor=kind.theta_sensor,
        theta_probes=kind.theta_probes,
        gap_azimuths=gap_azimuths(kind.gap_probes, obstacles),
        outside_diameter=diameter,
        probe_circle=circle,
        probe_range=_gap_range(requirement, max(circle, 0.0)),
        ring_radius=ring,
        ring_size=size,
        ring_range=ring_range,
        marks=marks,
        noise=1.0,
    )
