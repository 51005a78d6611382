# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Transform of a beam between two POSORs: simulated motions, a reference, and parallel axes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from posor.bags.recording import Recording, Track
from posor.calibration.designs import DesignName, design
from posor.errors import FitError, TrackError
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.native_coordinates import rotation_from_native
from posor.numerics.array_types import FloatArray, IntArray
from posor_calibration.procedure import Outcome
from posor_calibration.procedures.beam_transform import PROCEDURE, Transform, make_transform

from .simulated_case import check_coverage

SECOND, REFERENCE = "/second", "/tracker"
BASE, END = (0.3, -0.1, 0.2, 0.0, 0.0, 0.5), (0.0, 0.05, 0.1, 0.2, 0.0, 0.0)
ACROSS, PARALLEL = (0.6, 0.0, 0.05, 0.0, np.pi / 2, 0.0), (0.6, 0.0, 0.05, 0.0, 0.0, 0.0)
SIGMA_M, SIGMA_RAD = 2e-6, 3e-6
BEFORE_M, BEFORE_RAD = 2e-4, 1e-3
COUNT = 40
LIGHT_RING: DesignName = "triad_light_ring"


def drawn(random: np.random.Generator, leans: float, turn: float = np.pi) -> list[pin.SE3]:
    thetas = random.uniform(-turn, turn, COUNT)
    tilts = random.uniform(-leans, leans, (COUNT, 2))
    places = np.column_stack([random.uniform(-2e-4, 2e-4, (COUNT, 2)), np.full(COUNT, 0.7e-3)])
    turns = [rotation_from_native(a, b, t) for (a, b), t in zip(tilts, thetas, strict=True)]
    return [pin.SE3(turn, place) for turn, place in zip(turns, places, strict=True)]


def track(name: str, stamps: IntArray, poses: list[pin.SE3], random: np.random.Generator) -> Track:
    noise = np.tile([SIGMA_M] * 3 + [SIGMA_RAD] * 3, (COUNT, 1)) * random.normal(size=(COUNT, 6))
    values = np.array([pin.SE3ToXYZQUAT(pose * pin.exp6(off)) for pose, off in zip(poses, noise, strict=True)])
    sigmas = np.array([SIGMA_M] * 3 + [0.5 * SIGMA_RAD] * 4)
    return Track(stamps, values, sigmas, name)


def campaign(
    random: np.random.Generator,
    beam: Transform = ACROSS,
    mounting: float = 1.0,
    name: DesignName = LIGHT_RING,
    turn: float = np.pi,
) -> tuple[Recording, FloatArray]:
    """Return a recording and the true corrections of base, beam and end, (18,)."""
    corrections = np.tile([BEFORE_M] * 3 + [BEFORE_RAD] * 3, 3) * random.normal(size=18)
    corrections[:6] *= mounting
    corrections[12:] *= mounting
    drawings = zip((BASE, beam, END), corrections.reshape(3, 6), strict=True)
    true = [make_transform(six) * pin.exp6(off) for six, off in drawings]
    first, second = drawn(random, 5e-3, turn), drawn(random, 5e-3)
    seen = [true[0] * a * true[1] * c * true[2] for a, c in zip(first, second, strict=True)]
    stamps = (1 + np.arange(COUNT, dtype=np.int64)) * 100_000_000
    posor = Posor(design(name))
    rotations, translations = np.array([p.rotation for p in first]), np.array([p.translation for p in first])
    scans = scans_at(posor.stack, rotations, translations, stamps, noise=random)
    tracks = {SECOND: track(SECOND, stamps, second, random), REFERENCE: track(REFERENCE, stamps, seen, random)}
    return Recording(scans, tracks, "simulated"), corrections


def identify(recording: Recording, beam: Transform = ACROSS, name: DesignName = LIGHT_RING, **options: Any) -> Outcome:
    before = (BEFORE_M, BEFORE_RAD)
    given: dict[str, Any] = {"second": SECOND, "reference": REFERENCE, "beam": beam, "base": BASE, "end": END}
    given |= {"beam_known": before, "base_known": before, "end_known": before, **options}
    return PROCEDURE.identify(recording, design(name), PROCEDURE.options(**given))


@pytest.mark.long
def test_transform_is_found_and_intervals_cover(rng: np.random.Generator) -> None:
    errors = []
    for _ in range(25):
        recording, truth = campaign(rng)
        fit = identify(recording).fits["beam_transform"]
        errors.append((fit.values - truth) / fit.sigmas)
    check_coverage(errors, 0.04, 0.15)


def test_a_known_mounting_determines_the_whole_beam(rng: np.random.Generator) -> None:
    recording, truth = campaign(rng, mounting=0.01)
    known = (0.01 * BEFORE_M, 0.01 * BEFORE_RAD)
    outcome = identify(recording, base_known=known, end_known=known)
    fit = outcome.fits["beam_transform"]
    assert np.max(fit.sigmas[6:9]) < 0.05 * BEFORE_M
    assert np.max(fit.sigmas[9:12]) < 0.05 * BEFORE_RAD
    assert np.max(np.abs(fit.values - truth) / fit.sigmas) < 4.0
    rows = {str(row[0]): float(row[1]) for row in outcome.tables[0].rows}  # as in a URDF
    true = make_transform(ACROSS) * pin.exp6(truth[6:12])
    assert [rows[f"beam {axis}"] for axis in "xyz"] == pytest.approx(true.translation.tolist(), abs=3e-5)


def test_each_value_of_a_reference_counts_once(rng: np.random.Generator) -> None:
    single, _ = campaign(rng)
    scans = single.scans.select(np.repeat(np.arange(COUNT), 2))
    twice = replace(single, scans=scans.with_fields({"stamps_ns": scans.stamps_ns + np.tile([0, 10], COUNT)}))
    found, expected = (identify(each).fits["beam_transform"] for each in (twice, single))
    assert found.sigmas == pytest.approx(expected.sigmas, rel=1e-6)


def test_combinations_that_parallel_axes_leave_open_are_reported(rng: np.random.Generator) -> None:
    recording, _ = campaign(rng, PARALLEL)
    outcome = identify(recording, PARALLEL)
    fit = outcome.fits["beam_transform"]
    assert fit.sigma("beam z") > 0.4 * BEFORE_M
    assert any("hardly determine" in warning and "beam z" in warning for warning in outcome.warnings)


def test_bad_data(rng: np.random.Generator) -> None:
    recording, _ = campaign(rng)
    with pytest.raises(TrackError, match="there is no reference /third"):
        identify(recording, second="/third")
    uncounted, _ = campaign(rng, name="triad_bumpy_ring")
    with pytest.raises(FitError, match="no scan with a pose saw the home mark"):
        identify(uncounted, name="triad_bumpy_ring")
    slow, _ = campaign(rng, name="triad_bumpy_ring", turn=0.01)
    home = (np.arange(COUNT) == COUNT - 4).astype(np.int64)
    slow = replace(slow, scans=slow.scans.with_fields({"at_home": home}))  # the last four have a counted theta
    with pytest.raises(FitError, match="4 poses with a counted theta that both POSORs and the"):
        identify(slow, name="triad_bumpy_ring")
    few = replace(recording, scans=recording.scans.part(0, 4))
    with pytest.raises(FitError, match="4 poses with a counted theta that both POSORs and the"):
        identify(few)
    exact = {name: replace(one, sigmas=np.zeros(7)) for name, one in recording.tracks.items()}
    with pytest.raises(FitError, match="no uncertainty is known of /second and /tracker"):
        identify(replace(recording, tracks=exact))
    tracker = recording.tracks[REFERENCE]
    inches = replace(tracker, values=tracker.values * ([25.4] * 3 + [1.0] * 4))
    with pytest.raises(TrackError, match=r"^/tracker, x: moves 25\.\d* times as far as the present calibration says"):
        identify(replace(recording, tracks={**recording.tracks, REFERENCE: inches}))
