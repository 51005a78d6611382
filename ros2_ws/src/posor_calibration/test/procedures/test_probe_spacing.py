# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Spacing of gap probes: simulated angles, fixed parameters, and angles that do not serve."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from posor.errors import FitError
from posor.numerics.array_types import FloatArray
from posor_calibration.procedures.probe_spacing import PROCEDURE
from posor_lab.harness.simulated_recordings import diode_calibration, tilted_recording, with_tips, without_uncertainties
from scipy.stats import binomtest, chi2

from .simulated_case import SimulatedCase

TIPS = np.array([[-0.07635, 0.0, 0.0], [0.0, 0.03802, 0.0], [0.0, -0.03814, 0.0]])
TRUE = np.array([-0.07635, 0.03802, -0.03814])
GRID = np.linspace(-5e-3, 5e-3, 4)
ANGLES = np.array([(about_x, about_y) for about_x in GRID for about_y in GRID])


def simulate(seed: int = 0, angles: FloatArray = ANGLES, sigma: float = 3e-6) -> SimulatedCase:
    recording = tilted_recording(
        with_tips(diode_calibration(), TIPS), angles, np.random.default_rng(seed), scans_each=12, sigma=sigma
    )
    return SimulatedCase(PROCEDURE, without_uncertainties(diode_calibration()), recording)


@pytest.mark.long
def test_truth_lies_in_the_95_percent_intervals_of_95_percent_of_campaigns() -> None:
    inside, squares, freedoms = 0, 0.0, 0
    for seed in range(25):
        fit = simulate(seed).identify().fits["probe_spacing"]
        inside += int(np.sum(np.abs(fit.values[:3] - TRUE) < 1.96 * fit.sigmas[:3]))
        squares, freedoms = squares + fit.spread**2 * fit.freedoms, freedoms + fit.freedoms
    assert binomtest(inside, 75, 0.95).pvalue > 0.01
    assert 0.005 < chi2.sf(squares, freedoms) < 0.995


def test_free_height_takes_a_residual_of_each_stop_and_a_measured_one_is_a_reading() -> None:
    free, measured = (simulate().identify(**options).fits["probe_spacing"] for options in ({}, {"lift_sigma": 2e-5}))
    dwells, unknowns = len(ANGLES), 5  # three spacings, and the zeros of two probes against that of the first
    assert (free.freedoms, len(free.residuals)) == (2 * dwells - unknowns, 2 * dwells)
    assert (measured.freedoms, len(measured.residuals)) == (3 * dwells - unknowns, 3 * dwells)
    for fit in (free, measured):  # the heights scatter by 20 um
        assert 0.005 < fit.probability < 0.995
        assert np.all(np.abs(fit.values[:3] - TRUE) < 4.0 * fit.sigmas[:3])


def test_only_the_fitted_coordinates_of_the_tips_change() -> None:
    outcome = SimulatedCase(PROCEDURE, diode_calibration(), simulate().recording).identify()
    new = {one.key: one for one in outcome.replacements}
    assert list(new) == [f"sensors[0].probes[{probe}].tip" for probe in range(3)]
    for probe, (value, truth) in enumerate(zip(new.values(), TIPS, strict=True)):
        axis = int(np.argmax(np.abs(truth)))
        sigmas: Any = value.sigma
        assert abs(np.array(value.value)[axis] - TRUE[probe]) < 4.0 * sigmas[axis] < 2e-4
        assert [sigma for a, sigma in enumerate(sigmas) if a != axis] == [20e-6, 1e-6]
    # Fixed parameters that are correlated with them, such as the other coordinate of each tip, follow.
    assert outcome.covariances[0].entries[:3] == (
        "sensors[0].probes[0].tip[0]",
        "sensors[0].probes[1].tip[1]",
        "sensors[0].probes[2].tip[1]",
    )
    assert "sensors[0].probes[1].tip[0]" in outcome.covariances[0].entries
    assert np.all(
        outcome.fits["probe_spacing"].sigmas[:3] > 1.5 * simulate().identify().fits["probe_spacing"].sigmas[:3]
    )


def test_scale_of_the_angles_counts_for_all_spacings_alike() -> None:
    joint = simulate().identify(scale_sigma=1e-2).covariances[0].matrix
    np.testing.assert_allclose(np.sqrt(np.diag(joint)), 1e-2 * np.abs(TRUE), rtol=2e-2)


def test_angles_about_one_axis_do_not_determine_all_spacings() -> None:
    about_x = np.column_stack([np.linspace(-5e-3, 5e-3, 9), np.zeros(9)])
    sentence = r"^probe_spacing: the angles hardly determine gap_1.x, its standard"
    simulate(angles=about_x, sigma=0.0).check_refusal(FitError, sentence)
    fit = simulate(angles=about_x).identify(coordinates=("gap_2.y", "gap_3.y")).fits["probe_spacing"]
    assert np.all(np.abs(fit.values[:2] - TRUE[1:]) < 4.0 * fit.sigmas[:2])


def test_an_unknown_coordinate_is_refused() -> None:
    sentence = r"^probe_spacing: coordinate 'gap_4.x'; expected one of gap_1, gap_2, gap_3 with .x or .y after it\.$"
    simulate().check_refusal(FitError, sentence, coordinates=("gap_4.x",))


def test_a_dwell_that_does_not_fit_is_named_and_survived() -> None:
    displaced = simulate().with_readings("gap_voltages", lambda volts: volts + 0.2, np.s_[17 * 6 : 17 * 6 + 12, 1])
    outcome = displaced.identify()
    assert outcome.warnings[0] == "probe_spacing: left out dwell 7, which do not fit the others."
    fit = outcome.fits["probe_spacing"]
    assert np.all(np.abs(fit.values[:3] - TRUE) < 4.0 * fit.sigmas[:3])
