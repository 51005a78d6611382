# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The requirement that a POSOR is designed for: uncertainty, range of motion, size, rate and detectable fault.

Versions of the format:

1. First version: ``uncertainty``, ``range``, ``outside_diameter``, ``inside_diameter``, ``scan_rate``, ``speed``,
   ``minimum_detectable_fault``.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from posor.calibration.file_model import EntryError, FrozenModel, Name
from posor.calibration.quantity import Quantity, measured
from posor.calibration.yaml_document import load_document
from posor.uncertainty.budget_quantities import NATIVE
from pydantic import AfterValidator, Field, model_validator

from posor_design.data_file import read_data
from posor_design.quantity_text import parse_quantity

if TYPE_CHECKING:
    from pathlib import Path

    from posor.numerics.array_types import FloatArray

VERSION = 1
FULL_TURN = math.pi  # rotation to either side [rad] that is a full turn
LARGEST_TILT = 0.1
LEAST_TARGET_TILT = 1e-3
"""Least tilt of the target plane at which a sweep of 30 degrees shows exchanged plugs of gap probes [rad]."""
LARGEST_RATE = 10_000.0  # of the simulator [Hz]
FREEDOMS = tuple(name for name, _ in NATIVE)  # names of the freedoms in the order of all arrays, (6,)


class Option(NamedTuple):
    """An option of the requirement: its entry in a requirement file, its SI unit, its default and its meaning."""

    entry: str
    unit: str
    default: str
    meaning: str


OPTIONS = {name: Option(*row) for name, row in read_data("requirement_options").items()}


def _within(low: float, high: float, expected: str) -> AfterValidator:
    """Return the validator of a number that is more than ``low`` and at most ``high``."""

    def check(quantity: Quantity) -> Quantity:
        if not low < quantity.number <= high:
            raise EntryError(f"{quantity.number:g} {quantity.unit}", key=("value",), expected=expected)
        return quantity

    return AfterValidator(check)


_POSITIVE = _within(0.0, math.inf, "more than 0")
_NOT_NEGATIVE = _within(-math.ulp(0.0), math.inf, "0 or more")
Length = Annotated[Quantity, measured("m"), _POSITIVE]
Amount = Annotated[Quantity, measured("m"), _NOT_NEGATIVE]
Angle = Annotated[Quantity, measured("rad"), _POSITIVE]


class RequiredUncertainty(FrozenModel):
    """Largest uncertainty of each freedom anywhere in the range: ``coverage_factor`` standard uncertainties."""

    coverage_factor: Annotated[float, Field(strict=True, gt=0.0, le=10.0)] = 1.0
    x: Length
    y: Length
    gap: Length
    alpha: Angle
    beta: Angle
    theta: Angle


class RequiredRange(FrozenModel):
    """Motion of the target to either side of its middle: gap, tilt (about X and about Y), runout (X and Y), theta."""

    gap: Amount
    tilt: Annotated[Quantity, measured("rad"), _within(-math.ulp(0.0), LARGEST_TILT, f"0 to {LARGEST_TILT:g} rad")]
    runout: Amount
    rotation: Annotated[Quantity, measured("rad"), _within(0.0, 3.15, "more than 0, at most pi, a full turn")]


class Requirement(FrozenModel):
    """Content of a requirement file.

    ``name`` becomes the name of the arm with the designed POSOR, also its ROS namespace. ``speed`` is the largest
    velocity of theta. ``target_tilt`` is the tilt of the target plane that is machined on purpose.
    ``minimum_detectable_fault`` is the largest bias of a single reading that the test of one scan may miss
    (``uncertainty.reliability``); without it, readings may be unchecked.
    """

    format: Literal["posor_requirement"]
    version: Literal[1]
    name: Name
    uncertainty: RequiredUncertainty
    range: RequiredRange
    outside_diameter: Length
    inside_diameter: Amount = Quantity(value=0.0, unit="m")
    scan_rate: Annotated[Quantity, measured("Hz"), _within(0.0, LARGEST_RATE, f"more than 0, at most {LARGEST_RATE:g}")]
    speed: Annotated[Quantity, measured("rad/s"), _POSITIVE]
    target_tilt: Annotated[
        Quantity,
        measured("rad"),
        _within(
            math.nextafter(LEAST_TARGET_TILT, 0.0),
            LARGEST_TILT,
            f"{LEAST_TARGET_TILT:g} to {LARGEST_TILT:g} rad; a smaller tilt hides exchanged plugs of gap probes",
        ),
    ] = Quantity(value=1.36e-3, unit="rad")
    minimum_detectable_fault: Length | None = None

    @model_validator(mode="after")
    def _check_diameters(self) -> Self:
        inside, outside = self.inside_diameter.number, self.outside_diameter.number
        if not inside < outside:
            expected = f"less than {outside:g} m, the outside diameter"
            raise EntryError(f"{inside:g} m", key=("inside_diameter", "value"), expected=expected)
        if not self.scan_rate.number.is_integer():
            expected = "a whole number of scans a second"
            raise EntryError(f"{self.scan_rate.number:g} Hz", key=("scan_rate", "value"), expected=expected)
        return self

    @cached_property
    def sigmas(self) -> FloatArray:
        """Largest standard uncertainty of each freedom [m, rad], (6,)."""
        values = [getattr(self.uncertainty, name).number for name in FREEDOMS]
        return np.array(values) / self.uncertainty.coverage_factor

    @cached_property
    def rotation(self) -> float:
        """Largest theta to either side [rad]; at most half a turn."""
        return min(self.range.rotation.number, FULL_TURN)

    @property
    def fault(self) -> float:
        """Largest minimal detectable bias of a reading [m]; infinite: not required."""
        return math.inf if self.minimum_detectable_fault is None else self.minimum_detectable_fault.number

    def changed(self, **values: Any) -> Requirement:
        """Return the requirement with other numbers in SI units; those of a part are ``uncertainty={"x": 1e-6}``."""
        content = self.model_dump(mode="json")
        for name, value in values.items():
            if isinstance(value, dict):
                for key, number in value.items():
                    content[name][key]["value"] = number
            else:
                content[name]["value"] = value
        return Requirement.model_validate(content)


def load_requirement(path: Path) -> Requirement:
    """Read and validate a requirement file (YAML).

    Raises CalibrationError: the file cannot be read, is not YAML, or holds an invalid entry.
    """
    keys = "format, version, name, uncertainty, range, outside_diameter, scan_rate, speed"
    return load_document(path, "requirement file", keys, VERSION, Requirement.model_validate)[0]


def requirement_content(
    name: str, limits: dict[str, float], coverage_factor: float, values: dict[str, float]
) -> dict[str, Any]:
    """Return the content of a requirement file.

    ``name``: name of the requirement. ``limits``: largest uncertainty of each freedom [m, rad]. ``coverage_factor``: of
    these uncertainties. ``values``: entries such as ``range.gap``, in SI units; those left out have the default of
    their option.
    """
    units = dict(NATIVE)
    uncertainty = {key: {"value": value, "unit": units[key]} for key, value in limits.items()}
    content: dict[str, Any] = {
        "format": "posor_requirement",
        "version": VERSION,
        "name": name,
        "uncertainty": {"coverage_factor": coverage_factor, **uncertainty},
        "range": {},
    }
    for option in OPTIONS.values():
        part, _, key = option.entry.rpartition(".")
        value = values.get(option.entry)
        if value is None and option.default:
            value = parse_quantity(option.default, option.unit, option.entry)
        if key and value is not None:
            (content[part] if part else content)[key] = {"value": value, "unit": option.unit}
    return content
