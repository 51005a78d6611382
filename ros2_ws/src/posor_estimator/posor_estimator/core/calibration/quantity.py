"""Quantities of a calibration file: a value with its unit and its standard uncertainty.

In a file a quantity is a mapping such as ``{value: [0.0, 0.038, 0.0], sigma: 3.4e-4, unit: m}``. The unit is always
written and always checked; ``sigma`` (one number, or one for each component) is the standard uncertainty k = 1 of JCGM
100 and may be left out where it is zero by definition.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationInfo, field_validator

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_estimator.core.types import FloatArray

Number = float
Nested = Number | list[Number] | list[list[Number]]


class FrozenModel(BaseModel):
    """Base of everything in a calibration file: immutable, and a key that is not known is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", ignored_types=(cached_property,))


class Quantity(FrozenModel):
    """Value, standard uncertainty and unit."""

    value: Nested
    sigma: Nested = 0.0
    unit: str

    @field_validator("value", "sigma")
    @classmethod
    def _finite(cls, numbers: Nested, info: ValidationInfo) -> Nested:
        try:
            array = np.array(numbers, dtype=float)
        except ValueError:
            msg = f"rows of different lengths {numbers}, expected a rectangular array"
            raise ValueError(msg) from None
        if not np.all(np.isfinite(array)):
            msg = f"{numbers} is not finite, expected finite numbers"
            raise ValueError(msg)
        if info.field_name == "sigma" and np.any(array < 0.0):
            msg = f"{numbers} is negative, expected a standard uncertainty of zero or more"
            raise ValueError(msg)
        return numbers

    @cached_property
    def array(self) -> FloatArray:
        """The value as a read-only array in the declared unit."""
        array = np.array(self.value, dtype=float)
        array.setflags(write=False)
        return array

    @cached_property
    def sigmas(self) -> FloatArray:
        """The standard uncertainty of each component, in the shape of the value, read-only."""
        sigmas = np.broadcast_to(np.array(self.sigma, dtype=float), self.array.shape).copy()
        sigmas.setflags(write=False)
        return sigmas

    @property
    def number(self) -> float:
        """The value of a scalar quantity."""
        return float(self.array)


ANY = -1


@dataclass(frozen=True)
class _Check:
    unit: str
    shape: tuple[int, ...]

    def __call__(self, quantity: Quantity) -> Quantity:
        if quantity.unit != self.unit:
            msg = f"unit '{quantity.unit}', expected '{self.unit}'"
            raise ValueError(msg)
        actual = np.shape(quantity.value)
        if len(actual) != len(self.shape) or any(w not in (ANY, a) for a, w in zip(actual, self.shape, strict=True)):
            msg = f"value of shape {describe(actual)}, expected {describe(self.shape)}"
            raise ValueError(msg)
        sigma_shape = np.shape(quantity.sigma)
        if sigma_shape not in ((), actual):
            msg = f"sigma of shape {describe(sigma_shape)}, expected one number or {describe(actual)}"
            raise ValueError(msg)
        return quantity


def describe(shape: tuple[int, ...]) -> str:
    """Return a shape in words: ``one number``, ``3 numbers``, ``a table of 2 x any``."""
    names = ["any number of" if n == ANY else str(n) for n in shape]
    if not shape:
        return "one number"
    if len(shape) == 1:
        return f"{names[0]} numbers"
    return "a table of " + " x ".join(names)


def measured(unit: str, *shape: int) -> AfterValidator:
    """Return the annotation that fixes a quantity's unit and shape; ``ANY`` leaves a length open."""
    check: Callable[[Quantity], Quantity] = _Check(unit, shape)
    return AfterValidator(check)
