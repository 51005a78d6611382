# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Noise of diodes and ring probes from simulated visits of the same places."""

from __future__ import annotations

import numpy as np
import pytest
from posor.bags.recording import Recording, Track
from posor.calibration.designs import STANDOFF, DesignName, design
from posor.errors import FitError
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor_calibration.calibration_fit import fit
from posor_lab.harness.simulated_recordings import PERIOD_NS, dwell_path
from scipy.spatial.transform import Rotation

SCANS = 20


def recorded(name: DesignName, runs: int) -> Recording:
    """Return visits of five places: shifts along X for diodes, angles about Z for a ring."""
    places = np.tile(np.linspace(-1e-3, 1e-3, 5), runs)
    path = dwell_path(places[:, None], SCANS)[:, 0]
    is_ring = name.endswith("ring")
    rotations = Rotation.from_euler("z", (path if is_ring else 0.0 * path)[:, None]).as_matrix()
    translations = np.column_stack([0.0 * path if is_ring else path, 0.0 * path, np.full(len(path), STANDOFF)])
    stamps = np.arange(1, len(path) + 1, dtype=np.int64) * PERIOD_NS
    scans = scans_at(Posor(design(name)).stack, rotations, translations, stamps, noise=np.random.default_rng(1))
    values = path[:, None] if is_ring else np.column_stack([path, 0.0 * path, 0.0 * path])
    track = Track(stamps, values, np.zeros(values.shape[1]), "simulated, topic /stage")
    return Recording(scans, {"/stage": track}, "simulated")


CASES: list[tuple[str, DesignName, str]] = [
    ("diode_repeatability", "triad_diodes", "diodes"),
    ("ring_repeatability", "quad_bumpy_ring", "probes"),
]


@pytest.mark.parametrize(("procedure", "name", "part"), CASES)
def test_noise_is_found_within_its_uncertainty(procedure: str, name: DesignName, part: str) -> None:
    result = fit(procedure, design(name), recorded(name, runs=6))
    assert len(result.outcome.replacements) == len(getattr(result.former.sensors[-1], part))
    for new, old in zip(
        getattr(result.calibration.sensors[-1], part), getattr(result.former.sensors[-1], part), strict=True
    ):
        assert np.all(np.abs(new.noise.array - old.noise.array) < 4.0 * new.noise.sigmas)


@pytest.mark.parametrize(("procedure", "name", "part"), CASES)
def test_scatter_from_visit_to_visit_adds_to_the_noise(procedure: str, name: DesignName, part: str) -> None:
    recording = recorded(name, runs=6)
    field = "diode_currents" if part == "diodes" else "ring_voltages"
    readings = getattr(recording.scans, field).copy()
    visits = np.repeat(np.random.default_rng(5).normal(size=30), SCANS + 5)[: len(readings)]
    readings[..., 0] *= 1.0 + 2e-3 * visits.reshape(-1, *(1,) * (readings.ndim - 2))
    changed = Recording(recording.scans.with_fields({field: readings}), recording.tracks, "simulated")
    before, after = (fit(procedure, design(name), each).outcome.replacements[0] for each in (recording, changed))
    assert np.max(after.value) > 1.5 * np.max(before.value)


@pytest.mark.parametrize(("procedure", "name"), [case[:2] for case in CASES])
def test_places_visited_once_are_refused(procedure: str, name: DesignName) -> None:
    recording = recorded(name, runs=2)
    [track] = recording.tracks.values()
    moved = track.values.copy()
    moved[len(moved) // 2 :, 0] += 1e-2
    once = Recording(
        recording.scans, {"/stage": Track(track.stamps_ns, moved, track.sigmas, track.source)}, "simulated"
    )
    with pytest.raises(FitError, match="each of the 10 places is visited once"):
        fit(procedure, design(name), once)
