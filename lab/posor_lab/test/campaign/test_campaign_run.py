# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""One simulated campaign: drawn POSOR, recordings, procedures, comparison with the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import chebyshev
from posor.bags.recording import Recording
from posor.calibration.calibration_file import Calibration, calibration_from
from posor.calibration.parameter_entries import parameter_entries
from posor_lab.campaign import campaign_run
from posor_lab.campaign.campaign_report import CampaignReport
from posor_lab.campaign.campaign_run import calibrate_from_bags, record_bags, run_in_memory
from posor_lab.campaign.campaign_steps import INTERFEROMETER, CampaignStep, campaign_steps
from posor_lab.campaign.ground_truth import DRIFT, GroundTruth, as_built_calibration
from posor_lab.campaign.parameter_coverage import compare_with_truth, measuring_steps, parameter_family
from posor_lab.reports.findings import Verdict

SEED = 7


def test_true_parameters_differ_from_the_calibration_by_the_stated_uncertainties() -> None:
    entries = [
        entry
        for entry in parameter_entries(as_built_calibration("triad_bumpy_ring"))
        if entry is not None and entry.quantity.sigmas[entry.index] > 0.0 and "axis" not in entry.name
    ]
    values, sigmas = (
        np.array([getattr(entry.quantity, name)[entry.index] for entry in entries]) for name in ("array", "sigmas")
    )
    drawn = [GroundTruth.draw("triad_bumpy_ring", seed).true_values() for seed in range(25)]
    errors = (np.array([[truth[entry.name] for entry in entries] for truth in drawn]) - values) / sigmas
    assert errors.shape[1] > 50
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / errors.size))
    assert np.mean(errors) == pytest.approx(0.0, abs=5.0 / np.sqrt(errors.size))
    shifts = np.array([[truth[f"sensors[0].probes[{k}].zero_shift"] for k in range(3)] for truth in drawn])
    assert np.sqrt(np.mean(np.square(shifts))) == pytest.approx(DRIFT, rel=5.0 / np.sqrt(2.0 * shifts.size))


def test_equal_seeds_draw_equal_parameters() -> None:
    first, same, other = (GroundTruth.draw("triad_diodes", seed).true_values() for seed in (SEED, SEED, SEED + 1))
    assert first == same
    assert first != other


def test_a_step_records_the_same_for_the_same_seed_and_its_reference_errs_as_stated() -> None:
    step, truth = campaign_steps("triad_diodes")[0], GroundTruth.draw("triad_diodes", SEED)
    recording, same = step.record(truth), step.record(truth)
    assert np.array_equal(recording.scans.gap_voltages, same.scans.gap_voltages)
    track = recording.tracks["/reference"]
    assert track.sigmas.tolist() == [INTERFEROMETER]
    positions, counts = np.unique(track.values, return_counts=True)
    dwells = positions[counts > 1]
    assert len(dwells) == 25
    assert 0.5 * INTERFEROMETER < np.std(np.sort(dwells) - np.linspace(0.17e-3, 1.34e-3, 25)) < 1.6 * INTERFEROMETER


def test_bags_through_the_command_line_give_the_results_of_recordings_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gaps, *_, diode_map = campaign_steps("triad_diodes")[:4]
    steps = gaps, diode_map
    monkeypatch.setattr(campaign_run, "campaign_steps", lambda _: steps)
    truth = GroundTruth.draw("triad_diodes", SEED)
    progress: list[str] = []
    bags = record_bags(truth, tmp_path / "bags", lambda: progress.append("bag"))
    from_bags = calibrate_from_bags(truth, bags, tmp_path, lambda: progress.append("step"))
    assert progress == ["bag"] * 2 + ["step"] * 2
    for done, expected in zip(from_bags, run_in_memory(truth), strict=True):
        assert done.step.name == expected.step.name
        found, known = (compare_with_truth(truth, each.calibration) for each in (done, expected))
        assert [p.name for p in found] == [p.name for p in known]
        assert np.allclose([p.estimate for p in found], [p.estimate for p in known], rtol=1e-9, atol=1e-15)
        assert np.allclose([p.sigma for p in found], [p.sigma for p in known], rtol=1e-6)
        assert (tmp_path / f"{done.step.name}.txt").read_text(encoding="utf-8").strip()
    record = from_bags[0].calibration.fits[0]
    assert record.method == "polynomials through 25 dwells, order 4 as asked (thesis 7.5.1)"
    assert record.instruments[0].name == "interferometer"
    assert record.instruments[0].sigmas == [INTERFEROMETER]
    assert len(record.recording.sha256) == 64
    assert record.recording.name == "1_gaps"
    check_map_truth(truth, from_bags[-1].calibration)


def check_map_truth(truth: GroundTruth, calibration: Any) -> None:
    """Compare the true coefficients of the first map, in its own terms, with the surface of the sensor itself."""
    true_values = {p.name: p.truth for p in compare_with_truth(truth, calibration) if ".maps." in p.name}
    known: Any = truth.as_built.sensors[1]
    sensor: Any = truth.first_day.sensors[1]
    found = calibration.sensors[1]
    old, new = known.maps[known.map][0], found.maps[found.map][0]
    size = len(old.x.array)
    first = list(sensor.parameter_names).index("maps[0,0]")
    coefficients = sensor.parameter_values[first : first + size**2].reshape(size, size)
    converted = np.array(
        [
            [true_values.get(f"sensors[1].maps.{found.map}[0].x[{i}][{j}]", 0.0) for j in range(size)]
            for i in range(size)
        ]
    )
    assert np.count_nonzero(converted) == 10
    for ratios in ((-0.3, 0.2), (0.1, 0.4), (0.35, -0.35)):
        surfaces = []
        for spot_map, surface in ((new, converted), (old, coefficients)):
            domain = spot_map.domain.array
            x, y = ((r - d.mean()) / (0.5 * np.ptp(d)) for r, d in zip(ratios, domain, strict=True))
            surfaces.append(float(chebyshev.chebval2d(x, y, surface)))
        assert surfaces[0] == pytest.approx(surfaces[1], abs=1e-9)


def understate_uncertainty(step: CampaignStep) -> CampaignStep:
    """Return a step whose instrument is three times as noisy as it states."""

    def record(truth: GroundTruth) -> Recording:
        recording = step.record(truth)
        tracks = {key: replace(track, sigmas=track.sigmas / 3.0) for key, track in recording.tracks.items()}
        return replace(recording, tracks=tracks)

    return replace(step, record=record)


@pytest.mark.long
def test_an_instrument_noisier_than_stated_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    bundle = campaign_steps("triad_diodes")[-1]
    truth = GroundTruth.draw("triad_diodes", SEED)
    done = list(run_in_memory(truth))
    assert CampaignReport.evaluate(truth, done, None).findings.holds
    monkeypatch.setattr(campaign_run, "campaign_steps", lambda _: (understate_uncertainty(bundle),))
    wrong = list(run_in_memory(replace(truth, as_built=done[-2].calibration)))
    findings = CampaignReport.evaluate(truth, [*done[:-1], *wrong], None).findings
    assert not findings.holds
    (finding,) = (finding for finding in findings.findings if "least probable fit" in finding.quantity)
    assert finding.verdict is Verdict.FAILS
    assert finding.computed.endswith("9_bundle, bundle")


def test_a_parameter_is_measured_by_the_step_that_lowered_its_uncertainty_most() -> None:
    def known(tip: float, axis: float, shift: float) -> Calibration:
        content = as_built_calibration("triad_diodes").model_dump(mode="json", exclude_defaults=True)
        probe = content["sensors"][0]["probes"][0]
        probe["tip"]["sigma"] = [tip, tip, 1e-5]
        probe["axis"]["sigma"] = axis
        probe["zero_shift"]["sigma"] = shift
        return calibration_from(content)

    as_built = known(5e-5, 3e-3, 0.0)
    after = [known(5e-5, 3e-3, 0.0), known(1e-6, 2.99e-3, 1e-3), known(0.5e-6, 2.98e-3, 1e-4)]
    probe = "sensors[0].probes[0]"
    expected = {f"{probe}.tip[0]": 1, f"{probe}.tip[1]": 1, f"{probe}.zero_shift": 1}
    assert measuring_steps(as_built, after) == expected


@pytest.mark.parametrize(
    ("name", "family"),
    [
        ("sensors[0].probes[1].volts_to_gap[2]", "gap probe A_2"),
        ("sensors[0].probes[1].supply.sensitivity", "gap probe supply sensitivity"),
        ("sensors[1].probes[0].tip[0]", "ring probe tip"),
        ("sensors[1].maps.factory[0].x[1][1]", "diode map"),
        ("sensors[1].diodes[0].origin[2]", "diodes origin"),
        ("sensors[0].target_plane.tilt[0]", "target plane tilt"),
        ("sensors[1].ring.cos[3]", "ring cos"),
    ],
)
def test_parameter_families(name: str, family: str) -> None:
    assert parameter_family(name) == family
