"""Arguments by kind: one quantity, several, a count, a name; the refusals; results as text."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest
from posor.errors import ParameterError
from posor_design.units import unit_of
from posor_design.value_kinds import (
    describe_kind,
    format_value,
    name_kind,
    parse_value,
    summarise_value,
)

Metre = Annotated[float, "m"]
Number = Annotated[float, "1"]
Shape = Literal["tube", "box"]


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        (Metre, "25 mm", 0.025),
        (tuple[Metre, ...], "6, 24 in", (0.1524, 0.6096)),
        (tuple[Metre, ...], "6 in, 24 mm, 1", (0.1524, 0.024, 1.0)),
        (tuple[Metre, Metre], "1 mm,2 mm", (0.001, 0.002)),
        (tuple[Number, ...], "1, 2", (1.0, 2.0)),
        (int, "8", 8),
        (Shape, "box", "box"),
    ],
)
def test_a_value_is_read(kind: Any, text: str, value: Any) -> None:
    assert parse_value(kind, text, "--size") == pytest.approx(value)


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        (tuple[Metre, ...], "6, , 24 in", "--size: 'in' is not a number with unit"),
        (
            tuple[Metre, Metre],
            "1 mm",
            r"1 values in '1 mm'; expected 2 numbers separated by commas, each a number in m",
        ),
        (tuple[Metre, ...], "1 mm, 2 kg", "'2 kg' has another dimension; expected a number in m"),
        (int, "8.5", r"--size: '8\.5' is not a whole number; expected a whole number"),
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
        (tuple[Metre, ...], (0.001, 2e-6), "1 mm, 2 um"),
        (tuple[tuple[Metre, ...], ...], ((0.001, 0.002), (0.003,)), "1 mm, 2 mm; 3 mm"),
        (tuple[Metre, ...], (), ""),
        (int, 8, "8"),
        (Shape, "box", "box"),
    ],
)
def test_a_value_is_printed(kind: Any, value: Any, text: str) -> None:
    assert format_value(kind, value) == text


def test_a_series_is_summarised() -> None:
    assert summarise_value(tuple[Metre, ...], (0.001,) * 12) == ", ".join(["1 mm"] * 12)
    assert summarise_value(tuple[Metre, ...], (0.001, *(0.002,) * 12)) == "13 values from 1 mm to 2 mm"
    assert summarise_value(tuple[tuple[Number, ...], ...], ((0.0,) * 9, (1.0,) * 9)) == "2 x 9 values from 0 to 1"


def test_kinds_are_described() -> None:
    assert describe_kind(tuple[Number, ...]) == "numbers separated by commas, each a number (%, ppm)"
    assert describe_kind(Shape) == "one of tube, box"
    assert [name_kind(kind) for kind in (tuple[Metre, ...], tuple[Metre, Number], Shape, int, Metre)] == [
        "m, ...",
        "m, 1",
        "tube or box",
        "whole number",
        "m",
    ]
    assert unit_of(tuple[tuple[Metre, ...], ...]) == "m"
    assert unit_of(int) == "1"
