# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Options of programs that read references of the endpoint: numbers by the name of a reference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from posor.errors import ParameterError
from posor.tables.number_text import parse_number

if TYPE_CHECKING:
    from collections.abc import Mapping


Limits = Sequence[tuple[float, float]]  # least and largest value of each number; others are in another unit
UNCERTAINTY_LIMITS: Limits = ((1e-9, 5e-3), (0.0, 1e-3), (0.0, 0.1))  # constant [m], per metre, of angles [rad]
TOOL_UNCERTAINTY_LIMITS: Limits = ((1e-6, 1.0), (1e-6, math.pi))  # [m], [rad]
PLACE_LIMITS: Limits = (*[(-2.0, 2.0)] * 3, *[(-math.pi, math.pi)] * 3)  # of a tool [m], [rad]


def numbers_of(where: str, text: str, counts: Sequence[int], limits: Limits) -> list[float]:
    """Return the numbers of a text ``a,b,...``.

    ``where``: program and option; ``counts``: how many numbers there may be; ``limits``: of each. Raises
    ParameterError: they are invalid.
    """
    try:
        numbers = [parse_number(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    within = (least <= number <= most for number, (least, most) in zip(numbers, limits, strict=False))
    if len(numbers) not in counts or not all(within):
        ranges = ", ".join(f"{least:.4g} to {most:.4g}" for least, most in limits[: max(counts)])
        expected = f"{' or '.join(map(str, counts))} numbers, {ranges}"
        raise ParameterError(f"'{text}'", where=where, expected=expected)
    return numbers


def named_numbers(where: str, entries: Sequence[str], counts: Sequence[int], limits: Limits) -> dict[str, list[float]]:
    """Return the numbers of entries ``NAME=a,b,...`` by name, see ``numbers_of``."""
    found: dict[str, list[float]] = {}
    for entry in entries:
        name, equals, text = entry.partition("=")
        if not (name and equals) or name in found:
            raise ParameterError(f"'{entry}'", where=where, expected="NAME=..., each name once")
        found[name] = numbers_of(where, text, counts, limits)
    return found


def check_names(where: str, given: Mapping[str, object], known: Mapping[str, object]) -> None:
    """Raise ParameterError if a name is not known; ``where``: program and option."""
    for name in given:
        if name not in known:
            raise ParameterError(f"'{name}'", where=where, expected=f"one of {', '.join(known)}")
