# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Builders of the designs' sensors as content of a calibration file: gap probes, diodes with light sources, rings.

Coded rings have a spacing of the light sources such that the readings contradict wrong indices of the two lit sources.
Two diodes see two sources. Of the four coordinates of the spots, x, y and theta explain three; the distance of the
spots is redundant and can contradict a wrong index. With evenly spaced sources it does not: if both indices are one too
high, the spots fit a theta that is wrong by one pitch. Here the pitch grows steadily around the ring,

    phi_i = 2 pi (u + c u (u - 1)),  u = (i + offset) / N,

from 1 - c to 1 + c times the mean, so that each pair of sources that can be lit has a distance of its own. The diodes
are 120 degrees apart: between opposite diodes the distance hardly depends on the angle between the sources, and half a
turn would exchange the two sources and leave it unchanged.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from pydantic.dataclasses import dataclass

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import FloatArray

Part = dict[str, object]

DIODE_ANGLE = 2.0 * math.pi / 3.0  # from the first diode of a coded ring to the second [rad]
_GROWTHS = (0.12, 0.135, 0.15, 0.165, 0.18)
_OFFSETS = tuple(0.05 * step for step in range(21))
_LIT_PITCHES = 1.2
"""Largest difference between the angle of two lit sources and that of the diodes, in the largest pitch."""
_SAME_SLIP_WEIGHT = 0.5
"""Weight of the margin against equal slips: it is to be twice the margin against all wrong pairs."""
TARGET_TILT = (8e-4, -1.1e-3)
"""Deliberate tilt of the target plane about X and Y of T [rad]: its run-out with theta shows exchanged gap probes."""
CHORD_MIDDLE = -0.25 * math.pi  # azimuth in the middle between the two diodes of a coded ring [rad]


@dataclass(frozen=True)
class ProbeKind:
    """Values and standard uncertainties (sigma) that all probes of a design share."""

    volts_to_gap: tuple[float, ...]  # coefficients A_k [m/V^k]
    volts_to_gap_sigmas: tuple[float, ...]
    noise: float  # of one averaged voltage [V]
    tip_sigma: tuple[float, float, float]  # along X, Y, Z of R [m]
    axis_sigma: float  # across the axis [rad]
    zero_shift_sigma: float  # [V]
    supply_sigma: float  # of the supply voltage of the linearisation [V]


@dataclass(frozen=True)
class DiodeKind:
    """Standard uncertainties (sigma) of diodes, maps and light sources of a design."""

    noise: float  # standard deviation of the averaged ratios
    origin_sigma: tuple[float, float, float]  # origin of a diode along X, Y, Z of R [m]
    axis_sigma: tuple[float, float]  # axes of a diode, in the plane of R and out of it [rad]
    map_sigma: float  # lowest coefficients of a map [m]
    source_sigma: tuple[float, float, float]  # origin of a source along X, Y, Z of T [m]
    direction_sigma: float  # direction of a ray [rad]
    lean: float = 2e-3  # of the rays from the normal of the plate [rad], a value
    scale: float = 6e-3  # slope of the map in its middle [m], a value; the calibrated half width is 0.95 of it


@dataclass(frozen=True)
class RingShape:
    """A bumpy ring: ``r(phi) = mean_radius + sum_k (cos_k cos(k phi) + sin_k sin(k phi))``."""

    bumps: int
    mean_radius: float  # [m]
    cos: tuple[float, ...]  # amplitudes of the orders 1, 2, bumps, 2 bumps, 3 bumps [m]
    sin: tuple[float, ...]
    radius_sigma: float  # standard uncertainty of the mean radius [m]
    amplitude_sigma: float  # and of each amplitude [m]
    tip_radius: float  # of the probe tips [m]


def quantity_entry(value: object, unit: str, sigma: object = 0.0) -> Part:
    """Return a quantity of a calibration file."""
    return {"value": value, "sigma": sigma, "unit": unit}


def probe(name: str, kind: ProbeKind, tip: Sequence[float], axis: Sequence[float]) -> Part:
    """Return one probe; ``tip`` in R [m], ``axis`` in R, unit, close to an axis of R."""
    across = [kind.axis_sigma if abs(component) < 0.5 else 0.0 for component in axis]  # noqa: PLR2004
    return {
        "name": name,
        "tip": quantity_entry(list(tip), "m", list(kind.tip_sigma)),
        "axis": quantity_entry(list(axis), "1", across),
        "volts_to_gap": quantity_entry(list(kind.volts_to_gap), "m/V^k", list(kind.volts_to_gap_sigmas)),
        "zero_shift": quantity_entry(0.0, "V", kind.zero_shift_sigma),
        "noise": quantity_entry(kind.noise, "V"),
        "range": quantity_entry([-6.0, 6.0], "V"),
        "supply": {
            "sensitivity": quantity_entry(2e-5, "m/V", 2e-6),
            "reference": quantity_entry(15.0, "V", kind.supply_sigma),
        },
        "temperature": {
            "sensitivity": quantity_entry(2e-7, "m/K", 2e-8),
            "reference": quantity_entry(293.15, "K", 0.1),
        },
    }


def reference_voltage() -> Part:
    """Return a known voltage of the probes' converter: a reference of 2 ppm, read with the noise of 10 ppm."""
    return {
        "voltage": quantity_entry(5.0, "V", 1e-5),
        "noise": quantity_entry(5e-5, "V"),
        "limit": quantity_entry(0.02, "1"),
        "spread": quantity_entry(1e-3, "1"),
    }


def ambient_light() -> Part:
    """Return how ambient light is removed from diode currents by dark scans."""
    return {
        "noise": quantity_entry(1e-9, "A"),
        "drift": quantity_entry(1e-9, "A/s^0.5"),
        "max_age": quantity_entry(30.0, "s"),
        "remaining": quantity_entry(1e-4, "1"),
    }


def gap_probes(
    kind: ProbeKind, tips: Sequence[Sequence[float]], tilt_sigma: float, target_tilt: tuple[float, float] = TARGET_TILT
) -> Part:
    """Return probes along Z of R and their target plane, with its tilt and the uncertainty of the tilt [rad]."""
    return {
        "type": "gap_probes",
        "target_plane": {
            "point": quantity_entry([0.0, 0.0, 0.0], "m"),
            "tilt": quantity_entry(list(target_tilt), "rad", tilt_sigma),
        },
        "probes": [probe(f"gap_{i + 1}", kind, tip, [0.0, 0.0, 1.0]) for i, tip in enumerate(tips)],
    }


def _spot_map(scale: float, sigma_of_map: float) -> Part:
    # x = s (u + .05 u^3 + .03 u v^2), y likewise, in Chebyshev functions: u^3 = (3 T1 + T3) / 4, v^2 = (1 + T2) / 2.
    x = np.zeros((4, 4))
    x[1, 0], x[3, 0], x[1, 2] = 1.0 + 0.0375 + 0.015, 0.0125, 0.015
    sigma = np.zeros((4, 4))
    sigma[0, 0], sigma[1, 0], sigma[0, 1] = (sigma_of_map,) * 3
    return {
        "kind": "chebyshev",
        "domain": quantity_entry([[-0.9, 0.9], [-0.9, 0.9]], "1"),
        "x": quantity_entry((scale * x).tolist(), "m", sigma.tolist()),
        "y": quantity_entry((scale * x.T).tolist(), "m", sigma.tolist()),
    }


def diodes(kind: DiodeKind, positions: Sequence[tuple[float, float]], sources: Sequence[tuple[float, float]]) -> Part:
    """Return diodes at ``positions`` in R and light sources at ``sources`` in T [m], x and y each."""
    skew = 2e-3  # error of squareness of the axes [rad]
    in_plane, out_of_plane = kind.axis_sigma
    entries = [
        {
            "name": f"diode_{i + 1}",
            "origin": quantity_entry([x, y, -2e-3], "m", list(kind.origin_sigma)),
            "x_axis": quantity_entry([1.0, 0.0, 0.0], "1", [0.0, in_plane, out_of_plane]),
            "y_axis": quantity_entry([-math.sin(skew), math.cos(skew), 0.0], "1", [in_plane, 0.0, out_of_plane]),
            "noise": quantity_entry([kind.noise, kind.noise], "1"),
            "minimum_sum": quantity_entry(2e-5, "A"),
            "maximum_sum": quantity_entry(1.5e-4, "A"),
        }
        for i, (x, y) in enumerate(positions)
    ]
    lights = []
    for i, (x, y) in enumerate(sources):
        lean = np.array([kind.lean * math.cos(2.4 * i), kind.lean * math.sin(2.4 * i), -1.0])
        direction = (lean / np.linalg.norm(lean)).tolist()
        lights.append(
            {
                "name": f"source_{i + 1}",
                "origin": quantity_entry([x, y, 0.4e-3], "m", list(kind.source_sigma)),
                "direction": quantity_entry(direction, "1", [kind.direction_sigma, kind.direction_sigma, 0.0]),
            }
        )
    return {
        "type": "diodes",
        "diodes": entries,
        "light_sources": lights,
        "map": "factory",
        "maps": {"factory": [_spot_map(kind.scale, kind.map_sigma) for _ in positions]},
    }


def light_ring(kind: DiodeKind, radius: float, sources: int, count: int = 2) -> Part:
    """Return a coded ring of light sources of a radius [m], and its diodes (``coded_azimuths``, ``coded_places``).

    ``kind``: uncertainties of the parts. ``radius``: of the ring and of the places of the diodes [m]. ``sources``:
    number of sources. ``count``: number of diodes, two or three.
    """

    def on_ring(azimuths: Sequence[float]) -> list[tuple[float, float]]:
        return [(radius * math.cos(phi), radius * math.sin(phi)) for phi in azimuths]

    return diodes(kind, on_ring(coded_places(count)), on_ring(coded_azimuths(sources)))


@lru_cache
def coded_azimuths(sources: int) -> tuple[float, ...]:
    """Return the azimuths of the sources of a coded ring [rad], ascending: those of the best growth and offset."""
    candidates = [_azimuths(sources, growth, offset) for growth in _GROWTHS for offset in _OFFSETS]
    return max(candidates, key=lambda azimuths: min(np.multiply(slip_margins(azimuths), (_SAME_SLIP_WEIGHT, 1.0))))


def _azimuths(sources: int, growth: float, offset: float) -> tuple[float, ...]:
    part = (np.arange(sources) + offset) / sources
    return tuple((2.0 * math.pi * (part + growth * part * (part - 1.0))).tolist())


def slip_margins(azimuths: Sequence[float]) -> tuple[float, float]:
    """Return by how much the angle of two sources that can be lit differs at least from that of a wrong pair [rad].

    ``azimuths``: of the sources [rad], ascending within one turn. The first result is for wrong pairs that slipped by
    the same number of sources on both diodes, the second for all wrong pairs.
    """
    around = np.asarray(azimuths)
    count = len(around)
    second = np.add.outer(np.arange(1, count), np.arange(count)) % count
    angles = np.mod(around[second] - around, 2.0 * math.pi)  # row s: from source i to source i + s
    pitch = angles[0].max()
    return _smallest_difference(angles, pitch), _smallest_difference(angles[angles < math.pi][None], pitch)


def _smallest_difference(angles: FloatArray, pitch: float) -> float:
    """Return the smallest difference of two angles of a row of which at least one can be lit."""
    ordered = np.sort(angles, axis=1)
    lit = np.abs(ordered - DIODE_ANGLE) < _LIT_PITCHES * pitch
    differences = np.diff(ordered, axis=1)[lit[:, 1:] | lit[:, :-1]]
    return float(differences.min()) if differences.size else math.inf


def coded_places(count: int) -> tuple[float, ...]:
    """Return the azimuths of the diodes of a coded ring [rad], two or three.

    The line from the first diode to the second is at 45 degrees to their axes: all four coordinates are checked alike.
    """
    return tuple(CHORD_MIDDLE + (i - 0.5) * DIODE_ANGLE for i in range(count))


def ring_azimuths(bumps: int, probes: int) -> list[float]:
    """Return the azimuths of the probes of a bumpy ring [rad]: evenly spaced, moved to well-spread phases of the bumps.

    A multiple of four probes: opposite ones in phase, the pairs spread over half a bump. Any other number n: probe i
    has the phase i k / n, k half of n rounded down. With k = 1, five or more probes would see theta as a displacement.
    The phases hold for every number of bumps: a probe is moved to the nearest one of its phase.
    """
    bump, half = 2.0 * math.pi / bumps, probes // 2
    phases = [i % half / probes if probes % 4 == 0 else i * ((probes - 1) // 2) / probes % 1.0 for i in range(probes)]
    return [
        2.0 * math.pi * i / probes + bump * (phase + round(bumps * i / probes) - bumps * i / probes)
        for i, phase in enumerate(phases)
    ]


def bumpy_ring(kind: ProbeKind, shape: RingShape, probes: int) -> Part:
    """Return a bumpy ring and its probes, three or more (``ring_azimuths``)."""
    azimuths = ring_azimuths(shape.bumps, probes)
    orders = [1, 2, shape.bumps, 2 * shape.bumps, 3 * shape.bumps]
    sigmas = [shape.amplitude_sigma] * len(orders)
    return {
        "type": "bumpy_ring",
        "ring": {
            "bumps": shape.bumps,
            "mean_radius": quantity_entry(shape.mean_radius, "m", shape.radius_sigma),
            "orders": orders,
            "cos": quantity_entry(list(shape.cos), "m", sigmas),
            "sin": quantity_entry(list(shape.sin), "m", sigmas),
        },
        "home": quantity_entry(0.0, "rad"),
        "probes": [
            probe(
                f"ring_{i + 1}",
                kind,
                [shape.tip_radius * math.cos(phi), shape.tip_radius * math.sin(phi), 5e-3],
                [-math.cos(phi), -math.sin(phi), 0.0],
            )
            for i, phi in enumerate(azimuths)
        ],
    }
