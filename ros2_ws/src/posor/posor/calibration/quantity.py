# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Quantities of a calibration file: a value with its unit and its standard uncertainty.

In a file a quantity is a mapping such as ``{value: [0.0, 0.038, 0.0], sigma: 3.4e-4, unit: m}``. The unit is required
and checked. ``sigma`` (one number, or one for each component) is the standard uncertainty (k = 1, JCGM 100), by default
zero. Lengths may be written in mm or um and angles in deg, as the unit of the quantity or beside single numbers:
``{value: ['20 mm', 0.038, 0.0], sigma: 50 um, unit: m}``. They are converted here; everything else has SI units.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation, Overflow
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from pydantic import AfterValidator, ValidationInfo, field_validator, model_validator

from posor.calibration.file_model import EntryError, FrozenModel, Location, format_value

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor.numerics.array_types import FloatArray

Number = float
_DIMENSIONS = 2
_UNIT_TOLERANCE = 1e-6
Nested = Number | list[Number] | list[list[Number]]
CONVERTED_UNITS = {"mm": ("m", Decimal("1e-3")), "um": ("m", Decimal("1e-6")), "deg": ("rad", Decimal(math.pi) / 180)}
"""Units that files may use besides those of SI: the SI unit, and its amount in one of them."""
_NUMBER_WITH_UNIT = re.compile(
    r"""([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)  # a number
    (?![eExob][-+]?[0-9])\s*((?:(?<=\s)1/)?[^\W0-9_]\S*|[°%"']\S*)  # a unit, such as mm2, kg/m^3, 1/K or %""",
    re.VERBOSE,
)


class Quantity(FrozenModel):
    """Value, standard uncertainty and unit."""

    value: Nested
    sigma: Nested = 0.0
    unit: str

    @model_validator(mode="before")
    @classmethod
    def _require_unit(cls, data: object) -> object:
        if isinstance(data, int | float | list | str):
            what = format_value(data) if isinstance(data, str) else f"{format_value(data)} has no unit"
            raise EntryError(what, expected="a mapping such as {value: 1.0, unit: m}")
        if not isinstance(data, dict) or not isinstance(data.get("unit"), str):
            return data
        unit, factor = CONVERTED_UNITS.get(data["unit"], (data["unit"], Decimal(1)))
        numbers = {key: _to_unit(data[key], unit, factor, (key,)) for key in ("value", "sigma") if key in data}
        return {**data, **numbers, "unit": unit}

    @field_validator("value", "sigma", mode="before")
    @classmethod
    def _check_numbers(cls, raw: object, info: ValidationInfo) -> object:
        numbers = _as_floats(raw)
        try:
            array = np.array(numbers, dtype=float)
        except ValueError:
            raise EntryError(f"rows of different lengths {format_value(raw)}", expected="a rectangular array") from None
        if not np.all(np.isfinite(array)):
            raise EntryError(f"{format_value(raw)} is not finite", expected="finite numbers")
        if info.field_name == "sigma" and np.any(array < 0.0):
            raise EntryError(f"{format_value(raw)} is negative", expected="a standard uncertainty of zero or more")
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


def _to_unit(raw: object, unit: str, factor: Decimal, key: Location) -> object:
    """Return a number, or lists of numbers, in an SI unit.

    ``raw``: as written: numbers in a unit of ``factor`` SI units, or texts with a unit of their own. ``unit``: the SI
    unit. ``factor``: the unit of numbers without one. ``key``: keys from the quantity to the number. Raises EntryError:
    a text is not a number with a unit of this dimension.
    """
    if isinstance(raw, list | tuple):
        return [_to_unit(entry, unit, factor, (*key, i)) for i, entry in enumerate(raw)]
    if isinstance(raw, str):
        match = _NUMBER_WITH_UNIT.fullmatch(raw.strip())
        if match is None:
            return raw  # refused as text
        si, factor = CONVERTED_UNITS.get(match[2], (match[2], Decimal(1)))
        if si != unit:
            raise EntryError(format_value(raw), key=key, expected=f"a number in {describe_units(unit)}")
        raw = match[1]
    elif factor == 1 or isinstance(raw, bool) or not isinstance(raw, int | float):
        return raw
    try:
        return float(Decimal(str(raw)) * factor)  # in decimals, as it is written: 38.1 mm is exactly 0.0381 m
    except Overflow:
        return math.inf
    except InvalidOperation:  # an exponent beyond those of decimals
        raise EntryError(format_value(raw), key=key, expected=f"a number in {describe_units(unit)}") from None


def describe_units(unit: str) -> str:
    """Return the units in which a quantity may be written: ``'m', 'mm' or 'um'``."""
    *others, last = [f"'{unit}'", *(f"'{name}'" for name, (si, _) in CONVERTED_UNITS.items() if si == unit)]
    return f"{', '.join(others)} or {last}" if others else last


def _as_floats(raw: object, key: tuple[int, ...] = ()) -> object:
    """Return a number, or a list or table of numbers, as floats; text and booleans are refused."""
    if isinstance(raw, list | tuple) and len(key) < _DIMENSIONS:
        if not raw:
            raise EntryError("the list is empty", key=key, expected="at least one number")
        return [_as_floats(entry, (*key, i)) for i, entry in enumerate(raw)]
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        raise EntryError(format_value(raw), key=key, expected="a number")
    try:
        return float(raw)
    except OverflowError:
        return math.inf


ANY = -1


@dataclass(frozen=True)
class _UnitAndShape:
    """Validator of a quantity's unit and shape."""

    unit: str
    shape: tuple[int, ...]

    def __call__(self, quantity: Quantity) -> Quantity:
        if quantity.unit != self.unit:
            raise EntryError(f"unit {describe_units(quantity.unit)}", key=("unit",), expected=describe_units(self.unit))
        actual = np.shape(quantity.value)
        if len(actual) != len(self.shape) or any(w not in (ANY, a) for a, w in zip(actual, self.shape, strict=True)):
            commas = " (decimal commas?)" if _may_have_decimal_commas(quantity.array, self.shape) else ""
            expected = f"{describe_shape(self.shape)}{commas}"
            raise EntryError(f"value has {describe_shape(actual)}", key=("value",), expected=expected)
        sigma_shape = np.shape(quantity.sigma)
        if sigma_shape not in ((), actual):
            expected = describe_shape(()) + (f" or {describe_shape(actual)}" if actual else "")
            raise EntryError(f"sigma has {describe_shape(sigma_shape)}", key=("sigma",), expected=expected)
        return quantity


def _may_have_decimal_commas(numbers: FloatArray, shape: tuple[int, ...]) -> bool:
    """Return whether a list of another shape has that shape if commas between whole numbers are decimal ones."""
    if numbers.ndim != 1 or len(shape) > 1 or ANY in shape:
        return False
    excess, n = numbers.size - math.prod(shape), 0
    pairs = 0
    while n + 1 < numbers.size:
        is_pair = numbers[n].is_integer() and numbers[n + 1].is_integer() and numbers[n + 1] >= 0.0
        pairs, n = pairs + is_pair, n + 1 + is_pair
    return 0 < excess <= pairs


def describe_shape(shape: tuple[int, ...]) -> str:
    """Return a shape in words: ``one number``, ``3 numbers``, ``a table of 2 x 2 numbers``."""
    if not shape:
        return "one number"
    if shape == (1,):
        return "one number in a list"
    if shape == (ANY,):
        return "a list of numbers"
    if len(shape) == 1:
        return f"{shape[0]} numbers"
    if set(shape) == {ANY}:
        return "a table of numbers"
    return "a table of " + " x ".join("any" if n == ANY else str(n) for n in shape) + " numbers"


def check_unit_vector(name: str, quantity: Quantity) -> None:
    """Check that a vector has length 1.

    Raises EntryError: the length differs from 1; ``name`` is the key of the vector.
    """
    length = float(np.linalg.norm(quantity.array))
    if abs(length - 1.0) > _UNIT_TOLERANCE:
        what = f"{name} {format_value(quantity.value)} has length {length:.9g}"
        raise EntryError(what, key=(name,), expected="a unit vector")


def check_positive(name: str, quantity: Quantity, *, below: float = math.inf, or_zero: bool = False) -> None:
    """Check that a number is above zero, or zero where allowed, and below a bound.

    Raises EntryError: it is not; ``name`` is the key of the number.
    """
    value = quantity.number
    if not (0.0 < value < below or (or_zero and value == 0.0)):
        least = "zero or more" if or_zero else "more than 0"
        expected = least if math.isinf(below) else f"{least}, less than {below:g}"
        raise EntryError(f"{name} {value:g} {quantity.unit}", key=(name,), expected=expected)


def measured(unit: str, *shape: int) -> AfterValidator:
    """Return the annotation that requires a unit and a shape; ``ANY`` allows any length."""
    check: Callable[[Quantity], Quantity] = _UnitAndShape(unit, shape)
    return AfterValidator(check)
