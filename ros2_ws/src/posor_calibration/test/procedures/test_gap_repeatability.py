# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Repeatability of gap probes: simulated drift, hysteresis and scatter over repeated runs."""

from __future__ import annotations

import numpy as np
import pytest
from posor.calibration.designs import STANDOFF
from posor.errors import FitError
from posor_calibration.procedures.gap_repeatability import DRIFT, HYSTERESIS, PROCEDURE, group_places
from posor_lab.harness.simulated_recordings import PERIOD_NS, diode_calibration, lifted_recording
from scipy.stats import binomtest

from .simulated_case import SimulatedCase

UP = np.linspace(-0.4e-3, 0.4e-3, 9)
THERE_AND_BACK = STANDOFF + np.tile(np.concatenate([UP, UP[::-1]]), 3)
SCANS = 15
DURATION_S = (len(THERE_AND_BACK) * (SCANS + 5)) * PERIOD_NS * 1e-9


def simulate(seed: int, *, drift: float = 0.0, hysteresis: float = 0.0) -> SimulatedCase:
    """Return runs with a drift [V] of the voltages over the recording, and a hysteresis [V]."""
    before = lifted_recording(diode_calibration(), THERE_AND_BACK, np.random.default_rng(seed), scans_each=SCANS)
    height = before.tracks["/reference"].values[:, 0]
    rising = np.sign(np.diff(height, prepend=height[0] - 1e-6))
    for n in np.flatnonzero(rising == 0.0):
        rising[n] = rising[n - 1]
    share = np.linspace(-0.5, 0.5, len(height))
    volts = before.scans.gap_voltages + (drift * share + 0.5 * hysteresis * rising)[:, None]
    scans = before.scans.with_fields({"gap_voltages": volts})
    return SimulatedCase(PROCEDURE, diode_calibration(), before).with_scans(scans)


@pytest.mark.long
def test_drift_and_hysteresis_lie_in_their_intervals() -> None:
    inside = trials = 0
    for seed in range(25):
        outcome = simulate(seed, drift=2e-3, hysteresis=1e-3).identify()
        for fit in outcome.fits.values():
            # About -118 um/V in the middle of the range.
            off = fit.value(DRIFT) * DURATION_S + 2e-3 * 118e-6, fit.value(HYSTERESIS) + 1e-3 * 118e-6
            sigmas = fit.sigma(DRIFT) * DURATION_S, fit.sigma(HYSTERESIS)
            inside += sum(abs(o) < 1.96 * s for o, s in zip(off, sigmas, strict=True))
            trials += 2
    assert binomtest(inside, trials, 0.95).pvalue > 0.01


def test_repeatability_is_the_scatter_of_the_visits() -> None:
    outcome = simulate(3).identify()
    table = outcome.tables[0]
    # 1 mV over 15 scans, at -118 um/V and more toward the ends.
    for row in table.rows:
        assert 0.7 < float(row[1]) / (1e-3 * 118.0 / np.sqrt(SCANS)) < 1.5
    noises = [new for new in outcome.replacements if new.key.endswith("noise")]
    assert len(noises) == 3
    assert all(abs(new.value - 1e-3) < 4.0 * new.sigma for new in noises)  # type: ignore[operator]


def test_scatter_from_visit_to_visit_adds_to_the_noise_of_a_scan() -> None:
    visits = np.repeat(5e-3 * np.random.default_rng(5).normal(size=len(THERE_AND_BACK)), SCANS + 5)
    outcome = simulate(4).with_readings("gap_voltages", lambda volts: volts + visits[:, None]).identify()
    for new in outcome.replacements:
        assert abs(new.value - np.hypot(1e-3, 5e-3)) < 4.0 * new.sigma  # type: ignore[operator]


def test_drift_becomes_the_uncertainty_of_the_zero_when_asked_for() -> None:
    outcome = simulate(6, drift=20e-3).identify(update_zero=True)
    zeros = [new for new in outcome.replacements if new.key.endswith("zero_shift")]
    assert [new.value for new in zeros] == [0.0, 0.0, 0.0]
    for new in zeros:
        assert abs(float(new.sigma) - 20e-3 / np.sqrt(12.0)) < 0.1 * 20e-3 / np.sqrt(12.0)  # type: ignore[arg-type]


def test_places_visited_once_are_refused() -> None:
    once = lifted_recording(diode_calibration(), STANDOFF + UP, np.random.default_rng(0), scans_each=SCANS)
    SimulatedCase(PROCEDURE, diode_calibration(), once).check_refusal(
        FitError,
        r"^simulated: each of the 9 places is visited once; "
        r"expected repeated visits of places within 5e-06 m \(option same\)\.$",
    )


def test_runs_from_one_side_only_have_no_hysteresis() -> None:
    lifts = STANDOFF + np.tile(UP, 3)
    recording = lifted_recording(diode_calibration(), lifts, np.random.default_rng(0), scans_each=SCANS)
    outcome = SimulatedCase(PROCEDURE, diode_calibration(), recording).identify()
    # Only the lowest place is approached from above, and always so.
    assert all(HYSTERESIS not in fit.names or fit.sigma(HYSTERESIS) > 0.0 for fit in outcome.fits.values())
    assert [DRIFT in fit.names for fit in outcome.fits.values()] == [True] * 3


def test_dwells_near_one_another_are_the_same_place() -> None:
    reference = np.array([[0.0], [1.0], [0.001], [1.002], [2.0], [-0.001]])
    assert group_places(reference, 0.01, "m", "simulated").tolist() == [0, 1, 0, 1, 2, 0]
