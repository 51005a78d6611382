# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Plausible amounts of the quantities of files, which show a value in another unit."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor.calibration.file_model import EntryError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.calibration.quantity import Quantity


@dataclass(frozen=True)
class PlausibleRange:
    """Plausible amounts of a quantity in its SI unit: a value beyond is usually one of another unit."""

    least: float
    most: float
    causes: Mapping[str, float]  # likely causes of a value beyond, and by what each multiplies the value to correct it
    or_zero: bool = False

    def check(self, name: str, quantity: Quantity) -> None:
        """Raise EntryError if a number of a quantity, whose key is its name, is out of range."""
        for value in np.ravel(quantity.array):
            if expected := self.expected(float(value), quantity.unit):
                raise EntryError(f"{name} {value:g} {quantity.unit}", key=(name,), expected=expected)

    def expected(self, value: float, unit: str) -> str:
        """Return what is plausible instead of a value, and the likely causes; empty: the value is."""
        if self.least <= value <= self.most or (self.or_zero and value == 0.0):
            return ""
        fitting = [cause for cause, factor in self.causes.items() if self.least < value * factor <= self.most]
        question = f" ({' or '.join(fitting)}?)" if fitting else ""
        return f"{'0 or ' if self.or_zero else ''}{self.least:g} to {self.most:g} {unit}{question}"


ANY_FINITE = (-sys.float_info.max, sys.float_info.max)
TEMPERATURE = PlausibleRange(100.0, 600.0, {"in degrees Celsius": 15.0})
PLACE = PlausibleRange(-1.0, 1.0, {"in mm": 1e-3, "in inches": 0.0254})  # of a part on a plate of a POSOR
