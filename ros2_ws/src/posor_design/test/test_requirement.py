"""Requirement files: units, standard from expanded uncertainty, and every refusal with what, where and expected."""

from __future__ import annotations

import copy
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml
from posor.errors import CalibrationError
from posor_design.posor_output import requirement_text
from posor_design.requirement import load_requirement

from .layout_examples import content, example

if TYPE_CHECKING:
    from pathlib import Path


def written(path: Path, document: Any) -> Path:
    path.write_text(yaml.dump(document, sort_keys=False), encoding="utf-8")
    return path


def test_units_are_converted_and_expanded_uncertainties_divided(tmp_path: Path) -> None:
    document = content()
    document["uncertainty"]["coverage_factor"] = 2.0
    requirement = load_requirement(written(tmp_path / "r.yaml", document))
    np.testing.assert_allclose(requirement.sigmas, [1e-6] * 3 + [10e-6] * 3)
    assert requirement.outside_diameter.number == 0.08
    assert requirement.rotation == pytest.approx(math.pi)
    assert requirement.fault == math.inf


def test_a_written_requirement_reads_back(tmp_path: Path) -> None:
    path = tmp_path / "r.yaml"
    path.write_text(requirement_text(example().changed(uncertainty={"theta": 3e-6})), encoding="utf-8")
    again = load_requirement(path)
    np.testing.assert_allclose(again.sigmas, [2e-6] * 3 + [20e-6, 20e-6, 3e-6])
    assert again.rotation == pytest.approx(example().rotation)
    assert again.range.gap == example().range.gap


@pytest.mark.parametrize(
    ("keys", "value", "sentence"),
    [
        (("uncertainty", "x", "value"), 0.0, "uncertainty.x.value: 0 m; expected more than 0"),
        (
            ("uncertainty", "theta", "unit"),
            "m",
            "uncertainty.theta.unit: unit 'm', 'mm' or 'um'; expected 'rad' or 'deg'",
        ),
        (("uncertainty", "coverage_factor"), -1.0, "uncertainty.coverage_factor: -1.0; expected more than 0"),
        (("range", "tilt", "value"), 0.5, "range.tilt.value: 0.5 rad; expected 0 to 0.1 rad"),
        (("range", "runout", "value"), -1.0, "range.runout.value: -0.001 m; expected 0 or more"),
        (("range", "rotation", "value"), 400.0, "range.rotation.value: 6.98132 rad; expected more than 0, at most pi"),
        (("inside_diameter",), {"value": 80, "unit": "mm"}, "inside_diameter.value: 0.08 m; expected less than 0.08 m"),
        (("scan_rate", "value"), 20_000.0, "scan_rate.value: 20000 Hz; expected more than 0, at most 10000"),
        (("scan_rate", "value"), 99.5, "scan_rate.value: 99.5 Hz; expected a whole number"),
        (("name",), "two words", "name: name 'two words'; expected a letter"),
        (("inner_diameter",), 1.0, "inner_diameter: unknown key 'inner_diameter'; expected perhaps 'inside_diameter'"),
    ],
)
def test_wrong_entries_are_refused(tmp_path: Path, keys: tuple[str, ...], value: Any, sentence: str) -> None:
    document = copy.deepcopy(content())
    part = document
    for key in keys[:-1]:
        part = part[key]
    part[keys[-1]] = value
    with pytest.raises(CalibrationError) as refusal:
        load_requirement(written(tmp_path / "r.yaml", document))
    assert f"key {sentence}" in str(refusal.value)
    assert str(refusal.value).startswith(f"{tmp_path / 'r.yaml'}, line ")
