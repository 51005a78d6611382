"""Spacing of the light sources on a ring such that the readings contradict wrong indices of the two lit sources.

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

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import FloatArray

DIODE_ANGLE = 2.0 * math.pi / 3.0  # from the first diode of a coded ring to the second [rad]
_GROWTHS = (0.12, 0.135, 0.15, 0.165, 0.18)
_OFFSETS = tuple(0.05 * step for step in range(21))
_LIT_PITCHES = 1.2
"""Largest difference between the angle of two lit sources and that of the diodes, in the largest pitch."""
_SAME_SLIP_WEIGHT = 0.5
"""Weight of the margin against equal slips: it is to be twice the margin against all wrong pairs."""


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
