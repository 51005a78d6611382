# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fixtures that the tests of several packages share."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from posor.numerics.array_types import FloatArray

GOLDEN_CASES = 100
SOURCES = Path(__file__).resolve().parent
RIG_CALIBRATIONS = SOURCES / "posor_bringup" / "config"
STEP = 1e-5  # step of central differences


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(1985)


@pytest.fixture(scope="session")
def golden_cases() -> list[dict[str, Any]]:
    """Ray-traced cases, see posor/test/data/README.md."""
    lines = (SOURCES / "posor" / "test" / "data" / "posor_cases.jsonl").read_text(encoding="utf-8").splitlines()
    assert len(lines) == GOLDEN_CASES
    return [json.loads(line) for line in lines]


@pytest.fixture(scope="session")
def rig_calibrations() -> dict[str, Path]:
    """The calibration files of the 1985 rig: ``printed`` and ``section84``."""
    return {name: RIG_CALIBRATIONS / f"slocum1985_{name}.yaml" for name in ("printed", "section84")}


@pytest.fixture
def random_rotation(rng: np.random.Generator) -> Callable[[], FloatArray]:
    """Return a function that draws rotations, uniform over all orientations."""

    def make() -> FloatArray:
        quaternion = pin.Quaternion(*rng.normal(size=4).tolist())
        quaternion.normalize()
        return np.array(quaternion.toRotationMatrix())

    return make


@pytest.fixture(scope="session")
def _content(rig_calibrations: dict[str, Path]) -> Any:
    return yaml.load(rig_calibrations["printed"].read_text(encoding="utf-8"), Loader=yaml.CSafeLoader)


@pytest.fixture
def content(_content: Any) -> dict[str, Any]:
    """Content of the rig's file ``printed`` as plain data, which the test may change."""
    return dict(copy.deepcopy(_content))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Path for a calibration file of a test."""
    return tmp_path / "rig.yaml"


@pytest.fixture(scope="session")
def central_difference() -> Callable[[Callable[[FloatArray], float], int], FloatArray]:
    """Return a function for d function(x)/dx at x = 0: fourth-order central differences, error near 1e-11."""

    def differentiate(function: Callable[[FloatArray], float], size: int) -> FloatArray:
        gradient = np.empty(size)
        for i, step in enumerate(STEP * np.eye(size)):
            near = function(step) - function(-step)
            far = function(2.0 * step) - function(-2.0 * step)
            gradient[i] = (8.0 * near - far) / (12.0 * STEP)
        return gradient

    return differentiate
