"""The formulas of TWIS and GEN, listings of appendix 8A: from gaps and light spots to the end of the measuring beam.

Inch and rad, as in the listings. All results are increments against step 1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_lab.thesis_budgets.motion_predictions import dimensions

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.numerics.array_types import FloatArray

Z_LEVER = 36.1
"""Lever of theta for z [inch], as the listing of GEN shows it; the text of 8.4 has 33.4 in for both levers."""
X1, Y1, X2, Y2 = range(4)
"""Columns of the light spots."""


class EndOfBeamProgram:
    """The evaluation of 1985, for many draws at once.

    Attributes:
        sizes: Dimensions of the POSOR and of the tests by name (inch, rad).

    """

    def __init__(self, sizes: Mapping[str, float] | None = None) -> None:
        """Take the dimensions; None: those of the listings."""
        self.sizes = dimensions() if sizes is None else sizes

    def attitude(self, gaps: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return alpha and beta [rad] of gaps (..., 3), listing ALBET."""
        a, b, c = (self.sizes[name] for name in "abc")
        one, two, three = np.moveaxis(gaps, -1, 0)
        return np.arctan((two - three) / (a + b)), np.arctan((one - (two * b + three * a) / (a + b)) / c)

    def distance(self, gaps: FloatArray, x: FloatArray | float, y: FloatArray | float) -> FloatArray:
        """Return the distance between the plates at a point, listing DIST."""
        alpha, beta = self.attitude(gaps)
        return np.asarray(gaps[..., 2] + (self.sizes["b"] + y) * np.tan(alpha) - x * np.tan(beta))

    def plate_distances(self, gaps: FloatArray, spots: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the distances between the plates at the spots of diodes 1 and 2."""
        h = self.sizes["h_diodes"]
        one = self.distance(gaps, h - spots[..., X1], self.sizes["g1"] - spots[..., Y1])
        two = self.distance(gaps, h - spots[..., X2], self.sizes["g2"] - spots[..., Y2])
        return one, two

    def flatness(self, theta: FloatArray) -> FloatArray:
        """Return the terms that are added to the gaps at a theta, shape (..., 3)."""
        d1, d23 = self.sizes["flatness_D1"], self.sizes["flatness_D2_D3_listing"]
        return np.asarray(np.sin(theta)[..., None] * np.array([d1, d23, -d23]))

    def ray_shifts(self, changes: tuple[FloatArray, FloatArray], theta: FloatArray) -> FloatArray:
        """Return what leaning rays add to the spots when the plate distances change, shape (..., 4)."""
        one = changes[0] * self.sizes["sigma1"]
        two = changes[1] * self.sizes["sigma2"]
        spin1, spin2 = self.sizes["rho1"] + theta, self.sizes["rho2_listing"] + theta
        return np.stack([one * np.cos(spin1), -one * np.sin(spin1), two * np.cos(spin2), two * np.sin(spin2)], axis=-1)

    def heading(self, spots: FloatArray, alpha: FloatArray | float = 0.0, beta: FloatArray | float = 0.0) -> FloatArray:
        """Return the direction from spot 2 to spot 1 [rad]; theta is its change."""
        along_y = (spots[..., Y1] - spots[..., Y2] - self.sizes["dYsep"]) * np.cos(alpha)
        along_x = (spots[..., X1] - spots[..., X2] - self.sizes["dXsep"]) * np.cos(beta)
        return np.asarray(np.arctan(along_y / along_x))

    def evaluate(self, gaps: FloatArray, spots: FloatArray) -> FloatArray:
        """Return alpha, z and y at each step, shape (draws, n, 3).

        Args:
            gaps: Linearised readings of the probes, shape (draws, n, 3).
            spots: Linearised X1, Y1, X2, Y2 of the light spots, shape (draws, n, 4).

        """
        alpha0, beta0 = self.attitude(gaps[:, 0])
        lengths0 = self.plate_distances(gaps[:, 0], spots[:, 0])
        distance0, heading0 = self.distance(gaps[:, 0], 0.0, 0.0), self.heading(spots[:, 0])
        middle0 = -(spots[:, 0, Y1] + spots[:, 0, Y2]) / 2.0
        results = np.zeros((*gaps.shape[:2], 3))
        theta = np.zeros(len(gaps))
        for n in range(1, gaps.shape[1]):
            level = gaps[:, n] + self.flatness(theta)  # theta of the previous step
            alpha, beta = (angle - start for angle, start in zip(self.attitude(level), (alpha0, beta0), strict=True))
            lengths = self.plate_distances(level, spots[:, n])
            changes = lengths[0] - lengths0[0], lengths[1] - lengths0[1]
            corrected = spots[:, n] + self.ray_shifts(changes, theta)
            theta = self.heading(corrected, alpha, beta) - heading0
            middle = -(corrected[:, Y1] + corrected[:, Y2]) / 2.0
            results[:, n, 0] = alpha
            results[:, n, 1] = middle - middle0 - Z_LEVER * theta
            results[:, n, 2] = self.sizes["lever_endpoint"] * beta - (self.distance(level, 0.0, 0.0) - distance0)
        return results
