from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest
from posor.chain.beams_file import load_beams
from posor.errors import CalibrationError

if TYPE_CHECKING:
    from pathlib import Path

GOOD = """\
format: posor_beams
version: 2
name: one beam
provenance: {source: test, method: none, date: none}
beams:
  - joint: forearm
    uncertainty:
      position: {value: [1.0e-6, 1.0e-6, 2.0e-6], unit: m}
      orientation: {value: [1.0e-6, 1.0e-6, 1.0e-6], unit: rad}
    sag:
      tube:
        outer_diameter: {value: 0.05, unit: m}
        inner_diameter: {value: 0.04, unit: m}
        modulus: {value: 69.0e9, unit: Pa}
        density: {value: 2700, unit: kg/m^3}
      gimbals: {value: [0.1, 0.4], unit: m}
      plates:
        - {name: target, at: {value: 0, unit: m}, mass: {value: 1.2, unit: kg}}
      uncertainty: {value: 0.03, unit: "1"}
"""
TEMPERATURE = """\
    temperature:
      coefficient: {value: 23.0e-6, unit: 1/K}
      deviation: {value: 5.0, unit: K}
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
    with pytest.raises(CalibrationError) as caught:
        load_beams(path)
    key = "beams[0].sag.gimbals.value[1]"
    assert str(caught.value) == f"{path}, line 16, key {key}: '4 deg'; expected a number in 'm', 'mm' or 'um'."


def test_a_file_of_the_first_version_is_read_but_has_no_temperature(path: Path) -> None:
    former = GOOD.replace("version: 2", "version: 1")
    path.write_text(former, encoding="utf-8")
    assert load_beams(path).version == 1
    path.write_text(former + TEMPERATURE, encoding="utf-8")
    sentence = r"line 20, key beams\[0\].temperature: temperature in a file of version 1; expected version 2"
    with pytest.raises(CalibrationError, match=sentence):
        load_beams(path)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            "value: 0.04",
            "value: 0.05",
            "line 13, key beams[0].sag.tube.inner_diameter: inner_diameter 0.05 m; expected 0",
        ),
        (
            "69.0e9, unit: Pa",
            "69.0e9, unit: GPa",
            "line 14, key beams[0].sag.tube.modulus.unit: unit 'GPa'; expected 'Pa'",
        ),
        ("69.0e9", "-69.0e9", "beams[0].sag.tube.modulus: modulus -6.9e+10; expected more than 0"),
        ("[0.1, 0.4]", "[0.4, 0.1]", "gimbals [0.4, 0.1] m; expected two distances, the nearer one first"),
        ("[0.1, 0.4]", "[0.1]", "value has one number in a list; expected 2 numbers"),
        ("value: 1.2", "value: -1.2", "mass -1.2 kg; expected 0 kg or more"),
        ("value: 0.03", "value: -0.03", "uncertainty -0.03; expected 0 or more"),
        ("[1.0e-6, 1.0e-6, 2.0e-6]", "[1.0e-6, -1.0e-6, 2.0e-6]", "expected standard uncertainties, 0 or more"),
        ("23.0e-6", "-23.0e-6", "temperature.coefficient: coefficient -2.3e-05 1/K; expected an amount, 0 or more"),
        (
            "value: 5.0",
            "value: -5.0",
            "line 22, key beams[0].temperature.deviation: deviation -5 K; expected",
        ),
        ("value: 5.0", "value: .inf", "beams[0].temperature.deviation.value: inf is not finite"),
        ("23.0e-6", ".nan", "beams[0].temperature.coefficient.value: nan is not finite"),
        ("unit: 1/K", "unit: um/m/K", "unit 'um/m/K'; expected '1/K'"),
        (
            "version: 2",
            "version: 3",
            "key version: version 3; expected 1 or 2, or a later release of this software, which reads version 3",
        ),
        ("format: posor_beams", "format: posor_calibration", "expected 'posor_beams'"),
        ("    sag:", "    sagg:", "unknown key 'sagg'; expected perhaps 'sag'"),
    ],
)
def test_a_wrong_file_is_refused_with_its_line(path: Path, old: str, new: str, sentence: str) -> None:
    text = GOOD + TEMPERATURE
    assert text.count(old) >= 1
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(CalibrationError) as caught:
        load_beams(path)
    assert str(path) in str(caught.value)
    assert sentence in str(caught.value)


def test_a_duplicate_beam_is_refused(path: Path) -> None:
    path.write_text(GOOD + GOOD.partition("beams:\n")[2], encoding="utf-8")
    with pytest.raises(CalibrationError, match=r"line 20.*duplicate beam 'forearm'; expected each beam once"):
        load_beams(path)
