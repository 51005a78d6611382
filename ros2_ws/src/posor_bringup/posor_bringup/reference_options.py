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


def numbers_of(where: str, text: str, counts: Sequence[int], *, positive: bool) -> list[float]:
    """Return the numbers of a text ``a,b,...``; ``positive``: the first is above 0, the others 0 or more.

    ``where``: program and option; ``counts``: how many numbers there may be. Raises ParameterError: they are invalid.
    """
    try:
        numbers = [parse_number(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    bad = not all(math.isfinite(number) and (number >= 0.0 or not positive) for number in numbers)
    if len(numbers) not in counts or bad or (positive and not numbers[0] > 0.0):
        expected = f"{' or '.join(map(str, counts))} numbers{' of 0 or more, the first above 0' if positive else ''}"
        raise ParameterError(f"'{text}'", where=where, expected=expected)
    return numbers


def named_numbers(
    where: str, entries: Sequence[str], counts: Sequence[int], *, positive: bool
) -> dict[str, list[float]]:
    """Return the numbers of entries ``NAME=a,b,...`` by name, see ``numbers_of``."""
    found: dict[str, list[float]] = {}
    for entry in entries:
        name, equals, text = entry.partition("=")
        if not (name and equals) or name in found:
            raise ParameterError(f"'{entry}'", where=where, expected="NAME=..., each name once")
        found[name] = numbers_of(where, text, counts, positive=positive)
    return found


def check_names(where: str, given: Mapping[str, object], known: Mapping[str, object]) -> None:
    """Raise ParameterError if a name is not known; ``where``: program and option."""
    for name in given:
        if name not in known:
            raise ParameterError(f"'{name}'", where=where, expected=f"one of {', '.join(known)}")
