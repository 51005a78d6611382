"""Three POSORs as one would build them, with the uncertainties one would reach.

For accuracy runs, budgets and simulation. Sizes follow the thesis' design (probes at 1.5 and 3 in, table 5.2; sensors
of 5 microinch); everything else is assumed here and labelled so in the provenance.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from posor_estimator.core.calibration.model import Calibration, calibration_from

DesignName = Literal["triad_diodes", "triad_light_ring", "triad_bumpy_ring"]

DIODE_SPAN = 5.5e-3
"""Half the width of the diodes' calibrated surface [m], a little less than the map's corners reach."""
THETA_OF_TWO_SOURCES = 0.1
"""Largest theta [rad] at which two fixed sources stay on their diodes, with a runout of 1 mm."""
SOURCES = 36
BUMPS = 36

_GAP_OF_VOLT = [0.735e-3, -0.118e-3, 1.5e-6, -2e-7, 1e-8]


def _quantity(value: object, unit: str, sigma: object = 0.0) -> dict[str, object]:
    return {"value": value, "sigma": sigma, "unit": unit}


def _probe(name: str, tip: list[float], axis: list[float]) -> dict[str, object]:
    return {
        "name": name,
        "tip": _quantity(tip, "m", [20e-6, 20e-6, 1e-6]),
        "axis": _quantity(axis, "1", [1e-3 if abs(component) < 0.5 else 0.0 for component in axis]),  # noqa: PLR2004
        "volts_to_gap": _quantity(_GAP_OF_VOLT, "m/V^k", [0.13e-6, 5e-8, 5e-9, 0.0, 0.0]),
        "zero_shift": _quantity(0.0, "V", 5e-4),
        "noise": _quantity(1e-3, "V"),
        "range": _quantity([-6.0, 6.0], "V"),
        "supply": {"sensitivity": _quantity(2e-5, "m/V", 2e-6), "reference": _quantity(15.0, "V", 0.01)},
        "temperature": {"sensitivity": _quantity(2e-7, "m/K", 2e-8), "reference": _quantity(293.15, "K", 0.1)},
    }


def _triad() -> dict[str, object]:
    tips = ([-0.0762, 0.0, 0.0], [0.0, 0.0381, 0.0], [0.0, -0.0381, 0.0])
    return {
        "type": "gap_probes",
        "target_plane": {
            "point": _quantity([0.0, 0.0, 0.0], "m"),
            "tilt": _quantity([8e-4, -1.1e-3], "rad", 20e-6),
        },
        "probes": [_probe(f"gap_{i + 1}", tip, [0.0, 0.0, 1.0]) for i, tip in enumerate(tips)],
    }


def _spot_map() -> dict[str, object]:
    # x = s (u + .05 u^3 + .03 u v^2), y likewise, in Chebyshev functions: u^3 = (3 T1 + T3) / 4, v^2 = (1 + T2) / 2.
    scale = 6e-3
    x = np.zeros((4, 4))
    x[1, 0], x[3, 0], x[1, 2] = 1.0 + 0.0375 + 0.015, 0.0125, 0.015
    sigma = np.zeros((4, 4))
    sigma[0, 0], sigma[1, 0], sigma[0, 1] = 0.5e-6, 0.5e-6, 0.5e-6
    return {
        "kind": "chebyshev",
        "domain": _quantity([[-0.9, 0.9], [-0.9, 0.9]], "1"),
        "x": _quantity((scale * x).tolist(), "m", sigma.tolist()),
        "y": _quantity((scale * x.T).tolist(), "m", sigma.tolist()),
    }


def _diodes(places: list[tuple[float, float]], sources: list[tuple[float, float]]) -> dict[str, object]:
    skew = 2e-3  # the y axes are this far from square to the x axes [rad]
    diodes = [
        {
            "name": f"diode_{i + 1}",
            "origin": _quantity([x, y, -2e-3], "m", [5e-6, 5e-6, 20e-6]),
            "x_axis": _quantity([1.0, 0.0, 0.0], "1", [0.0, 2e-4, 1e-3]),
            "y_axis": _quantity([-math.sin(skew), math.cos(skew), 0.0], "1", [2e-4, 0.0, 1e-3]),
            "noise": _quantity([1e-4, 1e-4], "1"),
            "minimum_sum": _quantity(2e-5, "A"),
            "maximum_sum": _quantity(1.5e-4, "A"),
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
                "origin": _quantity([x, y, 0.4e-3], "m", [3e-6, 3e-6, 20e-6]),
                "direction": _quantity(direction, "1", [5e-4, 5e-4, 0.0]),
            }
        )
    return {
        "type": "diodes",
        "diodes": diodes,
        "light_sources": lights,
        "map": "factory",
        "maps": {"factory": [_spot_map() for _ in places]},
    }


def _two_diodes() -> dict[str, object]:
    places = [(-0.0254, 0.0381), (-0.0254, -0.0381)]
    return _diodes(places, places)


def _light_ring() -> dict[str, object]:
    radius = 0.044
    around = [2.0 * math.pi * i / SOURCES for i in range(SOURCES)]
    opposite = [(radius * math.sqrt(0.5),) * 2, (-radius * math.sqrt(0.5),) * 2]
    return _diodes(opposite, [(radius * math.cos(phi), radius * math.sin(phi)) for phi in around])


def _bumpy_ring(probes: int) -> dict[str, object]:
    tip_radius = 0.0516
    bump = 2.0 * math.pi / BUMPS
    if probes == 4:  # noqa: PLR2004  opposite probes in phase, the two pairs in quadrature
        azimuths = [0.0, 0.5 * math.pi + 0.25 * bump, math.pi, 1.5 * math.pi + 0.25 * bump]
    else:  # evenly around, a fraction of a bump apart, as the source draws three
        azimuths = [2.0 * math.pi * i / probes + bump * i / probes for i in range(probes)]
    orders = [1, 2, BUMPS, 2 * BUMPS, 3 * BUMPS]
    return {
        "type": "bumpy_ring",
        "ring": {
            "bumps": BUMPS,
            "mean_radius": _quantity(0.0508, "m", 1e-6),
            "orders": orders,
            "cos": _quantity([-4e-6, 0.0, 1.6e-4, 2e-7, 9e-6], "m", [0.2e-6] * len(orders)),
            "sin": _quantity([0.0, -5e-6, 0.0, -4e-6, 0.0], "m", [0.2e-6] * len(orders)),
        },
        "home": _quantity(0.0, "rad"),
        "probes": [
            _probe(
                f"ring_{i + 1}",
                [tip_radius * math.cos(phi), tip_radius * math.sin(phi), 5e-3],
                [-math.cos(phi), -math.sin(phi), 0.0],
            )
            for i, phi in enumerate(azimuths)
        ],
    }


def design(name: DesignName, *, ring_probes: int = 4, motion: bool = False) -> Calibration:
    """Return the calibration of one of the designs.

    Args:
        name: Which stack.
        ring_probes: Number of probes of a bumpy ring, three or more.
        motion: Whether the calibration limits how fast the target moves: 1 mm/s, 0.02 rad/s of lean, 3 rad/s of theta.

    """
    sensors: list[dict[str, Any]] = [_triad()]
    if name == "triad_diodes":
        sensors.append(_two_diodes())
    elif name == "triad_light_ring":
        sensors.append(_light_ring())
    else:
        sensors.append(_bumpy_ring(ring_probes))
    limits = {
        "translation": _quantity(1e-3, "m/s"),
        "lean": _quantity(0.02, "rad/s"),
        "theta": _quantity(3.0, "rad/s"),
    }
    return calibration_from(
        {
            "format": "posor_calibration",
            "version": 1,
            "name": name,
            "provenance": {"source": "assumed design", "method": "core/designs.py", "date": "none"},
            "frames": {"parent": "receiving", "child": "target"},
            "motion": limits if motion else None,
            "sensors": sensors,
        }
    )
