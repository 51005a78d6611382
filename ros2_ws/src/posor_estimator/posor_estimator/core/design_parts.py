"""Sensors of the designs, as parts of a calibration file: triad, diodes with light sources, bumpy ring."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

Part = dict[str, object]

INCH = 0.0254

_OPPOSITE_PAIRS = 4


@dataclass(frozen=True)
class ProbeKind:
    """What all probes of one kind share.

    Attributes:
        volts_to_gap: Coefficients A_k [m/V^k].
        volts_to_gap_sigmas: Their standard uncertainties.
        noise: Of one averaged voltage [V].
        tip_sigma: Standard uncertainty of the tip's place along X, Y, Z of R [m].
        axis_sigma: Of the axis across its own direction [rad].
        zero_shift_sigma: [V].
        supply_sigma: Of the supply voltage at which the probe was linearised [V].

    """

    volts_to_gap: tuple[float, ...]
    volts_to_gap_sigmas: tuple[float, ...]
    noise: float
    tip_sigma: tuple[float, float, float]
    axis_sigma: float
    zero_shift_sigma: float
    supply_sigma: float


@dataclass(frozen=True)
class DiodeKind:
    """Standard uncertainties of what is calibrated of diodes, maps and light sources, and the ratios' noise.

    Attributes:
        noise: Standard deviation of the averaged ratios.
        origin_sigma: Diode's origin along X, Y, Z of R [m].
        axis_sigma: Diode's axes across their own direction, in the plane of R and out of it [rad].
        map_sigma: Lowest coefficients of a map [m].
        source_sigma: Source's origin along X, Y, Z of T [m].
        direction_sigma: Ray's direction [rad].

    """

    noise: float
    origin_sigma: tuple[float, float, float]
    axis_sigma: tuple[float, float]
    map_sigma: float
    source_sigma: tuple[float, float, float]
    direction_sigma: float


@dataclass(frozen=True)
class RingShape:
    """A bumpy ring: ``r(phi) = mean_radius + sum_k (cos_k cos(k phi) + sin_k sin(k phi))``.

    Attributes:
        bumps: Number of bumps.
        mean_radius: [m].
        cos: Amplitudes [m] of the orders 1, 2, bumps, 2 bumps, 3 bumps.
        sin: The same.
        radius_sigma: Standard uncertainty of ``mean_radius`` [m].
        amplitude_sigma: Of each amplitude [m].
        tip_radius: Where the tips of the probes are [m].

    """

    bumps: int
    mean_radius: float
    cos: tuple[float, ...]
    sin: tuple[float, ...]
    radius_sigma: float
    amplitude_sigma: float
    tip_radius: float


def quantity(value: object, unit: str, sigma: object = 0.0) -> Part:
    """Return a quantity of a calibration file."""
    return {"value": value, "sigma": sigma, "unit": unit}


def probe(name: str, kind: ProbeKind, tip: Sequence[float], axis: Sequence[float]) -> Part:
    """Return one probe; ``tip`` in R [m], ``axis`` in R, unit, close to an axis of R."""
    across = [kind.axis_sigma if abs(component) < 0.5 else 0.0 for component in axis]  # noqa: PLR2004
    return {
        "name": name,
        "tip": quantity(list(tip), "m", list(kind.tip_sigma)),
        "axis": quantity(list(axis), "1", across),
        "volts_to_gap": quantity(list(kind.volts_to_gap), "m/V^k", list(kind.volts_to_gap_sigmas)),
        "zero_shift": quantity(0.0, "V", kind.zero_shift_sigma),
        "noise": quantity(kind.noise, "V"),
        "range": quantity([-6.0, 6.0], "V"),
        "supply": {"sensitivity": quantity(2e-5, "m/V", 2e-6), "reference": quantity(15.0, "V", kind.supply_sigma)},
        "temperature": {"sensitivity": quantity(2e-7, "m/K", 2e-8), "reference": quantity(293.15, "K", 0.1)},
    }


def triad(kind: ProbeKind, tips: Sequence[Sequence[float]], tilt_sigma: float) -> Part:
    """Return three probes along Z of R and the plane that they look at; ``tilt_sigma`` [rad] is that of its lean."""
    return {
        "type": "gap_probes",
        "target_plane": {
            "point": quantity([0.0, 0.0, 0.0], "m"),
            "tilt": quantity([8e-4, -1.1e-3], "rad", tilt_sigma),
        },
        "probes": [probe(f"gap_{i + 1}", kind, tip, [0.0, 0.0, 1.0]) for i, tip in enumerate(tips)],
    }


def _spot_map(sigma_of_map: float) -> Part:
    # x = s (u + .05 u^3 + .03 u v^2), y likewise, in Chebyshev functions: u^3 = (3 T1 + T3) / 4, v^2 = (1 + T2) / 2.
    scale = 6e-3
    x = np.zeros((4, 4))
    x[1, 0], x[3, 0], x[1, 2] = 1.0 + 0.0375 + 0.015, 0.0125, 0.015
    sigma = np.zeros((4, 4))
    sigma[0, 0], sigma[1, 0], sigma[0, 1] = (sigma_of_map,) * 3
    return {
        "kind": "chebyshev",
        "domain": quantity([[-0.9, 0.9], [-0.9, 0.9]], "1"),
        "x": quantity((scale * x).tolist(), "m", sigma.tolist()),
        "y": quantity((scale * x.T).tolist(), "m", sigma.tolist()),
    }


def diodes(kind: DiodeKind, places: Sequence[tuple[float, float]], sources: Sequence[tuple[float, float]]) -> Part:
    """Return diodes at ``places`` in R and light sources at ``sources`` in T [m], x and y each."""
    skew = 2e-3  # the y axes are this far from square to the x axes [rad]
    in_plane, out_of_plane = kind.axis_sigma
    made = [
        {
            "name": f"diode_{i + 1}",
            "origin": quantity([x, y, -2e-3], "m", list(kind.origin_sigma)),
            "x_axis": quantity([1.0, 0.0, 0.0], "1", [0.0, in_plane, out_of_plane]),
            "y_axis": quantity([-math.sin(skew), math.cos(skew), 0.0], "1", [in_plane, 0.0, out_of_plane]),
            "noise": quantity([kind.noise, kind.noise], "1"),
            "minimum_sum": quantity(2e-5, "A"),
            "maximum_sum": quantity(1.5e-4, "A"),
        }
        for i, (x, y) in enumerate(places)
    ]
    lights = []
    for i, (x, y) in enumerate(sources):
        lean = np.array([2e-3 * math.cos(2.4 * i), 2e-3 * math.sin(2.4 * i), -1.0])
        direction = (lean / np.linalg.norm(lean)).tolist()
        lights.append(
            {
                "name": f"source_{i + 1}",
                "origin": quantity([x, y, 0.4e-3], "m", list(kind.source_sigma)),
                "direction": quantity(direction, "1", [kind.direction_sigma, kind.direction_sigma, 0.0]),
            }
        )
    return {
        "type": "diodes",
        "diodes": made,
        "light_sources": lights,
        "map": "factory",
        "maps": {"factory": [_spot_map(kind.map_sigma) for _ in places]},
    }


def light_ring(kind: DiodeKind, radius: float, sources: int) -> Part:
    """Return a ring of light sources of a radius [m] that two diodes opposite to one another look at."""
    around = [2.0 * math.pi * i / sources for i in range(sources)]
    opposite = [(radius * math.sqrt(0.5),) * 2, (-radius * math.sqrt(0.5),) * 2]
    return diodes(kind, opposite, [(radius * math.cos(phi), radius * math.sin(phi)) for phi in around])


def bumpy_ring(kind: ProbeKind, shape: RingShape, probes: int) -> Part:
    """Return a bumpy ring and its probes, three or more."""
    bump = 2.0 * math.pi / shape.bumps
    if probes == _OPPOSITE_PAIRS:  # opposite probes in phase, the two pairs in quadrature
        azimuths = [0.0, 0.5 * math.pi + 0.25 * bump, math.pi, 1.5 * math.pi + 0.25 * bump]
    else:  # evenly around, a fraction of a bump apart, as the source draws three
        azimuths = [2.0 * math.pi * i / probes + bump * i / probes for i in range(probes)]
    orders = [1, 2, shape.bumps, 2 * shape.bumps, 3 * shape.bumps]
    sigmas = [shape.amplitude_sigma] * len(orders)
    return {
        "type": "bumpy_ring",
        "ring": {
            "bumps": shape.bumps,
            "mean_radius": quantity(shape.mean_radius, "m", shape.radius_sigma),
            "orders": orders,
            "cos": quantity(list(shape.cos), "m", sigmas),
            "sin": quantity(list(shape.sin), "m", sigmas),
        },
        "home": quantity(0.0, "rad"),
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
