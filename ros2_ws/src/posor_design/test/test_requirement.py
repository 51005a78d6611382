# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Requirement files: units, standard from expanded uncertainty, and every refusal with what, where and expected."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from posor.errors import CalibrationError
from posor_design.posor_output import requirement_text
from posor_design.requirement import load_requirement

from .layout_examples import content, example


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


REFUSALS = yaml.safe_load(Path(__file__).with_name("requirement_refusals.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("key", "value", "sentence"), REFUSALS)
def test_wrong_entries_are_refused(tmp_path: Path, key: str, value: Any, sentence: str) -> None:
    document = copy.deepcopy(content())
    part = document
    *parents, last = key.split(".")
    for parent in parents:
        part = part[parent]
    part[last] = value
    with pytest.raises(CalibrationError) as refusal:
        load_requirement(written(tmp_path / "r.yaml", document))
    assert f"key {sentence}" in str(refusal.value).replace(" (and 1 more)", "")
    assert str(refusal.value).startswith(f"{tmp_path / 'r.yaml'}, line ")
