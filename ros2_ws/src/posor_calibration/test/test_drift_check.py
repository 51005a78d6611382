# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Drift check: drifts of a valid calibration, a parameter that has drifted, and a contradiction."""

from __future__ import annotations

from typing import Any

import pytest
from posor.calibration.calibration_file import Calibration
from posor.calibration.quantity import Quantity
from posor.errors import FitError
from posor_calibration.drift_check import check_drift
from posor_calibration.procedures.bundle import BundleOptions
from posor_lab.harness.drawn_posor import DrawnPosor, pose_track
from scipy.stats import kstest


def with_shift(calibration: Calibration, shift: float) -> Calibration:
    gap: Any = calibration.sensors[0]
    probe = gap.probes[1]
    moved = Quantity(value=probe.zero_shift.number + shift, sigma=probe.zero_shift.sigma, unit="V")
    probes = [*gap.probes[:1], probe.model_copy(update={"zero_shift": moved}), *gap.probes[2:]]
    sensors = [gap.model_copy(update={"probes": probes}), *calibration.sensors[1:]]
    return calibration.model_copy(update={"sensors": sensors})


@pytest.mark.long
def test_drifts_of_a_calibration_that_holds_are_standard_normal() -> None:
    drifts, alarms = [], 0
    for seed in range(8):
        campaign = DrawnPosor("triad_diodes", 40, 100 + seed)
        found = check_drift(campaign.recording(), campaign.calibration, BundleOptions())
        drifts.extend(list(found.drifts.values())[::5])
        alarms += not found.explains
        assert found.noise_ratio > 1.5  # the rest is the calibration's own uncertainty
        assert f"'triad_diodes' {'explains' if found.explains else 'does not explain'} bench" in found.verdict
    assert alarms == 0
    assert kstest(drifts, "norm").pvalue > 1e-3


def test_a_parameter_that_has_drifted_is_named() -> None:
    campaign = DrawnPosor("triad_diodes", 60, 71, drawn=0.3)
    found = check_drift(campaign.recording(), with_shift(campaign.calibration, 0.1), BundleOptions())
    assert not found.explains
    assert "does not explain" in found.verdict
    assert "sensors[0].probes[1]" in str(found.table.rows[0][0])
    assert found.drifts["sensors[0].probes[1].zero_shift"] < -found.limit


def test_a_recording_without_a_reference_shows_a_contradiction() -> None:
    campaign = DrawnPosor("triad_diodes", 120, 72, drawn=0.3)
    assert check_drift(campaign.recording(tracks={}), campaign.calibration, BundleOptions()).explains
    currents = campaign.scans.diode_currents.copy()
    currents[:, 1, 1] *= 1.005  # dirt on one contact
    campaign.scans = campaign.scans.with_fields({"diode_currents": currents})
    assert not check_drift(campaign.recording(tracks={}), campaign.calibration, BundleOptions()).explains


def test_a_comparison_below_the_noise_is_refused() -> None:
    campaign = DrawnPosor("triad_diodes", 40, 73, drawn=0.0)
    coarse = pose_track(campaign.measured, campaign.scans.stamps_ns, sigmas=(1e-2, 1e-1))
    options = BundleOptions(parameters=("sensors[0].probes[*].tip",))
    with pytest.raises(FitError, match=r"the comparison is below the noise: not even sensors.*tip") as caught:
        check_drift(campaign.recording(tracks={"/reference": coarse}), campaign.calibration, options)
    assert caught.value.expected == "more poses, or a pose reference that is more accurate"
    fine = check_drift(campaign.recording(), campaign.calibration, options)
    assert fine.explains
    assert fine.below_noise < 3


def test_a_contradiction_is_reported_whatever_the_noise() -> None:
    campaign = DrawnPosor("triad_diodes", 40, 73, drawn=0.3)
    coarse = pose_track(campaign.measured, campaign.scans.stamps_ns, sigmas=(1e-4, 1e-3))
    options = BundleOptions(parameters=("sensors[0].probes[*].zero_shift",))
    recording = campaign.recording(tracks={"/reference": coarse})
    assert not check_drift(recording, with_shift(campaign.calibration, 3.0), options).explains
