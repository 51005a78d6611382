# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Numbers as programs and instruments write them: which texts are numbers, and which numbers are no readings."""

from __future__ import annotations

OVERLOAD = 9.9e37
"""Smallest absolute value that stands for a reading that is too large or invalid (SCPI-99, 7.2.1)."""


def with_exponent_e(text: str) -> str:
    """Return the text of a number whose exponent may begin with D, as Fortran writes it, with E."""
    return text.replace("d", "e").replace("D", "e")


def parse_number(text: str) -> float:
    """Return the number of a text with a decimal point, ``nan`` and ``inf`` included; the exponent may begin with D.

    Raises:
        ValueError: The text is no number. ``1_0`` is refused, although Python accepts it.

    """
    if "_" in text or not text.isascii():
        raise ValueError(text)
    return float(with_exponent_e(text))
