# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sensor types from entry points: packages as importlib.metadata finds them, sound and unsound."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from posor.errors import CalibrationError
from posor.sensors.registry import GROUP, sensor_types
from posor_lab.harness.case_tables import refusal

MODULE = """
from typing import Literal

from posor.sensors.base import SensorCalibration


class Sound(SensorCalibration):
    type: Literal["lever"]

    def build(self):
        raise RuntimeError


class Nameless(SensorCalibration):
    def build(self):
        raise RuntimeError


class Foreign:
    pass
"""


@pytest.fixture(autouse=True)
def _fresh() -> Iterator[None]:
    sensor_types.cache_clear()
    yield
    sensor_types.cache_clear()


def install(site: Path, package: str, entry_point: str, module: str = MODULE) -> None:
    (site / f"{package}.py").write_text(module, encoding="utf-8")
    info = site / f"{package}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(f"[{GROUP}]\n{entry_point}\n", encoding="utf-8")


def test_our_own_and_a_third_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "posor_lever", "lever = posor_lever:Sound")
    monkeypatch.syspath_prepend(str(tmp_path))
    found = sensor_types()
    assert set(found) == {"gap_probes", "diodes", "bumpy_ring", "lever"}
    assert found["lever"].__module__ == "posor_lever"


@pytest.mark.parametrize(
    ("entry_points", "module", "words"),
    [
        (
            ["lever = lever_a:Missing"],
            MODULE,
            "sensor type 'lever': lever_a:Missing cannot be loaded, module 'lever_a' has no attribute 'Missing'.",
        ),
        (["lever = lever_b:Sound"], "1 / 0\n", "lever_b:Sound cannot be loaded, division by zero."),
        (["lever = lever_c:Foreign"], MODULE, "is another class; expected a subclass of SensorCalibration."),
        (["arm = lever_d:Sound"], MODULE, "expected the field type: Literal['arm'] in the class."),
        (["lever = lever_e:Nameless"], MODULE, "does not declare its name"),
        (["lever = lever_f:Sound", "lever = lever_g:Sound"], MODULE, "is there twice, also as lever_"),
    ],
)
def test_an_unsound_package_is_named_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, entry_points: list[str], module: str, words: str
) -> None:
    for entry_point in entry_points:
        install(tmp_path, entry_point.split()[2].partition(":")[0], entry_point, module)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert words in str(refusal(CalibrationError, sensor_types))
