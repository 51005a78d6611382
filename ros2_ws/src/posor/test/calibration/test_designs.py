# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""POSORs of any outside diameter: where their sensors are, what they resolve, how far they can be displaced."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from posor.calibration.calibration_file import Calibration, calibration_from
from posor.calibration.design_parts import ring_azimuths
from posor.calibration.designs import PROBE_ACCURACY, SMALLEST_DIAMETER, STANDOFF, SizedDesignName, sized_design
from posor.errors import CalibrationError
from posor.estimation.estimate import Estimates
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor.model.native_coordinates import rotation_from_native
from posor.sensors.bumpy_ring import BumpyRingCalibration
from posor_lab.harness.case_tables import refusal

INCH = 0.0254
DIAMETERS_IN = (4.0, 5.0, 6.0, 8.0, 10.5)
NAMES: tuple[SizedDesignName, ...] = ("triad_bumpy_ring", "triad_light_ring")
FRAMES = ("elbow_receiving", "elbow_target")


def made(name: SizedDesignName, diameter_in: float) -> Calibration:
    return sized_design(name, diameter_in * INCH, frames=FRAMES, title="elbow")


def located(posor: Posor, places: Sequence[tuple[float, ...]]) -> Estimates:
    """Locate noise-free scans at (x, y, gap, alpha, beta, theta), theta known to a bump."""
    rotations = np.array([rotation_from_native(*place[3:]) for place in places])
    translations = np.array([place[:3] for place in places])
    scans = scans_at(posor.stack, rotations, translations, np.arange(len(places), dtype=np.int64))
    return posor.estimate_each(scans, np.array([place[5] for place in places]))


@pytest.mark.parametrize("diameter_in", DIAMETERS_IN)
@pytest.mark.parametrize("name", NAMES)
def test_the_probes_form_an_equilateral_triangle_of_the_thesis_altitude(
    name: SizedDesignName, diameter_in: float
) -> None:
    content = made(name, diameter_in).model_dump()
    tips = np.array([probe["tip"]["value"] for probe in content["sensors"][0]["probes"]])
    sides = np.linalg.norm(tips - np.roll(tips, 1, axis=0), axis=1)
    np.testing.assert_allclose(sides * math.sqrt(0.75), 0.75 * (diameter_in - 1.0) * INCH, rtol=1e-12)
    np.testing.assert_allclose(tips.mean(axis=0), 0.0, atol=1e-15)
    ring = content["sensors"][1]
    if name == "triad_bumpy_ring":
        assert 2.0 * ring["ring"]["mean_radius"]["value"] == pytest.approx((diameter_in - 2.0) * INCH)
        assert len(ring["probes"]) == 4
        assert ring["ring"]["bumps"] % 4 == 0
    else:
        places = np.array([source["origin"]["value"][:2] for source in ring["light_sources"]])
        np.testing.assert_allclose(2.0 * np.linalg.norm(places, axis=1), (diameter_in - 2.0) * INCH, rtol=1e-12)


def test_frames_and_assumptions_are_named() -> None:
    calibration = made("triad_bumpy_ring", 6.0)
    assert (calibration.frames.parent, calibration.frames.child) == FRAMES
    assert sum(note.startswith("assumed: ") for note in calibration.provenance.notes) == 4


@pytest.mark.parametrize("diameter_in", DIAMETERS_IN)
def test_uncertainty_of_small_rotations_follows_from_the_altitude(diameter_in: float) -> None:
    """Section 9.3.1 has the probes' 5 microinch over the altitude; with all three probes' noise, sqrt(1.5) of it."""
    covariance = located(Posor(made("triad_bumpy_ring", diameter_in)), [(0, 0, STANDOFF, 0, 0, 0.1)]).covariances_random
    expected = math.sqrt(1.5) * PROBE_ACCURACY / (0.75 * (diameter_in - 1.0) * INCH)
    np.testing.assert_allclose(np.sqrt(np.diagonal(covariance[0])[3:5]), expected, rtol=0.02)


@pytest.mark.parametrize("diameter_in", DIAMETERS_IN)
def test_uncertainty_of_theta_is_nearly_that_of_the_thesis_at_every_phase(diameter_in: float) -> None:
    posor = Posor(made("triad_bumpy_ring", diameter_in))
    bump = posor.calibration.sensors[1].bump_angle
    places = [(0.0, 0.0, STANDOFF, 0.0, 0.0, float(theta)) for theta in np.linspace(0.0, bump, 21)]
    sigmas = np.sqrt(located(posor, places).covariances_random[:, 5, 5])
    thesis = PROBE_ACCURACY / (0.5 * (diameter_in - 2.0) * INCH)
    assert np.all(sigmas > 0.8 * thesis)
    assert np.all(sigmas < 1.2 * thesis)


@pytest.mark.long
@pytest.mark.parametrize("diameter_in", DIAMETERS_IN)
@pytest.mark.parametrize("name", NAMES)
def test_poses_are_recovered_all_around(name: SizedDesignName, diameter_in: float, rng: np.random.Generator) -> None:
    posor = Posor(made(name, diameter_in))
    places = [
        (*rng.uniform(-1e-4, 1e-4, 2), STANDOFF, *rng.uniform(-1e-3, 1e-3, 2), theta)
        for theta in rng.uniform(-math.pi, math.pi, 200)
    ]
    found = located(posor, places)
    assert np.all(found.states == State.OK)
    np.testing.assert_allclose(found.natives, places, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("diameter_in", DIAMETERS_IN)
def test_a_ring_tolerates_half_a_millimetre_in_every_direction(diameter_in: float) -> None:
    posor = Posor(made("triad_bumpy_ring", diameter_in))
    places = [
        (5e-4 * math.cos(at), 5e-4 * math.sin(at), STANDOFF + up, 0.0, 0.0, 0.0)
        for at in np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False)
        for up in (-5e-4, 0.0, 5e-4)
    ]
    found = located(posor, places)
    assert np.all(found.states == State.OK)
    np.testing.assert_allclose(found.translations, np.array(places)[:, :3], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("probes", [3, 4, 5, 6, 7, 8])
def test_ring_probes_are_well_phased_for_every_number_of_bumps(probes: int) -> None:
    for bumps in range(8, 220):
        azimuths = np.array(ring_azimuths(bumps, probes))
        phases = np.mod(azimuths * bumps / (2.0 * math.pi) + 1e-9, 1.0)
        expected = np.arange(probes) % (probes // 2) if probes % 4 == 0 else np.arange(probes) * ((probes - 1) // 2)
        np.testing.assert_allclose(phases, expected / probes % 1.0, atol=1e-6)
        assert abs(np.mean(np.exp(4j * math.pi * phases))) < 0.5
        spacing = np.abs(azimuths - 2.0 * math.pi * np.arange(probes) / probes)
        assert spacing.max() < 1.5 * 2.0 * math.pi / bumps


@pytest.mark.parametrize("diameter_in", DIAMETERS_IN)
def test_five_ring_probes_tell_displacement_from_theta_at_every_phase_though_one_is_missing(diameter_in: float) -> None:
    content = made("checked_bumpy_ring", diameter_in).model_dump(mode="json")
    ring = content["sensors"][1]
    phases = np.linspace(0.0, 2.0 * math.pi, 60)
    for missing in range(5):
        four = {**ring, "probes": [probe for n, probe in enumerate(ring["probes"]) if n != missing]}
        assert BumpyRingCalibration.model_validate(four).build().observability(phases).min() > 0.1


def test_ring_probes_in_phase_are_refused() -> None:
    content = made("checked_bumpy_ring", 8.0).model_dump(mode="json")
    ring = content["sensors"][1]
    for n, part in enumerate(ring["probes"]):  # evenly spaced, a fifth of a bump further each: in phase with 144 bumps
        azimuth = 2.0 * math.pi * n / 5 * (1.0 + 1.0 / 144)
        radius = math.hypot(*part["tip"]["value"][:2])
        part["tip"]["value"][:2] = [radius * math.cos(azimuth), radius * math.sin(azimuth)]
        part["axis"]["value"] = [-math.cos(azimuth), -math.sin(azimuth), 0.0]
    with pytest.raises(
        ValueError, match=r"with 144 bumps, the probes are at the phases 0\.00, .* 0\.00 .*all in phase"
    ):
        calibration_from(content)


@pytest.mark.parametrize("diameter", [0.0, -0.1, math.nan, 0.999 * SMALLEST_DIAMETER])
def test_a_diameter_that_is_too_small_is_refused(diameter: float) -> None:
    error = refusal(CalibrationError, sized_design, "triad_bumpy_ring", diameter, frames=FRAMES, title="elbow")
    assert (error.where, error.expected) == ("elbow", "at least 0.0762 m")
    assert error.what.startswith("outside diameter ")
