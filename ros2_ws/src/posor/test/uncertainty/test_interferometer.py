# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Correction of an interferometer's reading: closed forms, figures of the thesis, Monte Carlo, refused input."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posor.errors import ParameterError
from posor.uncertainty.air_index import Air, index_sensitivities
from posor.uncertainty.interferometer import (
    NO_CHANGE,
    AbbeOffset,
    AirQuantities,
    Expansion,
    Input,
    Interferometer,
    Term,
    correct_reading,
)
from posor_lab.harness.case_tables import refusal

PAGE = Path(__file__).resolve().parents[5] / "docs" / "reference" / "reference_uncertainty.md"
INCH = 0.0254
MICROINCH = 1e-6 * INCH
ARC_SECOND = math.pi / 648000.0
LENGTH = 0.25
WAVELENGTH = 632.991e-9
ROOM = Air(293.15, 101325.0, 0.5)
INDEX = ROOM.index(WAVELENGTH)
EXACT = Interferometer(
    wavelength=Input(WAVELENGTH),
    assumed_index=INDEX,
    air=AirQuantities(Input(293.15), Input(101325.0), Input(0.5), Input(450e-6)),
    index_uncertainty=0.0,
)
FULL = Interferometer(  # all terms at once, their uncertainties of like size
    wavelength=Input(WAVELENGTH, 2e-8 * WAVELENGTH),
    assumed_index=1.0 / 0.9997300,
    air=AirQuantities(Input(293.15, 0.1), Input(101325.0, 40.0), Input(0.5, 0.05), Input(450e-6, 50e-6)),
    index_uncertainty=2e-8,
    air_change=AirQuantities(Input(0.3, 0.1), Input(400.0, 30.0), Input(0.02, 0.02), Input(0.0, 20e-6)),
    dead_path=Input(0.4, 0.005),
    misalignment=(Input(0.001, 0.0006), Input(0.0, 0.0008)),
    abbe_offsets=(
        AbbeOffset(Input(0.002, 0.001), Input(2e-5, 1e-5)),
        AbbeOffset(Input(0.001, 0.002), Input(0.0, 2e-5)),
    ),
    expansions=(Expansion(Input(0.2, 0.01), Input(10.8e-6, 1e-6), Input(0.05, 0.02)),),
)


def term(setup: Interferometer, name: str, reading: float = LENGTH) -> Term:
    (found,) = (part for part in correct_reading(setup, reading).terms if part.name == name)
    return found


def test_an_exact_setup_needs_no_correction() -> None:
    found = correct_reading(EXACT, LENGTH)
    assert found.correction == 0.0
    assert found.displacement == LENGTH
    assert found.standard_uncertainty == 0.0


def test_terms_add_up() -> None:
    found = correct_reading(FULL, LENGTH)
    assert len({part.name for part in found.terms}) == len(found.terms)
    assert all(part.standard_uncertainty > 0.0 for part in found.terms)
    assert found.displacement - found.reading == pytest.approx(sum(part.effect for part in found.terms), rel=1e-9)
    squares = sum(part.standard_uncertainty**2 for part in found.terms)
    assert found.standard_uncertainty == pytest.approx(math.sqrt(squares), rel=1e-12)


def test_index_of_air_scales_the_reading() -> None:
    """Thesis 7.2: compensation factors 0.9997300 and 0.9997350 differ by 5 microinches per inch."""
    wrong = replace(EXACT, assumed_index=INDEX + 1.0 / 0.9997300 - 1.0 / 0.9997350)
    assert term(wrong, "index of air", INCH).effect == pytest.approx(5.0 * MICROINCH, rel=1e-3)
    assert term(wrong, "index of air", -INCH).effect == pytest.approx(-5.0 * MICROINCH, rel=1e-3)


def test_uncertainties_of_air_and_wavelength_scale_the_length() -> None:
    sensitivities = index_sensitivities(WAVELENGTH, ROOM)
    names = ("air temperature", "air pressure", "relative humidity", "carbon dioxide")
    for name, sensitivity, quantity in zip(names, sensitivities, FULL.air.each, strict=True):
        expected = LENGTH * abs(sensitivity) * quantity.uncertainty
        assert term(FULL, name).standard_uncertainty == pytest.approx(expected, rel=1e-3)
    assert term(FULL, "index of air").standard_uncertainty == pytest.approx(2e-8 * LENGTH, rel=1e-3)
    assert term(FULL, "vacuum wavelength").standard_uncertainty == pytest.approx(2e-8 * LENGTH, rel=1e-3)


def test_dead_path_does_not_depend_on_the_displacement() -> None:
    """The air is 1 K warmer than at the zero: fewer wavelengths in the dead path, the reading too small."""
    sensitivity = index_sensitivities(WAVELENGTH, ROOM).temperature
    change = replace(NO_CHANGE, temperature=Input(1.0, 0.1))
    setup = replace(EXACT, air_change=change, dead_path=Input(0.4))
    for reading in (0.0, LENGTH, -LENGTH):
        found = term(setup, "dead path", reading)
        assert found.effect == pytest.approx(-0.4 * sensitivity, rel=0.01)
        assert found.standard_uncertainty == pytest.approx(0.4 * abs(sensitivity) * 0.1, rel=1e-3)
    assert found.effect > 0.3e-6


@pytest.mark.parametrize(
    ("angles", "length", "error"),
    [
        ((0.002, 0.0), INCH, 2.0 * MICROINCH),
        ((0.002, 0.002), INCH, 4.0 * MICROINCH),  # thesis 7.2: 0.002 inch per inch, 4 microinches per inch of travel
        ((0.0055, 0.0), 0.625 * INCH, 9.45 * MICROINCH),  # thesis 7.4: 9 microinches
    ],
)
def test_cosine_error_of_known_angles(angles: tuple[float, float], length: float, error: float) -> None:
    setup = replace(EXACT, misalignment=(Input(angles[0]), Input(angles[1])))
    found = term(setup, "cosine error", length)
    assert found.effect == pytest.approx(error, rel=1e-3)
    assert found.effect == pytest.approx(length * (1.0 / math.cos(math.hypot(*angles)) - 1.0), rel=1e-4)
    assert found.standard_uncertainty == 0.0


def test_cosine_error_of_an_unknown_angle_is_one_sided() -> None:
    """JCGM 100, F.2.4.4: expectation sigma^2 and variance sigma^4 for sigma in both planes."""
    setup = replace(EXACT, misalignment=(Input(0.0, 0.003), Input(0.0, 0.003)))
    for length in (LENGTH, -LENGTH):
        found = term(setup, "cosine error", length)
        assert found.effect == pytest.approx(length * 0.003**2, rel=1e-12)
        assert found.standard_uncertainty == pytest.approx(LENGTH * 0.003**2, rel=1e-12)


def test_abbe_error_is_offset_times_angle() -> None:
    """Thesis 7.4: 2 inches times 5 seconds of arc, 50 microinches."""
    lever = AbbeOffset(Input(2.0 * INCH), Input(5.0 * ARC_SECOND))
    effect = term(replace(EXACT, abbe_offsets=(lever,)), "Abbe offset").effect
    assert round(effect / MICROINCH, -1) == -50.0
    assert effect == pytest.approx(-1.23e-6, abs=0.005e-6)
    unknown = replace(EXACT, abbe_offsets=(AbbeOffset(Input(0.0, 0.01), Input(0.0, 3e-5)),))
    assert term(unknown, "Abbe offset").effect == 0.0
    assert term(unknown, "Abbe offset").standard_uncertainty == pytest.approx(3e-7, rel=1e-12)
    known = replace(EXACT, abbe_offsets=(AbbeOffset(Input(0.04, 0.01), Input(4e-5, 3e-5)),))
    expected = math.sqrt((0.04 * 3e-5) ** 2 + (4e-5 * 0.01) ** 2 + (0.01 * 3e-5) ** 2)
    assert term(known, "Abbe offset").standard_uncertainty == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("inches", "microinches"), [(0.5, 0.3), (2.0, 1.2), (10.0, 6.0)])
def test_thermal_expansion_of_the_cast_iron_stage(inches: float, microinches: float) -> None:
    """Thesis 7.2: 0.1 F between optics up to 0.5, 2 and 10 inches apart; the coefficient is 6 microinch/inch/F."""
    growth = Expansion(Input(inches * INCH), Input(6e-6 * 1.8), Input(0.1 / 1.8))
    setup = replace(EXACT, expansions=(growth,))
    assert term(setup, "thermal expansion").effect == pytest.approx(-microinches * MICROINCH, rel=1e-9)


def exact_displacement(setup: Interferometer, reading: float, draw: Callable[[Input], float]) -> float:
    """The displacement by the full equations, without any approximation of small effects."""
    now = [draw(quantity) for quantity in setup.air.each]
    before = [value - draw(change) for value, change in zip(now, setup.air_change.each, strict=True)]
    error, wavelength = draw(Input(0.0, setup.index_uncertainty)), draw(setup.wavelength)
    index, index_before = (Air(*state).index(setup.wavelength.value) + error for state in (now, before))
    path = reading * setup.assumed_index * wavelength / setup.wavelength.value  # N lambda / 2
    displacement = (path - (index - index_before) * draw(setup.dead_path)) / index
    displacement /= math.cos(math.hypot(*(draw(angle) for angle in setup.misalignment)))
    displacement -= math.fsum(draw(abbe.offset) * math.sin(draw(abbe.angle)) for abbe in setup.abbe_offsets)
    growths = ((draw(e.length), draw(e.coefficient), draw(e.temperature_change)) for e in setup.expansions)
    return displacement - math.fsum(length * coefficient * change for length, coefficient, change in growths)


def test_monte_carlo_confirms_correction_and_uncertainty() -> None:
    random, draws = np.random.default_rng(4), 10_000
    normal = iter(random.standard_normal(40 * draws).tolist())

    def draw(quantity: Input) -> float:
        return quantity.value + quantity.uncertainty * float(next(normal))

    found = correct_reading(FULL, LENGTH)
    drawn = np.array([exact_displacement(FULL, LENGTH, draw) for _ in range(draws)])
    assert drawn.mean() == pytest.approx(found.displacement, rel=0.0, abs=4.0 * found.standard_uncertainty / draws**0.5)
    assert drawn.std() == pytest.approx(found.standard_uncertainty, rel=0.03)


def test_values_without_uncertainty_give_the_exact_displacement() -> None:
    """The difference is of second order."""
    sure = replace(FULL, misalignment=(Input(0.001), Input(0.002)))
    exact = exact_displacement(sure, LENGTH, lambda quantity: quantity.value)
    assert correct_reading(sure, LENGTH).displacement == pytest.approx(exact, rel=0.0, abs=1e-11)


@pytest.mark.parametrize(
    ("whole", "changes", "sentence"),
    [
        (EXACT, {"assumed_index": 0.9997300}, "assumed_index: 0.99973; expected a value from 1 to 1.001."),
        (EXACT, {"index_uncertainty": -1e-8}, "index_uncertainty: standard uncertainty -1e-08"),
        (EXACT, {"dead_path": Input(math.nan)}, "dead_path: value nan; expected a finite number."),
        (EXACT, {"dead_path": Input(0.1, math.inf)}, "dead_path: standard uncertainty inf"),
        (EXACT, {"misalignment": (Input(0.0), Input(0.0, -1.0))}, "misalignment: standard uncertainty -1"),
        (EXACT, {"misalignment": (Input(0.05), Input(0.0))}, "misalignment: 0.05 rad; expected a value from"),
        (EXACT, {"misalignment": (Input(0.0, 0.05), Input(0.0))}, "misalignment, standard uncertainty: 0.05"),
        (EXACT, {"dead_path": Input(-0.05)}, "dead_path: -0.05 m; expected a value from 0 to 10 m."),
        (EXACT, {"dead_path": Input(0.05, 20.0)}, "dead_path, standard uncertainty: 20 m"),
        (FULL.abbe_offsets[0], {"angle": Input(math.inf)}, "angle: value inf"),
        (FULL.abbe_offsets[0], {"angle": Input(5.0)}, "angle: 5 rad; expected a value from -0.02 to 0.02 rad."),
        (FULL.abbe_offsets[0], {"offset": Input(20.0)}, "offset: 20 m; expected a value from -1 to 1 m."),
        (FULL.expansions[0], {"length": Input(250.0)}, "length: 250 m"),
        (FULL.expansions[0], {"coefficient": Input(10.8)}, "coefficient: 10.8 1/K"),
        (FULL.expansions[0], {"temperature_change": Input(293.0)}, "temperature_change: 293 K"),
        (FULL.expansions[0], {"length": Input(0.1, -1.0)}, "length: standard uncertainty -1"),
        (FULL.air, {"pressure": Input(math.nan)}, "pressure: value nan"),
    ],
)
def test_wrong_setups_are_refused(whole: Any, changes: dict[str, object], sentence: str) -> None:
    error = refusal(ParameterError, replace, whole, **changes)
    assert str(error).startswith(f"{type(whole).__name__}.{sentence}")


def test_wrong_readings_are_refused() -> None:
    assert refusal(ParameterError, correct_reading, EXACT, math.nan).where == "reading"
    celsius = replace(EXACT, air=replace(EXACT.air, temperature=Input(20.0)))
    assert refusal(ParameterError, correct_reading, celsius, LENGTH).where == "temperature of moist air"


def test_the_example_of_the_documentation_prints_what_the_page_shows(capsys: pytest.CaptureFixture[str]) -> None:
    page = PAGE.read_text(encoding="utf-8")
    example, shown = (re.findall(rf"```{kind}\n(.*?)```", page, re.DOTALL)[0] for kind in ("python", "text"))
    exec(example, {})  # noqa: S102  the repository's own page
    assert capsys.readouterr().out == shown
