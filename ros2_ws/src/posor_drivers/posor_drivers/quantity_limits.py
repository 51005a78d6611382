# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Range checks for quantities of scenario and instruments files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from posor.calibration.file_model import EntryError, format_value
from posor.calibration.quantity import Quantity, measured
from pydantic import AfterValidator

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor.numerics.array_types import FloatArray


def limit_quantity(accepts: Callable[[FloatArray], object], expected: str) -> AfterValidator:
    """Return the validator of a quantity whose values must satisfy ``accepts``."""

    def check(quantity: Quantity) -> Quantity:
        if not accepts(quantity.array):
            unit = "" if quantity.unit == "1" else f" {quantity.unit}"
            raise EntryError(f"{format_value(quantity.value)}{unit}", key=("value",), expected=expected)
        return quantity

    return AfterValidator(check)


POSITIVE = limit_quantity(lambda values: np.all(values > 0.0), "more than 0")
NOT_NEGATIVE = limit_quantity(lambda values: np.all(values >= 0.0), "0 or more")
PROBABILITY = limit_quantity(lambda value: 0.0 <= value < 1.0, "a probability of 0 or more, less than 1")
INTERVAL = limit_quantity(lambda limits: limits[0] < limits[1], "[lowest, highest]")

Seconds = Annotated[Quantity, measured("s"), POSITIVE]
MAX_DELAY_S = 5.0
"""Longest delay of a reading: an instrument that is slower measures no arm, but 20 ms are easily entered as 20 s."""
Delay = Annotated[
    Quantity,
    measured("s"),
    limit_quantity(lambda s: 0.0 <= s <= MAX_DELAY_S, f"0 to {MAX_DELAY_S:g} s (milliseconds?)"),
]
MAX_RATE_HZ = 10_000
TickRate = Annotated[
    Quantity,
    measured("Hz"),
    limit_quantity(
        lambda hz: 1 <= hz <= MAX_RATE_HZ and float(hz).is_integer(), f"a whole number from 1 to {MAX_RATE_HZ}"
    ),
]
"""Ticks of the ROS clock per second."""
