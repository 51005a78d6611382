# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compare two calibrations number by number, in units of their uncertainties."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.calibration.file_model import FrozenModel
from posor.calibration.quantity import Quantity

if TYPE_CHECKING:
    from collections.abc import Iterator

    from posor.calibration.calibration_file import Calibration

_NOT_COMPARED = ("provenance", "fits", "version")


@dataclass(frozen=True)
class Difference:
    """A number whose value or uncertainty differs."""

    name: str  # key and index: ``sensors[0].probes[1].tip[2]``
    unit: str
    first: float
    second: float
    first_sigma: float
    second_sigma: float
    sigmas: float  # difference over its standard uncertainty; infinite if both are exact


@dataclass(frozen=True)
class Comparison:
    """Differences of two calibrations."""

    differences: tuple[Difference, ...]  # the largest in sigmas first
    others: tuple[str, ...]  # sentences on other keys, names and shapes that differ
    compared: int  # numbers that both have
    descended: bool
    """Whether the second was fitted from the first, by its own record. Differences are then in sigmas of the first,
    whose uncertainty the second includes; otherwise of both."""


def compare_calibrations(first: Calibration, second: Calibration) -> Comparison:
    """Return the differences of two calibrations, except for provenance, fit records and format version."""
    descended = any(fit.former == first.content_hash for fit in second.fits)
    ours, theirs = dict(_list_leaves(first, "")), dict(_list_leaves(second, ""))
    differences: list[Difference] = []
    others = [f"{key} is only in the first." for key in ours if key not in theirs]
    others += [f"{key} is only in the second." for key in theirs if key not in ours]
    compared = 0
    for key in (key for key in ours if key in theirs):
        mine, other = ours[key], theirs[key]
        if isinstance(mine, Quantity) and isinstance(other, Quantity):
            if mine.array.shape != other.array.shape or mine.unit != other.unit:
                others.append(f"{key} has another shape or unit.")
                continue
            compared += mine.array.size
            differences += _compare_quantities(key, mine, other, descended=descended)
        elif mine != other:
            others.append(f"{key} is {mine!r} in the first, {other!r} in the second.")
    differences.sort(key=lambda difference: -abs(difference.sigmas))
    return Comparison(tuple(differences), tuple(others), compared, descended)


def _compare_quantities(key: str, first: Quantity, second: Quantity, *, descended: bool) -> Iterator[Difference]:
    for index in np.ndindex(first.array.shape):
        a, b = float(first.array[index]), float(second.array[index])
        s, t = float(first.sigmas[index]), float(second.sigmas[index])
        if (a, s) == (b, t):
            continue
        sigma, off = s if descended else float(np.hypot(s, t)), b - a
        sigmas = off / sigma if sigma > 0.0 else float(np.copysign(np.inf, off)) if off else 0.0
        yield Difference(key + "".join(f"[{i}]" for i in index), first.unit, a, b, s, t, sigmas)


def _list_leaves(part: Any, key: str) -> Iterator[tuple[str, Any]]:
    """Yield every quantity and every other single value with its key."""
    if isinstance(part, FrozenModel) and not isinstance(part, Quantity):
        for name in type(part).model_fields:
            if key or name not in _NOT_COMPARED:
                yield from _list_leaves(getattr(part, name), f"{key}.{name}".lstrip("."))
    elif isinstance(part, dict):
        for name, value in part.items():
            yield from _list_leaves(value, f"{key}.{name}")
    elif isinstance(part, list | tuple):
        for index, value in enumerate(part):
            yield from _list_leaves(value, f"{key}[{index}]")
    elif part is not None:
        yield key, part
