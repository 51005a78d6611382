# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Offset of the diodes: one simulated source over both diodes."""

from __future__ import annotations

import numpy as np
import pytest
from posor.bags.recording import Recording, Track
from posor.calibration.designs import design
from posor.errors import FitError, TrackError
from posor.estimation.forward import empty_scans
from posor.model.native_coordinates import rotation_from_native
from posor.model.reading_rows import evaluate_poses
from posor.numerics.array_types import FloatArray
from posor.sensors.diodes import Diodes
from posor_calibration.procedures.diode_axes import PROCEDURE
from posor_lab.harness.simulated_recordings import without_uncertainties

from .simulated_case import SimulatedCase, check_coverage

TOPIC = "/stage"
STEP_NS = 20_000_000
PER_DWELL = 15
LINES = 6
DWELLS = LINES**2  # over each diode
SIGMA = 0.3e-6


def spots_of_one_source(sensor: Diodes, translations: FloatArray, source: int) -> FloatArray:
    """Return the spot of one source on each diode [m], (n, 4)."""
    rows = np.concatenate([2 * (d * 2 + source) + np.arange(2) for d in range(2)])
    selected = np.tile(rows, (len(translations), 1))
    rotations = np.tile(np.eye(3), (len(translations), 1, 1))
    return evaluate_poses(sensor.rows, selected, rotations, translations)


def simulate(random: np.random.Generator) -> SimulatedCase:
    calibration = without_uncertainties(design("triad_diodes"))
    nominal = calibration.sensors[1].build()
    assert isinstance(nominal, Diodes)
    values, names = nominal.parameter_values, list(nominal.parameter_names)
    truth = {}
    for name, sigma in (("origins[1,0]", 1e-4), ("origins[1,1]", 1e-4), ("x_axes[1,1]", 3e-3), ("y_axes[1,0]", 3e-3)):
        values[names.index(name)] += sigma * random.normal()
        truth[name] = values[names.index(name)]
    for name in ("x_axes", "y_axes"):
        where = [names.index(f"{name}[1,{i}]") for i in range(3)]
        values[where] /= np.linalg.norm(values[where])
    sensor = nominal.with_parameter_values(values)
    at = np.linspace(-4e-3, 4e-3, LINES)
    field = np.array([(x, y, 0.0) for x in at for y in at])
    stage = np.concatenate([field, field - [0.0, 0.0762, 0.0]])  # source 1 over diode 1, then over diode 2
    heading = 2e-3 * random.normal()
    turn = rotation_from_native(0.0, 0.0, heading)
    true_stage = stage + SIGMA * random.normal(size=stage.shape)
    translations = np.repeat(true_stage @ turn.T + [2e-4, -3e-4, 0.0], PER_DWELL, axis=0)
    stamps = (1 + np.arange(len(translations), dtype=np.int64)) * STEP_NS
    scans = empty_scans(stamps).with_fields({"lit_sources": np.zeros((len(stamps), 2), dtype=np.int64)})
    scans = scans.with_fields(sensor.encode(spots_of_one_source(sensor, translations, 0), scans))
    scans = scans.with_fields(sensor.disturbed(scans, random))
    currents = np.where(np.isfinite(scans.diode_currents), scans.diode_currents, 1e-7)  # dark
    scans = scans.with_fields({"diode_currents": currents})
    track = Track(stamps, np.repeat(stage, PER_DWELL, axis=0), np.full(3, SIGMA), TOPIC)
    return SimulatedCase(PROCEDURE, calibration, Recording(scans, {TOPIC: track}, "simulated"), truth)


NUMBERS = (
    ("origins[1,0]", "origin", 0),
    ("origins[1,1]", "origin", 1),
    ("x_axes[1,1]", "x_axis", 1),
    ("y_axes[1,0]", "y_axis", 0),
)


@pytest.mark.long
def test_offset_is_found_and_intervals_cover(rng: np.random.Generator) -> None:
    normalised = []
    for _ in range(30):
        case = simulate(rng)
        new = {replacement.key: replacement for replacement in case.identify().replacements}
        for name, entry, i in NUMBERS:
            found = new[f"sensors[1].diodes[1].{entry}"]
            normalised.append((np.array(found.value)[i] - case.truth[name]) / np.array(found.sigma)[i])
    check_coverage(normalised, 0.04, 0.15)


def test_table_has_the_offset(rng: np.random.Generator) -> None:
    case = simulate(rng)
    row = case.identify().tables[0].rows[1]
    assert float(row[1]) == pytest.approx(case.truth["origins[1,1]"] - 0.0381, abs=3e-6)
    assert 0.0 < float(row[2]) < 2e-6


def test_bad_data(rng: np.random.Generator) -> None:
    case = simulate(rng)
    case.check_refusal(TrackError, "falls where the readings rise", direction=-1)
    lit = case.recording.scans.lit_sources.copy()
    lit[DWELLS * PER_DWELL :] = 1
    other = case.with_scans(case.recording.scans.with_fields({"lit_sources": lit}))
    other.check_refusal(FitError, "the diodes see source_1, source_2; expected one and the same source")


def test_outliers_are_named(rng: np.random.Generator) -> None:
    case = simulate(rng)

    def displace(values: FloatArray) -> FloatArray:
        values[5 * PER_DWELL : 6 * PER_DWELL, 0] += 50e-6
        return values

    outcome = case.with_values(displace).identify(loss="soft_l1")
    assert any("spot x of diode_1 at dwell 6" in sentence for sentence in outcome.warnings)
    [found] = [new for new in outcome.replacements if new.key == "sensors[1].diodes[1].origin"]
    truth = [case.truth["origins[1,0]"], case.truth["origins[1,1]"]]
    assert np.array(found.value)[:2] == pytest.approx(truth, abs=5e-6)
