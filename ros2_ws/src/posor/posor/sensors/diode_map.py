# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Maps from the ratios of a diode's contact currents to the light spot's position, as calibration files give them.

The ratios are ``(A - C)/(A + C)`` along x and ``(B - D)/(B + D)`` along y. ``model.spot_map`` describes
each kind and the order of its parameters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import model_validator

from posor.calibration.file_model import EntryError, FrozenModel, format_value, select_model_by_key
from posor.calibration.quantity import ANY, Quantity, describe_shape, measured
from posor.model.diode import MAX_MAP_LENGTH
from posor.model.spot_map import CHEBYSHEV, CURVES, POWER

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray


class MapDomain(FrozenModel):
    """What all maps have: the calibrated box of the ratios, [[lowest, highest] of x, [lowest, highest] of y]."""

    domain: Annotated[Quantity, measured("1", 2, 2)]

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not np.all(self.domain.array[:, 0] < self.domain.array[:, 1]):
            expected = "[lowest, highest] for each ratio"
            raise EntryError(f"domain {self.domain.value}", key=("domain",), expected=expected)
        return self


class TensorMap(MapDomain):
    """Two tables of coefficients: entry [i][j] multiplies function i of the x ratio and function j of the y ratio.

    ``polynomial``: powers of the ratios' distance from ``center``. ``chebyshev``: Chebyshev polynomials of the ratios
    scaled so that the domain becomes [-1, 1]; smooth, and the better conditioned the higher the order.
    """

    kind: Literal["polynomial", "chebyshev"]
    center: Annotated[Quantity, measured("1", 2)] | None = None
    x: Annotated[Quantity, measured("m", ANY, ANY)]
    y: Annotated[Quantity, measured("m", ANY, ANY)]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.x.array.shape != self.y.array.shape:
            expected = f"{describe_shape(self.x.array.shape)}, as x has"
            raise EntryError(f"y has {describe_shape(self.y.array.shape)}", key=("y",), expected=expected)
        if max(self.x.array.shape) > MAX_MAP_LENGTH:
            what = f"x has {describe_shape(self.x.array.shape)}"
            raise EntryError(what, key=("x",), expected=f"at most {MAX_MAP_LENGTH} functions of each ratio")
        if self.kind == "polynomial" and self.center is None:
            raise EntryError("key 'center' is missing", expected="the ratios from which a polynomial counts")
        if self.kind == "chebyshev" and self.center is not None:
            what = "a chebyshev map has a center"
            raise EntryError(what, key=("center",), expected="none: it takes the middle of its domain")
        return self

    @property
    def map_kind(self) -> int:
        """See ``model.spot_map``."""
        return POWER if self.kind == "polynomial" else CHEBYSHEV

    @property
    def map_lengths(self) -> tuple[int, ...]:
        """Lengths of the tables."""
        return self.x.array.shape

    @property
    def center_and_scale(self) -> tuple[FloatArray, FloatArray]:
        """Centre and scale of the ratios, shape (2,) each."""
        if self.center is not None:
            return self.center.array, np.ones(2)
        box = self.domain.array
        return box.mean(axis=1), 0.5 * (box[:, 1] - box[:, 0])

    @property
    def parameters(self) -> tuple[FloatArray, FloatArray]:
        """Values and standard uncertainties, shape (p,) each."""
        return (
            np.concatenate([self.x.array.ravel(), self.y.array.ravel()]),
            np.concatenate([self.x.sigmas.ravel(), self.y.sigmas.ravel()]),
        )


class CurvesMap(MapDomain):
    """The map of 1985 (thesis 7.4.2, 8.3.3): polynomials along lines, weighted linearly in between, iteration.

    ``x_curves`` [i][k] is the coefficient of (x ratio)^k in x [m] on the line y = ``x_curves_at``[i]; ``y_curves``
    likewise for y of the y ratio on the lines x = ``y_curves_at``[i].
    """

    kind: Literal["curves"]
    x_curves: Annotated[Quantity, measured("m", ANY, ANY)]
    x_curves_at: Annotated[Quantity, measured("m", ANY)]
    y_curves: Annotated[Quantity, measured("m", ANY, ANY)]
    y_curves_at: Annotated[Quantity, measured("m", ANY)]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.x_curves.array.shape != self.y_curves.array.shape:
            expected = f"{describe_shape(self.x_curves.array.shape)}, as x_curves has"
            what = f"y_curves has {describe_shape(self.y_curves.array.shape)}"
            raise EntryError(what, key=("y_curves",), expected=expected)
        count = self.x_curves.array.shape[0]
        for name, at in (("x_curves_at", self.x_curves_at), ("y_curves_at", self.y_curves_at)):
            if at.array.size != count or count < 2 or not np.all(np.diff(at.array) > 0.0):  # noqa: PLR2004
                expected = f"{count} ascending positions, two or more, one for each curve"
                raise EntryError(f"{name} {format_value(at.value)}", key=(name,), expected=expected)
        return self

    @property
    def map_kind(self) -> int:
        """See ``model.spot_map``."""
        return CURVES

    @property
    def map_lengths(self) -> tuple[int, ...]:
        """Number of curves and of their coefficients."""
        return self.x_curves.array.shape

    @property
    def center_and_scale(self) -> tuple[FloatArray, FloatArray]:
        """Not used by this kind of map, which takes the ratios unscaled."""
        return np.zeros(2), np.ones(2)

    @property
    def parameters(self) -> tuple[FloatArray, FloatArray]:
        """Values and standard uncertainties, shape (p,) each."""
        parts = (self.x_curves, self.y_curves, self.x_curves_at, self.y_curves_at)
        return (
            np.concatenate([part.array.ravel() for part in parts]),
            np.concatenate([part.sigmas.ravel() for part in parts]),
        )


SpotMap = Annotated[
    TensorMap | CurvesMap,
    select_model_by_key("kind", {"polynomial": TensorMap, "chebyshev": TensorMap, "curves": CurvesMap}),
]
