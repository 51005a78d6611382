# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Zero-drift search: simulated truth, bad data, and the tests of 1985 from their recorded tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from posor.bags.recording import Recording, Track
from posor.calibration.calibration_file import load_calibration
from posor.calibration.designs import design
from posor.errors import FitError, TrackError
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.native_coordinates import rotation_from_native
from posor_calibration.procedures.zero_drift import PROCEDURE
from posor_lab.harness.simulated_recordings import without_uncertainties
from scipy.spatial.transform import Rotation

from .recordings_1985 import LEVER, recorded
from .simulated_case import SimulatedCase, check_coverage

TOPIC = "/truth"
STEP_NS = 100_000_000
SIGMA = 3e-6


def simulate(random: np.random.Generator, count: int = 40) -> SimulatedCase:
    """The target leans along a figure of eight; a pose reference watches it; all probes have drifted."""
    calibration = without_uncertainties(design("triad_diodes"))
    posor = Posor(calibration)
    shifts = 0.1 * random.normal(size=3)
    names = list(posor.stack.parameter_names)
    values = posor.stack.parameter_values
    values[[names.index(f"GapProbes.zero_shifts[{k}]") for k in range(3)]] = shifts
    phase = np.linspace(0.0, 2.0 * np.pi, count)
    leans = 4e-3 * np.column_stack([np.sin(phase), np.sin(2.0 * phase + 0.4)])
    rotations = np.array([rotation_from_native(a, b, 0.0) for a, b in leans])
    translations = np.tile([0.0, 0.0, 0.7e-3], (count, 1))
    stamps = (1 + np.arange(count, dtype=np.int64)) * STEP_NS
    truth = posor.stack.with_parameter_values(values)
    scans = scans_at(truth, rotations, translations, stamps, noise=random)
    said = Rotation.from_rotvec(SIGMA * random.normal(size=(count, 3))) * Rotation.from_matrix(rotations)
    poses = np.column_stack([translations, said.as_quat()])
    track = Track(stamps, poses, np.array([1e-6] * 3 + [0.5 * SIGMA] * 4), TOPIC)
    return SimulatedCase(PROCEDURE, calibration, Recording(scans, {TOPIC: track}, "simulated"), shifts)


@pytest.mark.long
def test_drift_is_found_and_intervals_cover(rng: np.random.Generator) -> None:
    normalised = []
    for _ in range(30):
        case = simulate(rng)
        fit = case.identify().fits["zero_drift"]
        normalised.append((fit.values[:3] - case.truth) / fit.sigmas[:3])
    check_coverage(normalised, 0.03, 0.12)


def test_a_reference_of_a_lower_rate_leaves_its_own_uncertainty(rng: np.random.Generator) -> None:
    whole = simulate(rng, 400)
    rare = whole.with_reference(stamps_ns=whole.reference.stamps_ns[::4], values=whole.reference.values[::4])
    at_its_values = rare.with_scans(rare.recording.scans.select(np.arange(0, 400, 4)))
    found, expected = (case.identify().fits["zero_drift"] for case in (rare, at_its_values))
    assert found.sigmas == pytest.approx(expected.sigmas, rel=1e-3)
    assert found.values == pytest.approx(expected.values, abs=0.05 * float(found.sigmas.min()))


def test_replacements(rng: np.random.Generator) -> None:
    case = simulate(rng)
    outcome = case.identify()
    assert [new.key for new in outcome.replacements] == [f"sensors[0].probes[{k}].zero_shift" for k in range(3)]
    found = np.array([new.value for new in outcome.replacements])
    assert found == pytest.approx(case.truth, abs=0.06)
    assert outcome.covariances[0].matrix == pytest.approx(outcome.fits["zero_drift"].covariance[:3, :3])
    before, after = (np.array([row[i] for row in outcome.tables[2].rows[:2]], dtype=float) for i in (1, 2))
    assert (after < before).all()


@pytest.mark.parametrize(
    ("count", "options", "probe"), [(6, {"expected_drift": 0.01}, "gap_"), (40, {"angles": ("alpha",)}, "gap_1")]
)
def test_shifts_that_the_motion_hardly_determines_are_named(
    count: int, options: dict[str, object], probe: str, rng: np.random.Generator
) -> None:
    warnings = simulate(rng, count).identify(**options).warnings
    assert any(sentence.startswith(f"The data hardly determine zero shift of {probe}") for sentence in warnings)


def with_rotations(case: SimulatedCase, rotations: Rotation) -> SimulatedCase:
    return case.with_values(lambda values: np.column_stack([values[:, :3], rotations.as_quat()]))


def test_bad_data(rng: np.random.Generator) -> None:
    case = simulate(rng)
    opposite = with_rotations(case, Rotation.from_quat(case.reference.values[:, 3:]).inv())
    opposite.check_refusal(TrackError, "alpha of the reference: turns opposite to the POSOR")
    late = case.with_reference(stamps_ns=case.reference.stamps_ns + 10**12)
    late.check_refusal(FitError, "0 scans while the reference was recorded")
    case.check_refusal(TrackError, r"no topic holds a point", lever=1.0)


def test_outliers_are_survived(rng: np.random.Generator) -> None:
    case = simulate(rng)
    kicks = np.zeros((40, 3))
    kicks[[7, 33]] = 400e-6  # 5 %
    turns = Rotation.from_quat(case.reference.values[:, 3:])
    outcome = with_rotations(case, Rotation.from_rotvec(kicks) * turns).identify(loss="soft_l1")
    fit = outcome.fits["zero_drift"]
    assert np.max(np.abs(fit.values[:3] - case.truth) / fit.sigmas[:3]) < 4.0
    words = "of 80 readings are outliers (alpha of scan 7, beta of scan 7,"
    assert any(words in sentence for sentence in outcome.warnings)


@pytest.mark.parametrize("test", ["ymo", "yzmo"])
def test_of_1985(rig_calibrations: dict[str, Path], test: str) -> None:
    case = SimulatedCase(PROCEDURE, load_calibration(rig_calibrations["section84"]), recorded(test))
    outcome = case.identify(lever=LEVER, session=test, first_sigma=0.0)
    # The file's own shifts are those of the thesis: the fitted ones leave less error.
    for row in outcome.tables[2].rows[:2]:
        assert float(row[2]) < float(row[1]), row
    (new,) = outcome.replacements
    assert new.key == f"sessions.{test}.zero_shifts"
    assert np.abs(outcome.fits["zero_drift"].correlations[:3, :3]).min() > 0.5
