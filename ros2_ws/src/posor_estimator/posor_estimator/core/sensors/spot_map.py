"""From the ratios of a lateral effect diode's contact currents to the light spot's position on the diode.

The ratios are ``(A - C)/(A + C)`` along x and ``(B - D)/(B + D)`` along y. A map is a pair of two-dimensional
polynomials in the ratios' distance from a centre: ``x = sum_ij X_ij u^i v^j``, ``y`` likewise, valid in a box.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Self

import numpy as np
from numpy.polynomial import polynomial
from pydantic import model_validator

from posor_estimator.core.calibration.quantity import ANY, FrozenModel, Quantity, measured

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray


class SpotMapCalibration(FrozenModel):
    """A polynomial map of one diode.

    ``x`` and ``y`` are tables of coefficients, entry [i][j] multiplies ``u^i v^j`` with (u, v) = ratios - center;
    ``domain`` is the calibrated box of the ratios, [[lowest, highest] of x, [lowest, highest] of y].
    """

    center: Annotated[Quantity, measured("1", 2)]
    domain: Annotated[Quantity, measured("1", 2, 2)]
    x: Annotated[Quantity, measured("m", ANY, ANY)]
    y: Annotated[Quantity, measured("m", ANY, ANY)]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.x.array.shape != self.y.array.shape:
            msg = f"x has {self.x.array.shape} coefficients and y {self.y.array.shape}, expected the same shape"
            raise ValueError(msg)
        if not np.all(self.domain.array[:, 0] < self.domain.array[:, 1]):
            msg = f"domain {self.domain.value}, expected [lowest, highest] for each ratio"
            raise ValueError(msg)
        return self


def powers(value: float, count: int) -> FloatArray:
    """Return ``value^0 ... value^(count-1)``."""
    return np.asarray(value ** np.arange(count), dtype=float)


def position(coefficients: FloatArray, u: float, v: float) -> FloatArray:
    """Return (x, y) [m] of coefficients of shape (2, i, j) at centred ratios (u, v)."""
    return np.asarray(coefficients @ powers(v, coefficients.shape[2]) @ powers(u, coefficients.shape[1]))


def slope(coefficients: FloatArray, u: float, v: float) -> FloatArray:
    """Return d(x, y)/d(u, v) [m], shape (2, 2)."""
    by_u = np.asarray(polynomial.polyder(coefficients, axis=1), dtype=float)
    by_v = np.asarray(polynomial.polyder(coefficients, axis=2), dtype=float)
    return np.column_stack([position(by_u, u, v), position(by_v, u, v)])
