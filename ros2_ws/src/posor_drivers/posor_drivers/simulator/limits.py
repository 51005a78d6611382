"""Limits on the quantities of a scenario file."""

from __future__ import annotations

import numpy as np
from posor_estimator.core.calibration.entry import EntryError, shown
from posor_estimator.core.calibration.quantity import (
    Quantity,  # noqa: TC002  pydantic reads the signatures of validators
)
from pydantic import AfterValidator


def _positive(quantity: Quantity) -> Quantity:
    if not np.all(quantity.array > 0.0):
        raise EntryError(f"{shown(quantity.value)} {quantity.unit}", key=("value",), expected="more than 0")
    return quantity


def _not_negative(quantity: Quantity) -> Quantity:
    if not np.all(quantity.array >= 0.0):
        raise EntryError(f"{shown(quantity.value)} {quantity.unit}", key=("value",), expected="0 or more")
    return quantity


def _share(quantity: Quantity) -> Quantity:
    if not 0.0 <= quantity.number < 1.0:
        raise EntryError(shown(quantity.value), key=("value",), expected="a probability of 0 or more, less than 1")
    return quantity


def _interval(quantity: Quantity) -> Quantity:
    low, high = quantity.array
    if not low < high:
        raise EntryError(f"{shown(quantity.value)} {quantity.unit}", key=("value",), expected="[lowest, highest]")
    return quantity


POSITIVE = AfterValidator(_positive)
NOT_NEGATIVE = AfterValidator(_not_negative)
PROBABILITY = AfterValidator(_share)
INTERVAL = AfterValidator(_interval)
