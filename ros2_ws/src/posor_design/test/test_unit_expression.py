# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Units of design calculators: amounts in SI units against published factors, dimensions."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import yaml
from posor_design.quantity_text import parse_unit, similar_units

PUBLISHED = yaml.safe_load(Path(__file__).with_name("published_units.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("text", "si", "factor"), PUBLISHED)
def test_amounts_are_the_published_ones(text: str, si: str, factor: float) -> None:
    unit, target = parse_unit(text), parse_unit(si)
    assert unit.powers == target.powers
    assert float(unit.factor / target.factor) == pytest.approx(float(factor), rel=5e-7)


@pytest.mark.parametrize(
    ("one", "other"), [("Hz", "rad/s"), ("lb", "lbf"), ("N m", "N m/rad"), ("m", "1"), ("N/m", "N m"), ("s", "1/s")]
)
def test_other_dimensions_are_distinguished(one: str, other: str) -> None:
    assert parse_unit(one).powers != parse_unit(other).powers


def test_radian_is_a_dimension() -> None:
    assert float(parse_unit("rev").factor) == pytest.approx(math.tau, rel=1e-15)
    assert parse_unit("rev/min").powers == parse_unit("rad/s").powers


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("furlong", "there is no unit 'furlong'"),
        ("kin", "there is no unit 'kin'"),
        ("m m^", r"'m m\^' is not a unit"),
        ("(m)", r"'\(m\)' is not a unit"),
        ("m^2s", r"'m\^2s' is not a unit"),
        ("m//s", "'m//s' is not a unit"),
    ],
)
def test_a_malformed_or_unknown_unit_is_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_unit(text)


def test_similar_units_have_the_same_dimension() -> None:
    assert {"in", "mm", "um", "uin", "ft"} <= set(similar_units("m"))
    assert similar_units("N") == ["lbf", "ozf"]
    assert similar_units("1") == ["%", "ppm"]
    assert similar_units("N m") == []
