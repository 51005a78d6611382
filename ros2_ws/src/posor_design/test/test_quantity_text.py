"""Quantities as text: read with a unit, refused one by one, printed with a prefix."""

from __future__ import annotations

import pytest
from posor.errors import ParameterError
from posor_design.quantity_text import format_quantity, parse_quantity


@pytest.mark.parametrize(
    ("text", "si", "value"),
    [
        ("60 in", "m", 1.524),
        ("5/32 in", "m", 0.00396875),
        ("38.1mm", "m", 0.0381),
        ("-.5 um", "m", -5e-7),
        ("1e-3", "m", 1e-3),
        ("  2  ", "1", 2.0),
        ("30 %", "1", 0.3),
        ("1.5 in lbf/deg", "N m/rad", 1.5 * 0.0254 * 4.4482216152605 * 180.0 / 3.141592653589793),
    ],
)
def test_a_quantity_is_read(text: str, si: str, value: float) -> None:
    assert parse_quantity(text, si, "--size") == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "si", "message"),
    [
        ("", "m", r"'' is not a number with unit; expected a number in m \(mm,"),
        ("in", "m", "'in' is not a number with unit; expected a number in m"),
        ("nan", "m", "'nan' is not a number with unit"),
        ("inf m", "m", "'inf m' is not a number with unit"),
        ("1e400 m", "m", "'1e400 m' is too large"),
        ("1e9999 m", "m", "'1e9999 m' is too large"),
        ("5/0 in", "m", "is not a unit in '5/0 in'"),
        ("1,5 mm", "m", "is not a unit in '1,5 mm'"),
        ("3 furlong", "m", "there is no unit 'furlong' in '3 furlong'; expected a number in m"),
        ("3 lb", "N", r"'3 lb' has another dimension; expected a number in N \(lbf, ozf\)"),
        ("3 Hz", "rad/s", r"'3 Hz' has another dimension; expected a number in rad/s\."),
        ("3 m", "1", r"'3 m' has another dimension; expected a number \(%, ppm\)"),
    ],
)
def test_a_wrong_quantity_is_refused(text: str, si: str, message: str) -> None:
    with pytest.raises(ParameterError, match=message) as caught:
        parse_quantity(text, si, "--size")
    assert caught.value.where == "--size"
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(
    ("text", "si", "examples"),
    [
        ("80", "m", "'80 mm' or '80 um'"),
        ("5", "rad", "'5 urad' or '5 deg'"),
        ("1000", "Hz", "'1000 Hz'"),
        (" 2 ", "rad/s", "'2 rad/s'"),
    ],
)
def test_a_quantity_without_unit_is_refused_where_a_unit_is_required(text: str, si: str, examples: str) -> None:
    with pytest.raises(ParameterError, match=rf"^--size: '{text}'; expected a number with a unit, such as {examples}"):
        parse_quantity(text, si, "--size", unit_required=True)
    assert parse_quantity(f"{text} {si}", si, "--size", unit_required=True) == float(text)
    assert parse_quantity("2", "1", "--size", unit_required=True) == 2.0


@pytest.mark.parametrize(
    ("value", "si", "text"),
    [
        (2.54e-5, "m", "25.4 um"),
        (0.02, "m", "20 mm"),
        (1.524, "m", "1.524 m"),
        (12345.0, "m", "12345 m"),
        (0.9999999, "m", "1 m"),
        (999.9996, "N", "1 kN"),
        (73e9, "Pa", "73 GPa"),
        (5583.0, "rad/s", "5583 rad/s"),
        (2e6, "N/m", "2 MN/m"),
        (-2e-6, "rad", "-2 urad"),
        (1.8e-5, "Pa s", "18 uPa s"),
        (1e-7, "m^4", "1e-07 m^4"),
        (0.0, "m", "0 m"),
        (-0.0, "m", "0 m"),
        (5.4789e-13, "F", "547.89 fF"),
        (float("inf"), "m", "inf m"),
        (1e-16, "m", "1e-16 m"),
        (2700.0, "kg/m^3", "2700 kg/m^3"),
        (0.25, "1", "0.25"),
    ],
)
def test_a_quantity_is_printed_with_a_prefix(value: float, si: str, text: str) -> None:
    assert format_quantity(value, si) == text


@pytest.mark.parametrize(("value", "si"), [(1.2345e-5, "m"), (-7.31e10, "Pa"), (3.3e-9, "F"), (2e-4, "rad/s")])
def test_a_printed_quantity_reads_back(value: float, si: str) -> None:
    assert parse_quantity(format_quantity(value, si), si, "--size") == pytest.approx(value, rel=1e-4)
