# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of ISO 9283:1998 from attained and commanded points: accuracy and repeatability of poses, distances, paths.

Points are x, y, z [m] and a, b, c [rad], the turn from the commanded orientation as a rotation vector in the base.
So the commanded a, b, c are zero. Where no orientation is known, a, b, c are NaN, and so are their figures.
The symbols are those of the standard, with the component as a suffix: ``AP_p``, ``AP_x``, ``RP_l``, ``RT_a``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.numerics.array_types import FloatArray

COMPONENTS = "xyzabc"
LEAST_CYCLES = 2  # for a standard deviation
POSE_CYCLES, PATH_CYCLES = 30, 10  # that the standard asks for (table 7)

Figures = dict[str, float]


def pose_figures(attained: FloatArray, commanded: FloatArray) -> Figures:
    """Return accuracy AP and repeatability RP of a pose (7.2.1, 7.2.2).

    ``attained``: points of n cycles, (n, 6). ``commanded``: (6,).
    """
    deviation = attained.mean(axis=0) - commanded
    return {
        "AP_p": float(np.linalg.norm(deviation[:3])),
        **_by_component("AP", deviation),
        "RP_l": float(_repeatability(attained[None, :, :3])[0]),
        **_by_component("RP", 3.0 * attained.std(axis=0, ddof=1), COMPONENTS[3:]),
    }


def distance_figures(first: FloatArray, second: FloatArray, commanded: FloatArray) -> Figures:
    """Return accuracy AD and repeatability RD of the distance of two poses (7.3.2, 7.3.3).

    ``first``, ``second``: positions of n cycles, (n, 3). ``commanded``: both commanded positions, (2, 3).
    """
    apart, wanted = first - second, commanded[0] - commanded[1]
    lengths = np.column_stack([np.linalg.norm(apart, axis=1), np.abs(apart)])
    accuracy = lengths.mean(axis=0) - [np.linalg.norm(wanted), *np.abs(wanted)]
    repeatability = 3.0 * lengths.std(axis=0, ddof=1)
    names = ("", "_x", "_y", "_z")
    return {
        f"{symbol}{name}": float(number)
        for symbol, numbers in (("AD", accuracy), ("RD", repeatability))
        for name, number in zip(names, numbers, strict=True)
    }


def path_figures(attained: FloatArray, commanded: FloatArray) -> Figures:
    """Return accuracy AT and repeatability RT of a path (8.2, 8.3).

    ``attained``: where each of n cycles crosses the plane across the path at each of m points, (m, n, 6).
    ``commanded``: the points, (m, 6).
    """
    deviations = attained.mean(axis=1) - commanded
    spreads = 3.0 * attained.std(axis=1, ddof=1)
    return {
        "AT_p": float(np.linalg.norm(deviations[:, :3], axis=1).max()),
        **_by_component("AT", np.abs(deviations).max(axis=0), COMPONENTS[3:]),
        "RT_p": float(_repeatability(attained[:, :, :3]).max()),
        **_by_component("RT", spreads.max(axis=0), COMPONENTS[3:]),
    }


def _repeatability(positions: FloatArray) -> FloatArray:
    """Return mean distance from the barycentre and three standard deviations of it, (m,), of positions (m, n, 3)."""
    distances = np.linalg.norm(positions - positions.mean(axis=1, keepdims=True), axis=2)
    return np.asarray(distances.mean(axis=1) + 3.0 * distances.std(axis=1, ddof=1))


def _by_component(symbol: str, numbers: FloatArray, names: str = COMPONENTS) -> Figures:
    by_name: Mapping[str, float] = dict(zip(COMPONENTS, map(float, numbers), strict=True))
    return {f"{symbol}_{name}": by_name[name] for name in names}
