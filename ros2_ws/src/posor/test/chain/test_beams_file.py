# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from pathlib import Path

import pytest
from posor.chain.beams_file import load_beams
from posor.errors import CalibrationError
from posor_lab.harness.case_tables import cases, edited, refusal

GOOD = Path(__file__).with_name("one_beam.yaml").read_text(encoding="utf-8")
TEMPERATURE = """\
    temperature:
      coefficient: {value: 23.0e-6, unit: 1/K}
      deviation: {value: 5.0, unit: K}
"""
SHARED = """\
shared:
  heat:
    uncertainty: {value: 0.5, unit: K}
    relative: {forearm.position: {value: 23.0e-6, unit: 1/K}, forearm.sag: {value: 0.1, unit: 1/K}}
    change: {forearm.orientation: {value: [1.0e-6, 0, 0], unit: rad/K}}
"""
THERMOMETER = """\
      spread: {value: 2.0, unit: K}
      gradient: {along: {value: 0.1, unit: K}, across: {value: 0.02, unit: K}}
      thermometer:
        name: forearm_skin
        reference: {value: 293.15, unit: K}
        uncertainty: {value: 0.05, unit: K}    # reading
        range: {value: [280, 310], unit: K}
        rate: {value: 0.01, unit: K/s}
        age: {value: 10, unit: s}
        # neighbour
shared:
  shop: {uncertainty: {value: 5, unit: K}, change: {forearm.temperature: {value: 1, unit: "1"}}}
  scale: {uncertainty: {value: 1, unit: K}, change: {forearm.thermometer: {value: 1, unit: "1"}}}
  alloy: {uncertainty: {value: 0.01, unit: "1"}, relative: {forearm.coefficient: {value: 1.0, unit: "1"}}}
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "beams.yaml"


def test_a_good_file_is_read(path: Path) -> None:
    path.write_text(GOOD, encoding="utf-8")
    said = load_beams(path)
    assert said.gravity.value == [0.0, 0.0, -9.80665]
    assert said.beams[0].sag is not None
    assert said.beams[0].sag.plates[0].mass.number == 1.2
    assert said.beams[0].temperature is None
    path.write_text(GOOD + TEMPERATURE, encoding="utf-8")
    temperature = load_beams(path).beams[0].temperature
    assert temperature is not None
    assert (temperature.coefficient.number, temperature.deviation.number) == (23e-6, 5.0)


def test_lengths_in_mm_and_angles_in_deg_are_converted(path: Path) -> None:
    text = GOOD.replace("gimbals: {value: [0.1, 0.4], unit: m}", "gimbals: {value: [100 mm, 0.4], unit: m}")
    text = text.replace(
        "position: {value: [1.0e-6, 1.0e-6, 2.0e-6], unit: m}", "position: {value: [1, 1, 2], unit: um}"
    )
    path.write_text(text.replace("[1.0e-6, 1.0e-6, 1.0e-6], unit: rad", "[0.5 deg, 0, 0], unit: rad"), encoding="utf-8")
    plain = path.with_name("plain.yaml")
    plain.write_text(GOOD.replace("[1.0e-6, 1.0e-6, 1.0e-6]", f"[{math.radians(0.5)}, 0, 0]"), encoding="utf-8")
    assert load_beams(path).model_dump() == load_beams(plain).model_dump()
    path.write_text(GOOD.replace("[0.1, 0.4], unit: m", "[0.1, 4 deg], unit: m"), encoding="utf-8")
    where = f"{path}, line 16, key beams[0].sag.gimbals.value[1]"
    assert refusal(CalibrationError, load_beams, path).where == where


def test_a_file_of_the_first_version_is_read_but_has_no_temperature(path: Path) -> None:
    former = GOOD.replace("version: 2", "version: 1")
    path.write_text(former, encoding="utf-8")
    assert load_beams(path).version == 1
    path.write_text(former + TEMPERATURE, encoding="utf-8")
    error = refusal(CalibrationError, load_beams, path)
    assert error.where == f"{path}, line 20, key beams[0].temperature"
    assert (error.what, error.expected) == ("temperature in a file of version 1", "version 2")


@pytest.mark.parametrize(**cases(__file__, "thermometer_mistakes.yaml"))
def test_a_wrong_thermometer_is_refused(path: Path, old: str, new: str, sentence: str) -> None:
    good = GOOD.replace("version: 2", "version: 3") + TEMPERATURE + THERMOMETER
    path.write_text(good, encoding="utf-8")
    assert load_beams(path).beams[0].thermometer is not None
    path.write_text(edited(good, old, new), encoding="utf-8")
    assert sentence in str(refusal(CalibrationError, load_beams, path))


def test_a_name_of_two_thermometers_and_a_gradient_without_a_width_are_refused(path: Path) -> None:
    good = GOOD.replace("version: 2", "version: 3") + TEMPERATURE + THERMOMETER
    beams = good.partition("beams:\n")[2].partition("shared:")[0]
    path.write_text(good.replace("shared:", beams.replace("joint: forearm", "joint: wrist") + "shared:"), "utf-8")
    assert "two thermometers have the name 'forearm_skin'" in str(refusal(CalibrationError, load_beams, path))
    rigid = good.replace(good[good.index("    sag:") : good.index("    temperature:")], "")
    path.write_text(rigid, encoding="utf-8")
    assert "'across' without 'width'; expected 'width'" in str(refusal(CalibrationError, load_beams, path))


@pytest.mark.parametrize(**cases(__file__, "beams_mistakes.yaml"))
def test_a_wrong_file_is_refused_with_its_line(path: Path, old: str, new: str, sentence: str) -> None:
    path.write_text(edited(GOOD + TEMPERATURE + SHARED, old, new), encoding="utf-8")
    error = refusal(CalibrationError, load_beams, path)
    assert error.where.startswith(str(path))
    assert sentence in str(error)


def test_a_duplicate_beam_is_refused(path: Path) -> None:
    path.write_text(GOOD + GOOD.partition("beams:\n")[2], encoding="utf-8")
    error = refusal(CalibrationError, load_beams, path)
    assert error.where.startswith(f"{path}, line 20")
    assert (error.what, error.expected) == ("duplicate beam 'forearm'", "each beam once")
