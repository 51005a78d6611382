# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Quantities as text: read with a unit, refused one by one, printed with a prefix."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from posor.errors import ParameterError
from posor_design.quantity_text import format_quantity, parse_quantity

TABLES = yaml.safe_load(Path(__file__).with_name("quantities.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("text", "si", "value"), TABLES["read"])
def test_a_quantity_is_read(text: str, si: str, value: float) -> None:
    assert parse_quantity(text, si, "--size") == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(("text", "si", "message"), TABLES["refused"])
def test_a_wrong_quantity_is_refused(text: str, si: str, message: str) -> None:
    with pytest.raises(ParameterError, match=re.escape(message)) as caught:
        parse_quantity(text, si, "--size")
    assert caught.value.where == "--size"
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(("text", "si", "examples"), TABLES["without_unit"])
def test_a_quantity_without_unit_is_refused_where_a_unit_is_required(text: str, si: str, examples: str) -> None:
    with pytest.raises(ParameterError, match=rf"^--size: '{text}'; expected a number with a unit, such as {examples}"):
        parse_quantity(text, si, "--size", unit_required=True)
    assert parse_quantity(f"{text} {si}", si, "--size", unit_required=True) == float(text)
    assert parse_quantity("2", "1", "--size", unit_required=True) == 2.0


@pytest.mark.parametrize(("value", "si", "text"), TABLES["printed"])
def test_a_quantity_is_printed_with_a_prefix(value: float, si: str, text: str) -> None:
    assert format_quantity(value, si) == text


@pytest.mark.parametrize(("value", "si"), [(1.2345e-5, "m"), (-7.31e10, "Pa"), (3.3e-9, "F"), (2e-4, "rad/s")])
def test_a_printed_quantity_reads_back(value: float, si: str) -> None:
    assert parse_quantity(format_quantity(value, si), si, "--size") == pytest.approx(value, rel=1e-4)
