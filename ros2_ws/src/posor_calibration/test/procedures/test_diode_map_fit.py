# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Diode maps from simulated grids: recovered truth, uncertainties, and unusable data."""

from __future__ import annotations

import numpy as np
import pytest
from posor.bags.recording import Recording, Track
from posor.calibration.calibration_file import calibration_from
from posor.calibration.designs import design
from posor.errors import FitError, TrackError
from posor.estimation.forward import empty_scans
from posor.estimation.posor import Posor
from posor.estimation.sensor_stack import Stack
from posor.model.scan import Scans
from posor.numerics.array_types import FloatArray
from posor.sensors.diodes import Diodes
from posor_calibration.diode_spots import current_ratios
from posor_calibration.map_basis import surface_design
from posor_calibration.procedure import Outcome
from posor_calibration.procedures.diode_map_fit import PROCEDURE

from .simulated_case import SimulatedCase

TOPIC = "/stage"
STEP_NS = 20_000_000
PER_DWELL = 15
LINES = 9
REFERENCE_SIGMA = 0.5e-6
WITHIN_95 = 1.96


def simulate(random: np.random.Generator) -> SimulatedCase:
    """Both diodes are moved over a grid of dwells; the truth's map differs from the calibration's."""
    calibration = design("triad_diodes")
    nominal = calibration.sensors[1].build()
    assert isinstance(nominal, Diodes)
    values = nominal.parameter_values
    maps = np.array([nominal.parameter_names.index(f"maps[{d},{k}]") for d in range(2) for k in range(32)])
    terms = [k for k in range(32) if (k % 16) // 4 + k % 4 <= 3]
    moved = np.array([d * 32 + k for d in range(2) for k in terms])
    values[maps[moved]] += 10e-6 * random.normal(size=len(moved))
    truth = nominal.with_parameter_values(values)
    at = np.linspace(-4.5e-3, 4.5e-3, LINES)
    places = np.array([(x, y) for x in at for y in at])
    positions = np.repeat(places + REFERENCE_SIGMA * random.normal(size=places.shape), PER_DWELL, axis=0)
    stamps = (1 + np.arange(len(positions), dtype=np.int64)) * STEP_NS
    scans = empty_scans(stamps).with_fields({"lit_sources": np.tile([0, 1], (len(stamps), 1))})
    scans = scans.with_fields(truth.encode(np.tile(positions, 2), scans))
    scans = scans.with_fields(truth.disturbed(scans, random))
    said = np.repeat(np.column_stack([places, np.zeros(len(places))]), PER_DWELL, axis=0)
    track = Track(stamps, said, np.full(3, REFERENCE_SIGMA), TOPIC)
    return SimulatedCase(PROCEDURE, calibration, Recording(scans, {TOPIC: track}, "simulated"), truth)


def calibrated_stack(case: SimulatedCase, outcome: Outcome) -> Stack:
    """Return the diodes with the new map of the first one."""
    content = case.calibration.model_dump(mode="json")
    (part,) = outcome.parts
    assert part.key == "sensors[1].maps.factory[0]"
    content["sensors"][1]["maps"]["factory"][0] = part.content
    return Posor(calibration_from(content)).stack


def positions_of(stack: Stack, scans: Scans) -> FloatArray:
    readings = stack.linearise(scans.with_fields({"gap_voltages": np.zeros((len(scans), 3))}))
    assert readings.valid.all()
    return readings.values[:, 3:5]


def draw_scans(case: SimulatedCase, rng: np.random.Generator, count: int) -> tuple[Scans, FloatArray]:
    """Return noiseless scans at random spots within the grid, and the spots."""
    spots = rng.uniform(-4e-3, 4e-3, (count, 2))
    scans = empty_scans(np.arange(count, dtype=np.int64)).with_fields({"lit_sources": np.tile([0, 1], (count, 1))})
    return scans.with_fields(case.truth.encode(np.tile(spots, 2), scans)), spots


def test_the_map_is_recovered(rng: np.random.Generator) -> None:
    case = simulate(rng)
    outcome = case.identify(diode="diode_1")
    scans, spots = draw_scans(case, rng, 50)
    assert positions_of(calibrated_stack(case, outcome), scans) == pytest.approx(spots, abs=1.5e-6)
    assert "order 3" in outcome.method
    assert not outcome.warnings


@pytest.mark.long
def test_intervals_cover(rng: np.random.Generator) -> None:
    inside: list[bool] = []
    for _ in range(60):
        case = simulate(rng)
        outcome = case.identify(diode="diode_1", orders=(3, 3))
        scans, spots = draw_scans(case, rng, 20)
        found = positions_of(calibrated_stack(case, outcome), scans)
        domain = np.array(outcome.parts[0].content["domain"]["value"])
        ratios = current_ratios(scans.diode_currents[:, 0])
        design_matrix = surface_design((ratios - domain.mean(axis=1)) / (0.5 * np.ptp(domain, axis=1)), 3).matrix
        for axis, fit in enumerate(outcome.fits.values()):
            sigma = np.sqrt(np.einsum("ni,ij,nj->n", design_matrix, fit.covariance, design_matrix))
            inside += list(np.abs(found[:, axis] - spots[:, axis]) < WITHIN_95 * sigma)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.03)


def test_curves_of_1985(rng: np.random.Generator) -> None:
    case = simulate(rng)
    outcome = case.identify(diode="diode_1", kind="curves", orders=(1, 6))
    positions = case.reference.values[:, :2]
    inner = np.max(np.abs(positions), axis=1) < 4e-3  # noise moves spots at the rim beyond the outermost curves
    found = positions_of(calibrated_stack(case, outcome), case.recording.scans.select(inner))
    means = found.reshape(-1, PER_DWELL, 2).mean(axis=1)
    assert means == pytest.approx(positions[inner][::PER_DWELL], abs=2.5e-6)
    assert outcome.tables[0].title.startswith("residual against order")
    assert [row[0] for row in outcome.tables[0].rows] == [1, 2, 3, 4, 5, 6]
    between = outcome.tables[1]
    assert between.title == "interpolation between curves, by doubling of the grid (thesis 8.3.3)"
    assert [row[0] for row in between.rows] == ["x", "y"]
    assert all(0.0 < float(row[1]) < float(row[2]) < 2.5 for row in between.rows)  # the accuracy of the map above
    assert len(case.identify(diode="diode_1").tables) == 1


def test_a_set_of_its_own(rng: np.random.Generator) -> None:
    maps, selected = simulate(rng).identify(diode="diode_1", set_name="new").parts
    assert (maps.key, len(maps.content)) == ("sensors[1].maps.new", 2)
    assert (selected.key, selected.content) == ("sensors[1].map", "new")


def test_bad_data(rng: np.random.Generator) -> None:
    case = simulate(rng)
    case.check_refusal(TrackError, "falls where the readings rise", diode="diode_1", direction=-1)
    case.check_refusal(FitError, "diode 'nobody'; expected one of diode_1, diode_2", diode="nobody")


@pytest.mark.parametrize("axis", [0, 1])
def test_a_stage_whose_zero_is_beyond_the_grid_is_refused(axis: int, rng: np.random.Generator) -> None:
    case = simulate(rng)
    case.identify(diode="diode_1", orders=(1, 3))
    shift = np.zeros(3)
    shift[axis] = 25e-3
    sentence = rf"the dwells are at {'xy'[axis]} from 0.0205 to 0.0295 m, without 0, which becomes the diode's origin; "
    case.with_values(lambda values: values + shift).check_refusal(TrackError, sentence, diode="diode_1")


def test_outliers_are_named_and_survived(rng: np.random.Generator) -> None:
    case = simulate(rng)
    wrong = rng.choice(LINES**2, size=4, replace=False)  # 5 % of the dwells

    def displace(values: FloatArray) -> FloatArray:
        dwells = values.reshape(-1, PER_DWELL, 3)
        dwells[wrong, :, 0] += 60e-6
        return dwells.reshape(-1, 3)

    outcome = case.with_values(displace).identify(diode="diode_1")
    assert any("left out dwell at" in sentence for sentence in outcome.warnings)
    scans, spots = draw_scans(case, rng, 50)
    assert positions_of(calibrated_stack(case, outcome), scans) == pytest.approx(spots, abs=4e-6)
