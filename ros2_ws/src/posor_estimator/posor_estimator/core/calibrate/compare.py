"""How two calibrations differ, number by number, in units of their uncertainties."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from posor_estimator.core.calibration.part import FrozenModel
from posor_estimator.core.calibration.quantity import Quantity

if TYPE_CHECKING:
    from collections.abc import Iterator

    from posor_estimator.core.calibration.model import Calibration

_NOT_COMPARED = ("provenance", "fits", "version")


@dataclass(frozen=True)
class Difference:
    """One number that differs, in its value or its uncertainty.

    Attributes:
        name: Key and index: ``sensors[0].probes[1].tip[2]``.
        unit: Of it.
        first: In the first calibration.
        second: In the second.
        first_sigma: Its standard uncertainty in the first.
        second_sigma: In the second.
        sigmas: Difference over its standard uncertainty; infinite where both are stated as exact, zero where only the
            uncertainties differ.

    """

    name: str
    unit: str
    first: float
    second: float
    first_sigma: float
    second_sigma: float
    sigmas: float


@dataclass(frozen=True)
class Comparison:
    """How two calibrations differ.

    Attributes:
        differences: The numbers that differ, the largest difference in sigmas first.
        others: Sentences on everything else that differs: keys, names, shapes.
        compared: How many numbers both have.
        descended: Whether the second says that it was fitted from the first: then the difference is taken in sigmas of
            the first, whose uncertainty the second has taken in; else of both.

    """

    differences: tuple[Difference, ...]
    others: tuple[str, ...]
    compared: int
    descended: bool


def compare(first: Calibration, second: Calibration) -> Comparison:
    """Return how two calibrations differ; provenance, fit records and the version of the format are left aside."""
    descended = any(fit.former == first.content_hash for fit in second.fits)
    ours, theirs = dict(_leaves(first, "")), dict(_leaves(second, ""))
    differences: list[Difference] = []
    others = [f"{key} is only in the first." for key in ours if key not in theirs]
    others += [f"{key} is only in the second." for key in theirs if key not in ours]
    compared = 0
    for key in (key for key in ours if key in theirs):
        one, other = ours[key], theirs[key]
        if isinstance(one, Quantity) and isinstance(other, Quantity):
            if one.array.shape != other.array.shape or one.unit != other.unit:
                others.append(f"{key} has another shape or unit.")
                continue
            compared += one.array.size
            differences += _differing(key, one, other, descended=descended)
        elif one != other:
            others.append(f"{key} is {one!r} in the first, {other!r} in the second.")
    differences.sort(key=lambda difference: -abs(difference.sigmas))
    return Comparison(tuple(differences), tuple(others), compared, descended)


def _differing(key: str, one: Quantity, other: Quantity, *, descended: bool) -> Iterator[Difference]:
    for index in np.ndindex(one.array.shape):
        a, b = float(one.array[index]), float(other.array[index])
        s, t = float(one.sigmas[index]), float(other.sigmas[index])
        if (a, s) == (b, t):
            continue
        sigma = s if descended else float(np.hypot(s, t))
        off = b - a
        sigmas = off / sigma if sigma > 0.0 else float(np.copysign(np.inf, off)) if off else 0.0
        yield Difference(key + "".join(f"[{i}]" for i in index), one.unit, a, b, s, t, sigmas)


def _leaves(part: Any, key: str) -> Iterator[tuple[str, Any]]:
    """Yield every quantity and every other single entry with its key."""
    if isinstance(part, FrozenModel) and not isinstance(part, Quantity):
        for name in type(part).model_fields:
            if key or name not in _NOT_COMPARED:
                yield from _leaves(getattr(part, name), f"{key}.{name}".lstrip("."))
    elif isinstance(part, dict):
        for name, value in part.items():
            yield from _leaves(value, f"{key}.{name}")
    elif isinstance(part, list | tuple):
        for index, value in enumerate(part):
            yield from _leaves(value, f"{key}[{index}]")
    elif part is not None:
        yield key, part
