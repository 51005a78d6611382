# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Numbers with a unit in a quantity: converted once, exactly as they are written."""

from __future__ import annotations

import math
from typing import Any

import pytest
import yaml
from posor.calibration.calibration_file import parse_calibration
from posor.calibration.designs import design
from posor.calibration.edit import edit_document
from posor.calibration.quantity import Quantity
from posor.calibration.yaml_document import StrictDumper
from pydantic import ValidationError


@pytest.mark.parametrize(
    ("written", "value", "sigma", "unit"),
    [
        ({"value": ["38.1 mm", 0.5, "5um"], "sigma": "50 um", "unit": "m"}, [0.0381, 0.5, 5e-6], 5e-5, "m"),
        ({"value": [38.1, "0.5 m", 0], "sigma": 0.05, "unit": "mm"}, [0.0381, 0.5, 0.0], 5e-5, "m"),
        ({"value": "-1e-3 mm", "sigma": ".5 um", "unit": "um"}, -1e-6, 5e-7, "m"),
        (
            {"value": [[0.5, "0.5 deg"]], "sigma": "1 deg", "unit": "rad"},
            [[0.5, math.radians(0.5)]],
            math.radians(1.0),
            "rad",
        ),
        ({"value": "3 V", "unit": "V"}, 3.0, 0.0, "V"),
        ({"value": "2700 kg/m^3", "sigma": "5 kg/m^3", "unit": "kg/m^3"}, 2700.0, 5.0, "kg/m^3"),
        ({"value": "23e-6 1/K", "unit": "1/K"}, 23e-6, 0.0, "1/K"),
    ],
)
def test_a_number_with_a_unit_is_converted_exactly(written: Any, value: Any, sigma: float, unit: str) -> None:
    assert Quantity.model_validate(written) == Quantity(value=value, sigma=sigma, unit=unit)


@pytest.mark.parametrize(
    "number", ["1e99999999999999999999 mm", "1e-99999999999999999999 mm", "\u0662 mm", "2e5", "23e-61/mm"]
)
def test_a_number_that_cannot_be_read_is_refused(number: object) -> None:
    for unit in ("mm", "1/mm"):
        with pytest.raises(ValidationError):
            Quantity.model_validate({"value": [number], "unit": unit})


@pytest.mark.parametrize("number", ["1e9999999 mm", "1e400 mm", 10**400])
def test_a_number_beyond_all_floats_is_refused(number: object) -> None:
    with pytest.raises(ValidationError, match="is not finite"):
        Quantity.model_validate({"value": [number], "unit": "mm"})


def test_the_file_keeps_what_is_written_and_the_calibration_is_the_same() -> None:
    content = design("triad_diodes").model_dump(mode="json", exclude_none=True)
    in_metres = yaml.dump(content, Dumper=StrictDumper, sort_keys=False)
    tip = content["sensors"][0]["probes"][1]["tip"]
    assert tip["value"][1] == 0.0381
    tip["value"][1] = "38.1 mm"
    text = yaml.dump(content, Dumper=StrictDumper, sort_keys=False)
    read, plain = parse_calibration(text, "here"), parse_calibration(in_metres, "here")
    assert read.content_hash == plain.content_hash
    assert "- 38.1 mm" in edit_document(text, "here", {"name": "another"})
