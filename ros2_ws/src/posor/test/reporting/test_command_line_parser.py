# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Types of options: numbers within limits, and the sentence that refuses others."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from posor.errors import ParameterError
from posor.reporting.command_line_parser import CommandLineParser, number_above, number_from, whole_number_from


def parse(kind: Callable[[str], float], text: str) -> float:
    parser = CommandLineParser(prog="posor try")
    parser.add_argument("--size", type=kind)
    return float(parser.parse_args([f"--size={text}"]).size)


@pytest.mark.parametrize(
    ("kind", "text", "number"),
    [
        (number_from(0.0, unit="s"), "0", 0.0),
        (number_from(0.0, math.pi), "3.14", 3.14),
        (number_above(0.0, 1e6, "m"), "1e6", 1e6),
        (whole_number_from(1), "1", 1),
        (whole_number_from(0, 65535), "65535", 65535),
    ],
)
def test_a_number_within_the_limits_is_read(kind: Callable[[str], float], text: str, number: float) -> None:
    assert parse(kind, text) == number


@pytest.mark.parametrize(
    ("kind", "text", "expected"),
    [
        (number_from(0.0, unit="s"), "-1e-9", "a number of at least 0 s"),
        (number_from(0.0, unit="s"), "nan", "a number of at least 0 s"),
        (number_from(0.0, unit="s"), "inf", "a number of at least 0 s"),
        (number_from(0.0, unit="s"), "soon", "a number of at least 0 s"),
        (number_from(1e-15, 0.1), "0.2", "a number of at least 1e-15 and at most 0.1"),
        (number_above(0.0, 1e6, "m"), "0", "a number of more than 0 and at most 1000000 m"),
        (whole_number_from(1), "0", "a whole number in digits of at least 1"),
        (whole_number_from(1), "1e3", "a whole number in digits of at least 1"),
        (whole_number_from(1), "1_0", "a whole number in digits of at least 1"),
        (number_from(0.0), "1_0.5", "a number of at least 0"),
        (number_from(0.0), "\N{ARABIC-INDIC DIGIT ONE}", "a number of at least 0"),
        (whole_number_from(1), "9" * 400, "a whole number in digits of at least 1"),
        (whole_number_from(0, 65535), "65536", "a whole number in digits of at least 0 and at most 65535"),
    ],
)
def test_another_text_is_refused_with_the_limits(kind: Callable[[str], float], text: str, expected: str) -> None:
    with pytest.raises(ParameterError) as refusal:
        parse(kind, text)
    assert str(refusal.value) == (
        f"try: argument --size: '{text}' is not {expected}; expected options as 'posor try --help' lists them."
    )
