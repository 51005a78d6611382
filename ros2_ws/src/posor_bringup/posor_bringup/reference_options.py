# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Options of programs that read references of the endpoint: numbers by the name of a reference."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor.errors import ParameterError
from posor.tables.number_text import parse_number

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


MOST_UNCERTAINTY = (0.1, 0.1, 1.0)  # constant [m], per metre, of angles [rad]: larger ones are in another unit
MOST_PLACE = (10.0,) * 3 + (2.0 * math.pi,) * 3  # of a tool [m], [rad]


def numbers_of(where: str, text: str, counts: Sequence[int], most: Sequence[float], *, positive: bool) -> list[float]:
    """Return the numbers of a text ``a,b,...``; ``positive``: the first is above 0, the others 0 or more.

    ``where``: program and option; ``counts``: how many numbers there may be; ``most``: largest absolute value of each.
    Raises ParameterError: they are invalid.
    """
    try:
        numbers = [parse_number(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    valid = len(numbers) in counts and all(abs(n) <= limit for n, limit in zip(numbers, most, strict=False))
    if not valid or (positive and (min(numbers) < 0.0 or numbers[0] == 0.0)):
        limits = ", ".join(f"{limit:.4g}" for limit in most[: max(counts)])
        signs = " of 0 or more, the first above 0" if positive else ""
        expected = f"{' or '.join(map(str, counts))} numbers{signs}, at most {limits}"
        raise ParameterError(f"'{text}'", where=where, expected=expected)
    return numbers


def named_numbers(
    where: str, entries: Sequence[str], counts: Sequence[int], most: Sequence[float], *, positive: bool
) -> dict[str, list[float]]:
    """Return the numbers of entries ``NAME=a,b,...`` by name, see ``numbers_of``."""
    found: dict[str, list[float]] = {}
    for entry in entries:
        name, equals, text = entry.partition("=")
        if not (name and equals) or name in found:
            raise ParameterError(f"'{entry}'", where=where, expected="NAME=..., each name once")
        found[name] = numbers_of(where, text, counts, most, positive=positive)
    return found


def check_names(where: str, given: Mapping[str, object], known: Mapping[str, object]) -> None:
    """Raise ParameterError if a name is not known; ``where``: program and option."""
    for name in given:
        if name not in known:
            raise ParameterError(f"'{name}'", where=where, expected=f"one of {', '.join(known)}")
