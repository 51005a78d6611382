# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Distance from a probe to the surface in front of it, averaged over the probe's area.

A capacitive probe measures the mean of 1 / distance over its area, along lines parallel to its axis. The calibration
file describes each probe by its axis alone. On a plane that leans by the angle phi the reading is smaller than the
distance along the axis by (radius phi)^2 / (4 distance): for the radius assumed here 0.2 nm at 1 mrad and 0.3 mm, 62 nm
at 10 mrad and 0.1 mm. On a ring the profile is as the probe sees it, because it is calibrated by these probes;
only the lean along the ring's axis is averaged.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]

AREA_RADIUS = 0.5e-3
"""Assumed radius of the sensitive area of a probe [m]."""
_HEXAGON = AREA_RADIUS / np.sqrt(2.0) * np.exp(1j * np.pi / 3.0 * np.arange(6))
"""Points of the area with the mean square of its coordinates; exact for surfaces up to the third degree."""
_STEPS = 30
_CONVERGED_M = 1e-13
_SAMPLES_PER_WAVE = 32


def to_target(rotations: FloatArray, translations: FloatArray, points: FloatArray) -> FloatArray:
    """Return points (k, 3) of the receiving plate in the target plate at its poses (n, 3, 3), (n, 3), (n, k, 3)."""
    return np.asarray((points[None, :, :] - translations[:, None, :]) @ rotations)


def _perpendiculars(axes: FloatArray, to_this: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Return two directions across each axis (..., 3), the first in the plane of the axis and ``to_this``."""
    start = np.eye(3)[np.argmin(np.abs(axes), axis=-1)] if to_this is None else np.broadcast_to(to_this, axes.shape)
    along = np.sum(start * axes, axis=-1, keepdims=True) / np.sum(axes * axes, axis=-1, keepdims=True)
    first = start - along * axes
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(axes, first)
    return first, second / np.linalg.norm(second, axis=-1, keepdims=True)


class ProbedPlane:
    """A plane of the target plate and the probes that look at it."""

    def __init__(self, tips: FloatArray, axes: FloatArray, point: FloatArray, tilt: FloatArray) -> None:
        """Place probes and plane.

        ``tips`` [m], ``axes``: (p, 3), in the receiving plate; ``point``: of the plane [m], (3,), ``tilt``: its turns
        about X and then about the new Y [rad], (2,), which bring the direction -Z onto the plane's normal, all in the
        target plate.
        """
        first, second = _perpendiculars(axes)
        self._starts = tips + _HEXAGON.real[:, None, None] * first + _HEXAGON.imag[:, None, None] * second
        self._axes, self._point = axes, point
        self._normal = Rotation.from_euler("XY", tilt).apply([0.0, 0.0, -1.0])

    def distances(self, rotations: FloatArray, translations: FloatArray) -> FloatArray:
        """Return the readings (n, p) [m] of the probes at poses of the target plate, (n, 3, 3), (n, 3) [m]."""
        normals = rotations @ self._normal
        places = np.sum(normals * (rotations @ self._point + translations), axis=1)
        heights = places[:, None, None] - np.einsum("nk,qpk->nqp", normals, self._starts)
        distances = heights / (normals @ self._axes.T)[:, None, :]
        return np.asarray(1.0 / np.mean(1.0 / distances, axis=1))


class RingProfile:
    """Radius of a ring by azimuth, from a table of its profile."""

    def __init__(self, mean_radius: float, orders: FloatArray, cosines: FloatArray, sines: FloatArray) -> None:
        """Tabulate ``r(phi)`` [m] from its harmonics."""
        count = _SAMPLES_PER_WAVE * int(np.max(orders))
        spectrum = np.zeros(count // 2 + 1, dtype=complex)
        spectrum[0] = mean_radius * count
        spectrum[orders.astype(int)] = 0.5 * count * (cosines - 1j * sines)
        rates = 1j * np.arange(len(spectrum)) * spectrum
        azimuths = 2.0 * np.pi * np.arange(count + 1) / count
        radii, slopes = (np.pad(np.fft.irfft(each, count), (0, 1), mode="wrap") for each in (spectrum, rates))
        self.mean_radius = mean_radius
        self._radius = CubicHermiteSpline(azimuths, radii, slopes, extrapolate="periodic")
        self._slope = self._radius.derivative()

    def distances(self, starts: FloatArray, axes: FloatArray) -> FloatArray:
        """Return the distances [m] from points along directions (..., 3) to the ring, in its own frame.

        NaN where a line misses the ring.
        """
        x, y = starts[..., 0], starts[..., 1]
        u, v = axes[..., 0], axes[..., 1]
        # From the mean circle on, by Newton's method for the gap of radius and profile along the line.
        a, b, c = u * u + v * v, x * u + y * v, x * x + y * y - self.mean_radius**2
        with np.errstate(invalid="ignore"):
            along = (-b - np.sqrt(b * b - a * c)) / a
        change = np.full_like(along, np.inf)
        for _ in range(_STEPS):
            px, py = x + along * u, y + along * v
            azimuth, distance = np.arctan2(py, px), np.hypot(px, py)
            # Azimuth and radius change along the line by these rates.
            turning, growing = (px * v - py * u) / distance**2, (px * u + py * v) / distance
            change = (distance - self._radius(azimuth)) / (growing - self._slope(azimuth) * turning)
            along = along - change
            if not np.any(np.abs(change) > _CONVERGED_M):
                break
        return np.where(np.abs(change) <= _CONVERGED_M, along, np.nan)


def ring_distances(
    rotations: FloatArray, translations: FloatArray, tips: FloatArray, axes: FloatArray, profile: RingProfile
) -> FloatArray:
    """Return the readings (n, p) [m] of probes at a ring of the target plate; tips and axes (p, 3) as above."""
    starts = to_target(rotations, translations, tips)
    directions = axes[None, :, :] @ rotations
    along_ring, _ = _perpendiculars(directions, np.array([0.0, 0.0, 1.0]))
    shifts = np.array([-0.5, 0.5])[:, None, None, None] * AREA_RADIUS * along_ring
    distances = profile.distances(starts + shifts, np.broadcast_to(directions, shifts.shape))
    return np.asarray(1.0 / np.mean(1.0 / distances, axis=0))
