# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Light spots: rays of the sources traced to the diodes' planes, and the sources that are lit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class DiodePlane:
    """The plane of a diode with its own axes x and y, which need not be at right angles; in the receiving plate."""

    def __init__(self, origin: FloatArray, x_axis: FloatArray, y_axis: FloatArray) -> None:
        """Place a diode: origin [m] and axes, (3,) each."""
        self._origin, self._normal = origin, np.cross(x_axis, y_axis)
        self._to_axes = np.linalg.pinv(np.column_stack([x_axis, y_axis])).T

    def hits(self, rotations: FloatArray, translations: FloatArray, starts: FloatArray, rays: FloatArray) -> FloatArray:
        """Return where the rays of s sources meet the plane, along its axes [m], (n, s, 2).

        ``rotations``, ``translations``: poses of the target plate, (n, 3, 3), (n, 3) [m]; ``starts`` [m] and ``rays``,
        (s, 3): origins and directions in the target plate.
        """
        turns = np.swapaxes(rotations, 1, 2)
        places, directions = starts @ turns + translations[:, None, :], rays @ turns
        lengths = (self._origin - places) @ self._normal / (directions @ self._normal)
        return np.asarray((places + lengths[..., None] * directions - self._origin) @ self._to_axes)


def nearest_sources(spots: FloatArray, middle: FloatArray) -> NDArray[np.int64]:
    """Return the source whose spot (n, s, 2) is nearest to the middle (2,) of the diode, (n,)."""
    return np.asarray(np.argmin(np.sum(np.square(spots - middle), axis=2), axis=1), dtype=np.int64)
