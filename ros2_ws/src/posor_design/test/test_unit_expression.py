"""Units of design calculators: amounts in SI units against published factors, dimensions."""

from __future__ import annotations

import math

import pytest
from posor_design.unit_expression import parse_unit, similar_units


@pytest.mark.parametrize(
    ("text", "si", "factor"),  # factors of NIST SP 811, appendix B.8, as it prints them
    [
        ("in", "m", 2.54e-2),
        ("ft", "m", 3.048e-1),
        ("uin", "m", 2.54e-8),
        ("mil", "m", 2.54e-5),
        ("lbf", "N", 4.448222),
        ("lb/in^3", "kg/m^3", 2.767990e4),
        ("psi", "Pa", 6.894757e3),
        ("ksi", "Pa", 6.894757e6),
        ("in lbf", "N m", 1.129848e-1),
        ("in-lbf", "N m", 1.129848e-1),
        ("ozf*in", "N m", 7.061552e-3),
        ("lbf/in", "N/m", 1.751268e2),
        ("in^4", "m^4", 4.162314e-7),
        ("inHg", "Pa", 3.386389e3),
        ("rpm", "rad/s", 1.047198e-1),
        ("deg", "rad", 1.745329e-2),
        ("arcmin", "rad", 2.908882e-4),
        ("arcsec", "rad", 4.848137e-6),
        ("lb in^2", "kg m^2", 2.926397e-4),
        ("bar", "Pa", 1e5),
        ("Ohm", "V/A", 1.0),
        ("nF", "A s/V", 1e-9),
        ("%", "1", 1e-2),
        ("ppm/K", "1/K", 1e-6),
        ("kN/mm", "N/m", 1e6),
        ("J/kg/K", "m^2/s^2/K", 1.0),
        ("nV/Hz^0.5", "V s^0.5", 1e-9),
        ("µm", "m", 1e-6),
        ("min", "s", 60.0),
    ],
)
def test_amounts_are_the_published_ones(text: str, si: str, factor: float) -> None:
    unit, target = parse_unit(text), parse_unit(si)
    assert unit.powers == target.powers
    assert float(unit.factor / target.factor) == pytest.approx(factor, rel=5e-7)


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
