# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Inclination of the light sources: simulated travel along Z of a stage that is not square, with and without a turn."""

from __future__ import annotations

import numpy as np
import pytest
from posor.bags.recording import POINT, Recording, Track
from posor.calibration.designs import design
from posor.errors import FitError
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.native_coordinates import rotation_from_native
from posor_calibration.procedures.light_sources import PROCEDURE
from scipy.spatial.transform import Rotation

from .simulated_case import SimulatedCase, check_coverage

TOPIC = "/stage"
PER_DWELL = 12
STEP_NS = 20_000_000
SIGMA = 0.3e-6
FACING, TURN = np.radians(-151.3), np.radians(-120.0)
"""Where a source stands over the middle of the second diode, and the turn that brings it to the first one [rad]."""
LEAN = 2e-3  # spread of the true leans of the rays [rad]
STAGE_LEAN = np.array([1.5e-3, -0.8e-3])


def simulate(random: np.random.Generator, thetas: tuple[float, ...] = (FACING, FACING + TURN)) -> SimulatedCase:
    calibration = design("triad_light_ring")
    stack = Posor(calibration).stack
    names, values = list(stack.parameter_names), stack.parameter_values
    truth = {}
    for source in range(36):
        where = [names.index(f"Diodes.source_directions[{source},{i}]") for i in range(3)]
        leaning = values[where] + [*(LEAN * random.normal(size=2)), 0.0]
        values[where] = truth[source] = leaning / np.linalg.norm(leaning)
    heights = np.linspace(0.0, 12e-3, 7)
    dwells = [(theta, height) for theta in thetas for height in heights]
    said = np.array([[0.0, 0.0, height] for _, height in dwells])
    seats = {theta: 100e-6 * random.normal(size=2) for theta in thetas}
    true = [[*(seats[theta] + STAGE_LEAN * height + SIGMA * random.normal(size=2)), height] for theta, height in dwells]
    rotations = np.array([rotation_from_native(0.0, 0.0, theta) for theta, _ in dwells])
    stamps = (1 + np.arange(len(dwells) * PER_DWELL, dtype=np.int64)) * STEP_NS
    scans = scans_at(
        stack.with_parameter_values(values),
        np.repeat(rotations, PER_DWELL, axis=0),
        np.repeat(np.array(true), PER_DWELL, axis=0),
        stamps,
        noise=random,
    )
    poses = np.column_stack([said, Rotation.from_matrix(rotations).as_quat()])
    track = Track(stamps, np.repeat(poses, PER_DWELL, axis=0), np.array([SIGMA] * 3 + [1e-4] * 4), TOPIC)
    return SimulatedCase(PROCEDURE, calibration, Recording(scans, {TOPIC: track}, "simulated"), truth)


def source_of(key: str) -> int:
    return int(key.split("[")[2].split("]", maxsplit=1)[0])


@pytest.mark.long
def test_reversal_separates_rays_from_the_stage_and_intervals_cover(rng: np.random.Generator) -> None:
    normalised = []
    for _ in range(30):
        case = simulate(rng)
        outcome = case.identify(expected_lean=LEAN)
        for new in outcome.replacements:
            errors = np.array(new.value)[:2] - case.truth[source_of(new.key)][:2]
            normalised.append(errors / np.array(new.sigma)[:2])
        fit = outcome.fits["light_sources"]
        assert fit.value("lean of the stage along X") == pytest.approx(STAGE_LEAN[0], abs=5.0 * fit.sigmas[0])
    assert len(outcome.replacements) == 3  # one source is seen by both diodes
    check_coverage(normalised, 0.05, 0.3)  # the reference states an uncertainty of its angles that is not simulated


def test_without_a_reversal_the_stage_must_be_known(rng: np.random.Generator) -> None:
    case = simulate(rng, thetas=(FACING,))
    case.check_refusal(FitError, "the target was not turned, so the leans of rays and stage cannot be separated")
    outcome = case.identify(stage_sigma=2e-3)
    assert outcome.fits["light_sources"].sigmas[0] == pytest.approx(2e-3, rel=0.05)  # no better than the stage
    assert any("strongly correlated" in sentence for sentence in outcome.warnings)
    assert len(outcome.replacements) == 2
    for new in outcome.replacements:
        assert np.array(new.value)[:2] == pytest.approx(case.truth[source_of(new.key)][:2], abs=6e-3)


def test_a_point_is_enough_where_nothing_turns(rng: np.random.Generator) -> None:
    case = simulate(rng, thetas=(FACING,))
    track = case.reference
    case = case.with_reference(values=track.values[:, :POINT], sigmas=track.sigmas[:POINT])
    assert case.identify(stage_sigma=1e-5).fits["light_sources"].freedoms > 0


def test_sources_that_only_one_diode_sees_are_not_separated_from_the_stage(rng: np.random.Generator) -> None:
    other_sources = simulate(rng, thetas=(FACING, FACING + np.radians(60.0)))
    other_sources.check_refusal(FitError, r"the readings do not separate .*lean of the stage along ")
