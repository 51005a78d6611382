# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Measuring beams: an independent finite-element solution, published closed forms, limits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.beam_entries import BeamFile
from posor.chain.measuring_beam import MeasuringBeam
from posor_design.beam_section import make_section
from posor_design.measuring_beams import beam_frequencies, beam_sag, sag_correction
from posor_lab.harness.beams import quantity

from .beam_elements import ElementBeam

INCH = 0.0254
FINITE_ELEMENTS = 1e-3  # relative
POISSON = 0.33
BEAM: dict[str, Any] = {
    "shape": "tube",
    "height": 2.0 * INCH,
    "wall": 0.125 * INCH,
    "length": 30.0 * INCH,
    "modulus": 73e9,
    "density": 2768.0,
    "gimbals": (6.0 * INCH, 24.0 * INCH),
}
PLATES: dict[str, Any] = {"plate_masses": (1.78, 1.78), "plate_inertias": (7.2e-3, 7.2e-3)}
UNEQUAL: dict[str, Any] = {"plate_masses": (0.9, 2.5), "plate_inertias": (2e-3, 9e-3)}
BOX: dict[str, Any] = {"shape": "box", "height": 3.0 * INCH, "width": 2.0 * INCH}
SLENDER: dict[str, Any] = {
    "shape": "tube",
    "height": 1e-3,
    "wall": 1e-4,
    "length": 1.0,
    "modulus": 200e9,
    "density": 7800.0,
    "gimbals": (0.0, 1.0),
}
ELASTIC: dict[str, Any] = {"gimbal_stiffness": (4e6, 2e5), "gimbal_turning_stiffness": (500.0, 9000.0)}
VARIANTS: dict[str, dict[str, Any]] = {
    "plates": PLATES,
    "no plates": {},
    "unequal": {**UNEQUAL, "gimbals": (3.0 * INCH, 20.0 * INCH)},
    "box": {**BOX, **PLATES},
    "gimbals at the ends": {**PLATES, "gimbals": (0.0, 30.0 * INCH)},
    "elastic": {**UNEQUAL, **ELASTIC},
}


def element_beam(values: dict[str, Any]) -> ElementBeam:
    section = make_section(values["shape"], values["height"], values.get("width", 0.0), values["wall"])
    shear_modulus = values["modulus"] / (2.0 * (1.0 + POISSON))
    beam = ElementBeam(
        values["length"],
        values["modulus"] * section.second_moment,
        section.shear_coefficient(POISSON) * shear_modulus * section.area,
        values["density"] * section.area,
        values["density"] * section.second_moment,
    )
    nothing = (0.0, 0.0)
    for at, mass, inertia in zip(
        (0.0, values["length"]), values.get("plate_masses", nothing), values.get("plate_inertias", nothing), strict=True
    ):
        beam.add(at, mass=mass, inertia=inertia)
    for at, turning in zip(values["gimbals"], values.get("gimbal_turning_stiffness", nothing), strict=True):
        beam.add(at, turning=turning)
    if "gimbal_stiffness" in values:
        for at, spring in zip(values["gimbals"], values["gimbal_stiffness"], strict=True):
            beam.add(at, spring=spring)
    else:
        beam.pin(*values["gimbals"])
    return beam


def slender_unit() -> float:
    """Frequency of a wave number of 1 over the length [rad/s]."""
    section = make_section("tube", SLENDER["height"], 0.0, SLENDER["wall"])
    return math.sqrt(SLENDER["modulus"] * section.second_moment / SLENDER["density"] / section.area)


@pytest.mark.parametrize("name", VARIANTS)
def test_frequencies_agree_with_finite_elements(name: str) -> None:
    values = {**BEAM, **VARIANTS[name]}
    found = beam_frequencies(**values, poisson_ratio=POISSON, modes=5)
    np.testing.assert_allclose(
        found.angular_frequencies, element_beam(values).frequencies(5), rtol=FINITE_ELEMENTS, atol=0.0
    )
    np.testing.assert_allclose(np.array(found.frequencies) * 2.0 * math.pi, found.angular_frequencies)


@pytest.mark.parametrize("name", VARIANTS)
@pytest.mark.parametrize("frequency", [0.0, 30.0, 110.0, 320.0])
def test_the_error_of_the_sag_correction_agrees_with_finite_elements(name: str, frequency: float) -> None:
    values = {**BEAM, **VARIANTS[name]}
    found = sag_correction(**values, poisson_ratio=POISSON, acceleration=2.0, frequency=frequency)
    motion = 2.0 * element_beam(values).response(2.0 * math.pi * frequency)
    static = beam_sag(
        **{key: value for key, value in values.items() if key not in {*ELASTIC, "plate_inertias"}}, specific_force=2.0
    )
    slope = motion[-1] - motion[1] - static.relative_slope
    deflection = motion[-2] - motion[0] - values["length"] * motion[1] - static.relative_deflection
    size = abs(static.relative_slope)
    assert found.slope_error == pytest.approx(abs(slope), rel=1e-2, abs=FINITE_ELEMENTS * size)
    assert found.deflection_error == pytest.approx(
        abs(deflection), rel=1e-2, abs=FINITE_ELEMENTS * size * values["length"]
    )


def test_a_slender_beam_on_pins_has_the_closed_form() -> None:
    """(n pi)^2: Meirovitch, Elements of Vibration Analysis (1975), 5.10."""
    found = beam_frequencies(**SLENDER, modes=5)
    closed = slender_unit() * (np.arange(1, 6) * math.pi) ** 2
    np.testing.assert_allclose(found.angular_frequencies, closed, rtol=1e-4)


def test_a_slender_beam_with_held_ends_has_the_closed_form() -> None:
    """4.7300, 7.8532, 10.9956: Blevins, Formulas for Natural Frequency and Mode Shape (1979), chapter 8."""
    stiff = 1e9 * SLENDER["modulus"] * 1e-14
    found = beam_frequencies(**SLENDER, gimbal_turning_stiffness=(stiff, stiff), modes=3)
    closed = slender_unit() * np.square([4.73004074, 7.85320462, 10.9956078])
    np.testing.assert_allclose(found.angular_frequencies, closed, rtol=1e-4)


def test_a_slender_beam_on_soft_gimbals_is_free() -> None:
    """The same numbers as with held ends, after two motions as a rigid body."""
    soft = 1e-5
    found = beam_frequencies(**SLENDER, gimbal_stiffness=(soft, soft), modes=4).angular_frequencies
    closed = slender_unit() * np.square([4.73004074, 7.85320462])
    np.testing.assert_allclose(found[2:], closed, rtol=1e-4)
    mass = SLENDER["density"] * make_section("tube", 1e-3, 0.0, 1e-4).area
    np.testing.assert_allclose(found[:2], [math.sqrt(2.0 * soft / mass), math.sqrt(6.0 * soft / mass)], rtol=1e-3)


def test_a_thick_beam_on_pins_has_timoshenkos_closed_form() -> None:
    """Sine waves: with wave number k, m (w^2)^2 J / S - w^2 (m + k^2 (J + m B / S)) + B k^4 = 0."""
    values = {**BEAM, "height": 0.2, "wall": 0.02, "gimbals": (0.0, BEAM["length"])}
    beam = element_beam(values)
    found = beam_frequencies(**values, poisson_ratio=POISSON, modes=3).angular_frequencies
    for number, frequency in enumerate(found, start=1):
        k = number * math.pi / values["length"]
        middle = beam.mass + k**2 * (beam.inertia + beam.mass * beam.bending / beam.shear)
        roots = np.roots([beam.mass * beam.inertia / beam.shear, -middle, beam.bending * k**4])
        assert frequency == pytest.approx(math.sqrt(roots.min()), rel=1e-8)


def test_mode_shapes_are_zero_at_the_gimbals_and_one_at_their_largest() -> None:
    found = beam_frequencies(**BEAM, **PLATES)
    shapes = np.array(found.shapes)
    np.testing.assert_allclose(np.abs(shapes).max(axis=1), 1.0)
    for gimbal in BEAM["gimbals"]:
        column = int(np.argmin(np.abs(np.array(found.positions) - gimbal)))
        assert found.positions[column] == pytest.approx(gimbal)
        assert not shapes[:, column].any()
    for shape, sign in zip(shapes, (1.0, -1.0, 1.0, -1.0), strict=True):
        np.testing.assert_allclose(shape, sign * shape[::-1], atol=1e-7)  # an equal beam from both ends


def test_sag_is_the_correction_that_the_chain_applies() -> None:
    inner = BEAM["height"] - 2.0 * BEAM["wall"]
    tube = {
        "outer_diameter": quantity(BEAM["height"], "m"),
        "inner_diameter": quantity(inner, "m"),
        "modulus": quantity(BEAM["modulus"], "Pa"),
        "density": quantity(BEAM["density"], "kg/m^3"),
    }
    places = zip((0.0, BEAM["length"]), UNEQUAL["plate_masses"], strict=True)
    entry = BeamFile.model_validate(
        {
            "joint": "beam",
            "uncertainty": {"position": quantity([0.0] * 3, "m"), "orientation": quantity([0.0] * 3, "rad")},
            "sag": {
                "tube": tube,
                "gimbals": quantity(list(BEAM["gimbals"]), "m"),
                "plates": [
                    {"name": f"{at}", "at": quantity(at, "m"), "mass": quantity(mass, "kg")} for at, mass in places
                ],
                "uncertainty": quantity(0.0, "1"),
            },
        }
    )
    chain_beam = MeasuringBeam(entry, pin.SE3(np.eye(3), np.array([BEAM["length"], 0.0, 0.0])))
    applied = chain_beam.sag_gain @ np.array([0.0, 0.0, -9.0])
    found = beam_sag(**BEAM, plate_masses=UNEQUAL["plate_masses"], specific_force=-9.0)
    np.testing.assert_allclose(applied, [0.0, 0.0, found.relative_deflection, 0.0, -found.relative_slope, 0.0])


def test_a_short_vibration_error_is_the_square_of_the_frequency_ratio() -> None:
    found = sag_correction(**BEAM, **PLATES, acceleration=1.0, frequency=5.0)
    assert found.slope_error / found.slope == pytest.approx((5.0 / found.first_frequency) ** 2, rel=0.1)
    doubled = sag_correction(**BEAM, **PLATES, acceleration=3.0, frequency=10.0)
    assert doubled.slope_error == pytest.approx(12.0 * found.slope_error, rel=0.01)


def test_at_rest_only_shear_is_left() -> None:
    """The slopes of a beam on two supports do not depend on shear; deflections of a beam with equal ends neither."""
    at_rest = sag_correction(**BEAM, **PLATES, acceleration=1.0, frequency=0.0)
    assert at_rest.slope_error < 1e-9 * at_rest.slope
    assert at_rest.deflection_error < 1e-9 * at_rest.deflection


def test_damping_bounds_the_error_at_resonance() -> None:
    first = beam_frequencies(**BEAM, **PLATES).frequencies[0]
    errors = [
        sag_correction(**BEAM, **PLATES, acceleration=1.0, frequency=first, loss_factor=loss).slope_error
        for loss in (0.01, 0.02)
    ]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.01)
    undamped = sag_correction(**BEAM, **PLATES, acceleration=1.0, frequency=first).slope_error
    assert undamped > 1e3 * errors[0]


def test_a_loss_factor_divides_the_static_sag_by_its_complex_stiffness() -> None:
    lossless = sag_correction(**BEAM, **PLATES, acceleration=1.0, frequency=0.0)
    with_shear = lossless.deflection + lossless.deflection_error
    for loss in (0.1, 0.5):
        found = sag_correction(**BEAM, **PLATES, acceleration=1.0, frequency=0.0, loss_factor=loss)
        expected = abs(with_shear / (1.0 + 1j * loss) - lossless.deflection)
        assert found.deflection_error == pytest.approx(expected, rel=1e-6)
