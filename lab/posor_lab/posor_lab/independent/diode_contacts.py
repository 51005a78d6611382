# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contact currents of a lateral effect diode: the ratios at which its calibrated map gives a spot.

The ratios are (A - C) / (A + C) along x and (B - D) / (B + D) along y. The maps are described in the reference of the
calibration file; this module evaluates them with numpy's polynomials, and inverts them by Newton's method.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial import chebyshev, polynomial
from numpy.typing import NDArray

from posor_lab.independent.file_values import si_values

FloatArray = NDArray[np.float64]

_STEPS = 40
_CONVERGED = 1e-13  # of a scaled ratio


class TensorMap:
    """A map by two tables, of powers or of Chebyshev polynomials."""

    def __init__(self, entry: dict[str, Any], errors: FloatArray) -> None:
        """Read a map of the file; ``errors``: real value minus that of the file, of x and y row by row."""
        self.domain = si_values(entry["domain"], "1")
        low, high = self.domain.T
        derivative: Any
        self._value: Any
        if entry["kind"] == "polynomial":
            self._value, derivative = polynomial.polyval2d, polynomial.polyder
            self._center, self._scale = si_values(entry["center"], "1"), np.ones(2)
        else:
            self._value, derivative = chebyshev.chebval2d, chebyshev.chebder
            self._center, self._scale = 0.5 * (low + high), 0.5 * (high - low)
        tables = np.array([si_values(entry[axis], "m") for axis in "xy"])
        tables += errors[: tables.size].reshape(tables.shape)
        slopes = np.zeros((2, *tables.shape))
        slopes[0, :, :-1], slopes[1, :, :, :-1] = (derivative(tables, axis=axis) for axis in (1, 2))
        # x and y, then their derivatives by both scaled ratios, along the last axis.
        self._tables = np.moveaxis(np.concatenate([tables, *slopes]), 0, 2)
        self._limits = (self.domain.T - self._center) / self._scale

    def positions(self, ratios: FloatArray) -> FloatArray:
        """Return spots [m] at ratios, (n, 2) each."""
        return np.asarray(self._value(*((ratios - self._center) / self._scale).T, self._tables)[:2].T)

    def ratios(self, spots: FloatArray) -> FloatArray:
        """Return the ratios of spots [m], (n, 2) each; the result may lie outside the domain."""
        low, high = self._limits
        scaled = np.tile(0.5 * (low + high), (len(spots), 1))
        for _ in range(_STEPS):
            x, y, x_u, y_u, x_v, y_v = self._value(*scaled.T, self._tables)
            e, f = spots[:, 0] - x, spots[:, 1] - y
            step = np.column_stack([y_v * e - x_v * f, x_u * f - y_u * e]) / (x_u * y_v - x_v * y_u)[:, None]
            scaled = np.minimum(np.maximum(scaled + step, 2.0 * low - high), 2.0 * high - low)
            if not np.any(np.abs(step) > _CONVERGED):
                break
        return np.asarray(self._center + self._scale * scaled)


class CurvesMap:
    """The map of 1985: x by polynomials of its ratio on lines of constant y, weighted linearly between; y alike."""

    def __init__(self, entry: dict[str, Any], errors: FloatArray) -> None:
        """Read a map of the file; ``errors`` of the curves of x and y and of the lines' positions, in this order."""
        self.domain = si_values(entry["domain"], "1")
        curves = np.array([si_values(entry[key], "m") for key in ("x_curves", "y_curves")])
        at = np.array([si_values(entry[key], "m") for key in ("x_curves_at", "y_curves_at")])
        self._curves = curves + errors[: curves.size].reshape(curves.shape)
        self._at = at + errors[curves.size : curves.size + at.size].reshape(at.shape)

    def positions(self, ratios: FloatArray) -> FloatArray:
        """Return spots [m] at ratios, (n, 2) each; each coordinate selects the curves of the other."""
        spots = np.tile(np.mean(self._at, axis=1)[::-1], (len(ratios), 1))
        for _ in range(_STEPS):
            for axis in (0, 1):
                spots[:, axis] = _polyval_each(self._between(axis, spots[:, 1 - axis]), ratios[:, axis])
        return spots

    def ratios(self, spots: FloatArray) -> FloatArray:
        """Return the ratios of spots [m], (n, 2) each: with both coordinates known, each is a polynomial of its own."""
        found = np.tile(np.mean(self.domain, axis=1), (len(spots), 1))
        for axis in (0, 1):
            coefficients = self._between(axis, spots[:, 1 - axis])
            slopes = coefficients[:, 1:] * np.arange(1, coefficients.shape[1])
            for _ in range(_STEPS):
                misses = spots[:, axis] - _polyval_each(coefficients, found[:, axis])
                found[:, axis] += misses / _polyval_each(slopes, found[:, axis])
        return found

    def _between(self, axis: int, positions: FloatArray) -> FloatArray:
        """Return the coefficients at positions (n,) between lines, (n, order); the outermost curves go on outside."""
        curves, at = self._curves[axis], self._at[axis]
        i = np.clip(np.searchsorted(at, positions) - 1, 0, len(at) - 2)
        weight = ((positions - at[i]) / (at[i + 1] - at[i]))[:, None]
        return np.asarray((1.0 - weight) * curves[i] + weight * curves[i + 1])


def _polyval_each(coefficients: FloatArray, x: FloatArray) -> FloatArray:
    """Return a polynomial of its own (n, order) at each x, (n,)."""
    return np.asarray(np.einsum("nk,nk->n", coefficients, x[:, None] ** np.arange(coefficients.shape[1])))


def read_map(entry: dict[str, Any], errors: FloatArray) -> TensorMap | CurvesMap:
    """Return a map of the file with errors, in the order of its parameters; surplus errors are ignored."""
    return CurvesMap(entry, errors) if entry["kind"] == "curves" else TensorMap(entry, errors)


def contact_currents(ratios: FloatArray, domain: FloatArray, sums: tuple[float, float]) -> FloatArray:
    """Return the currents of the contacts A, B, C, D [A], (n, 4); NaN where a ratio is outside the domain.

    ``sums``: least and greatest sum of two opposite contacts [A]; the light is in the middle between them, or twice the
    least if there is no greatest.
    """
    least, greatest = sums
    total = 0.5 * (least + greatest) if np.isfinite(greatest) else 2.0 * least
    inside = np.all((ratios >= domain[:, 0]) & (ratios <= domain[:, 1]), axis=1)
    ratios = np.where(inside[:, None], ratios, np.nan)
    return np.column_stack([0.5 * total * (1.0 + ratios), 0.5 * total * (1.0 - ratios)])
