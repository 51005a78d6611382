# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Arguments by kind: one quantity, several, a count, a name; the refusals; results as text."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest
from posor.errors import ParameterError
from posor_design.calculators import unit_of
from posor_design.value_kinds import describe_kind, format_value, name_kind, parse_value, summarise_value

Metre = Annotated[float, "m", "Meaning."]
Metres = Annotated[tuple[float, ...], "m", "Meaning."]
TwoMetres = Annotated[tuple[float, float], "m", "Meaning."]
Numbers = Annotated[tuple[float, ...], "1", "Meaning."]
Curves = Annotated[tuple[tuple[float, ...], ...], "m", "Meaning."]
Count = Annotated[int, "Meaning."]
Shape = Annotated[Literal["tube", "box"], "Meaning."]


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        (Metre, "25 mm", 0.025),
        (Metres, "6, 24 in", (0.1524, 0.6096)),
        (Metres, "6 in, 24 mm, 1", (0.1524, 0.024, 1.0)),
        (TwoMetres, "1 mm,2 mm", (0.001, 0.002)),
        (Numbers, "1, 2", (1.0, 2.0)),
        (Count, "8", 8),
        (Shape, "box", "box"),
    ],
)
def test_a_value_is_read(kind: Any, text: str, value: Any) -> None:
    assert parse_value(kind, text, "--size") == pytest.approx(value)


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        (Metres, "6, , 24 in", "--size: 'in' is not a number with unit"),
        (TwoMetres, "1 mm", "1 values in '1 mm'; expected 2 numbers separated by commas, each a number in m"),
        (Metres, "1 mm, 2 kg", "'2 kg' has another dimension; expected a number in m"),
        (Count, "8.5", r"--size: '8\.5' is not a whole number; expected a whole number"),
        (Shape, "tubes", "--size: 'tubes' is unknown; expected perhaps 'tube'"),
        (Shape, "ring", "--size: 'ring' is unknown; expected one of tube, box"),
    ],
)
def test_a_wrong_value_is_refused(kind: Any, text: str, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        parse_value(kind, text, "--size")


@pytest.mark.parametrize(
    ("kind", "value", "text"),
    [
        (Metres, (0.001, 2e-6), "1 mm, 2 um"),
        (Curves, ((0.001, 0.002), (0.003,)), "1 mm, 2 mm; 3 mm"),
        (Metres, (), ""),
        (Count, 8, "8"),
        (Shape, "box", "box"),
    ],
)
def test_a_value_is_printed(kind: Any, value: Any, text: str) -> None:
    assert format_value(kind, value) == text


def test_a_series_is_summarised() -> None:
    assert summarise_value(Metres, (0.001,) * 12) == ", ".join(["1 mm"] * 12)
    assert summarise_value(Metres, (0.001, *(0.002,) * 12)) == "13 values from 1 mm to 2 mm"
    assert summarise_value(Curves, ((0.0,) * 9, (1.0,) * 9)) == "2 x 9 values from 0 m to 1 m"


def test_kinds_are_described() -> None:
    assert describe_kind(Numbers) == "numbers separated by commas, each a number (%, ppm)"
    assert describe_kind(Shape) == "one of tube, box"
    named = {"m, ...": Metres, "m, m": TwoMetres, "tube or box": Shape, "whole number": Count, "m": Metre}
    assert {name_kind(kind): kind for kind in named.values()} == named
    assert unit_of(Curves) == "m"
    assert unit_of(Count) == "1"
