# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Columns of numbers in tables: flush right, with the decimal points below each other."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

FIGURE_SPACE, POINT_SPACE = "\u2007", "\u2008"  # as wide as a digit, as wide as a point
WORDS = ("", "-", "∞", "none", "unlimited", "not bounded", "not detectable")  # that may stand in place of a number
_NUMBER = re.compile(r"[<>±+-]?[  ]?[\d,]+(\.(?P<decimals>\d+))?(e[+-]?\d+)?( ?%|( per)? [^\d\W]+(/[^\d\W]+)?)?")


def decimals(value: float, digits: int) -> int:
    """Return the decimals with which a positive number has so many significant digits, at least 0."""
    return max(0, digits - 1 - math.floor(math.log10(value)))


def is_number(text: str) -> bool:
    """Return whether a cell is a number, perhaps with a sign, a limit or a unit, or one of ``WORDS``."""
    return text in WORDS or _NUMBER.fullmatch(text) is not None


def align_numbers(cells: Sequence[str]) -> list[str] | None:
    """Return the cells of a column that is flush right, with spaces in place of missing decimals; None: other cells."""
    if not any(cells) or not all(map(is_number, cells)):
        return None
    found = [_NUMBER.fullmatch(cell) for cell in cells]
    most = max((len(each["decimals"]) for each in found if each and each["decimals"]), default=0)
    return [
        cell if each is None else cell + _space(each["decimals"], most) for cell, each in zip(cells, found, strict=True)
    ]


def _space(decimals: str | None, most: int) -> str:
    return FIGURE_SPACE * (most - len(decimals)) if decimals else (POINT_SPACE + FIGURE_SPACE * most if most else "")
