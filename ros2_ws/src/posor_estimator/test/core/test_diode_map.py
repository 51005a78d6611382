"""Diode maps from simulated grid scans: do they give the truth back, with honest uncertainties, and refuse bad data."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_estimator.core.calibrate.diode_map import PROCEDURE
from posor_estimator.core.calibrate.recording import Recording
from posor_estimator.core.calibrate.track import Track
from posor_estimator.core.calibration.model import Calibration, calibration_from
from posor_estimator.core.designs import design
from posor_estimator.core.forward import empty_scans
from posor_estimator.core.posor import Posor
from posor_estimator.core.sensors.diodes import Diodes
from posor_estimator.errors import FitError, PosorError, TrackError

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_estimator.core.calibrate.procedure import Outcome
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.stack import Stack
    from posor_estimator.core.types import FloatArray

TOPIC = "/stage"
STEP_NS = 20_000_000
PER_STOP = 15
LINES = 9
REFERENCE_SIGMA = 0.5e-6
WITHIN_95 = 1.96


@dataclass(frozen=True)
class Campaign:
    calibration: Calibration
    recording: Recording
    truth: Diodes


def campaign(random: np.random.Generator) -> Campaign:
    """Both diodes are moved over a grid of stops; the truth's map differs from the calibration's."""
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
    positions = np.repeat(places + REFERENCE_SIGMA * random.normal(size=places.shape), PER_STOP, axis=0)
    stamps = (1 + np.arange(len(positions), dtype=np.int64)) * STEP_NS
    scans = empty_scans(stamps).with_fields({"lit_sources": np.tile([0, 1], (len(stamps), 1))})
    scans = scans.with_fields(truth.encode(np.tile(positions, 2), scans))
    scans = scans.with_fields(truth.disturbed(scans, random))
    said = np.repeat(np.column_stack([places, np.zeros(len(places))]), PER_STOP, axis=0)
    track = Track(stamps, said, np.full(3, REFERENCE_SIGMA), TOPIC)
    return Campaign(calibration, Recording(scans, {TOPIC: track}, "simulated"), truth)


def run(made: Campaign, **options: Any) -> Outcome:
    return PROCEDURE.run(made.recording, made.calibration, PROCEDURE.options(**{"diode": "diode_1", **options}))


def calibrated(made: Campaign, outcome: Outcome) -> Stack:
    """Return the diodes with the new map in the first one's place."""
    content = made.calibration.model_dump(mode="json")
    (part,) = outcome.parts
    assert part.key == "sensors[1].maps.factory[0]"
    content["sensors"][1]["maps"]["factory"][0] = part.content
    return Posor(calibration_from(content)).stack


def positions_of(stack: Stack, scans: Scans) -> FloatArray:
    codes, batch = stack.linearise(scans.with_fields({"gap_voltages": np.zeros((len(scans), 3))}))
    assert not codes.any()
    return batch.values[:, 3:5]


def test_the_map_is_found_again(rng: np.random.Generator) -> None:
    made = campaign(rng)
    outcome = run(made)
    stack = calibrated(made, outcome)
    inside = rng.uniform(-4e-3, 4e-3, (50, 2))
    scans = empty_scans(np.arange(50, dtype=np.int64)).with_fields({"lit_sources": np.tile([0, 1], (50, 1))})
    scans = scans.with_fields(made.truth.encode(np.tile(inside, 2), scans))
    assert positions_of(stack, scans) == pytest.approx(inside, abs=1.5e-6)
    assert "order 3" in outcome.method
    assert not outcome.warnings


def test_intervals_cover(rng: np.random.Generator) -> None:
    inside: list[bool] = []
    for _ in range(60):
        made = campaign(rng)
        outcome = run(made, orders=(3, 3))
        probe = rng.uniform(-4e-3, 4e-3, (20, 2))
        scans = empty_scans(np.arange(20, dtype=np.int64)).with_fields({"lit_sources": np.tile([0, 1], (20, 1))})
        scans = scans.with_fields(made.truth.encode(np.tile(probe, 2), scans))
        found = positions_of(calibrated(made, outcome), scans)
        domain = np.array(outcome.parts[0].content["domain"]["value"])
        currents = scans.diode_currents[:, 0]
        ratios = (currents[:, :2] - currents[:, 2:]) / (currents[:, :2] + currents[:, 2:])
        scaled = (ratios - domain.mean(axis=1)) / (0.5 * np.ptp(domain, axis=1))
        functions = [np.polynomial.chebyshev.chebvander(scaled[:, axis], 3) for axis in range(2)]
        terms = [(i, j) for i in range(4) for j in range(4 - i)]
        design_matrix = np.column_stack([functions[0][:, i] * functions[1][:, j] for i, j in terms])
        for axis, fit in enumerate(outcome.fits.values()):
            sigma = np.sqrt(np.einsum("ni,ij,nj->n", design_matrix, fit.covariance, design_matrix))
            inside += list(np.abs(found[:, axis] - probe[:, axis]) < WITHIN_95 * sigma)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.03)


def test_curves_of_1985(rng: np.random.Generator) -> None:
    made = campaign(rng)
    outcome = run(made, kind="curves", orders=(1, 6))
    said = made.recording.tracks[TOPIC].values[:, :2]
    inner = np.max(np.abs(said), axis=1) < 4e-3  # noise takes spots at the rim beyond the outermost curves
    found = positions_of(calibrated(made, outcome), made.recording.scans.chosen(inner))
    means = found.reshape(-1, PER_STOP, 2).mean(axis=1)
    assert means == pytest.approx(said[inner][::PER_STOP], abs=2.5e-6)
    assert outcome.tables[0].title.startswith("residual against order")
    orders = [row[0] for row in outcome.tables[0].rows]
    assert orders == [1, 2, 3, 4, 5, 6]


def test_a_set_of_its_own(rng: np.random.Generator) -> None:
    made = campaign(rng)
    maps, chosen = run(made, set_name="new").parts
    assert (maps.key, len(maps.content), chosen.key, chosen.content) == (
        "sensors[1].maps.new",
        2,
        "sensors[1].map",
        "new",
    )


def with_track(made: Campaign, change: Callable[[FloatArray], FloatArray]) -> Campaign:
    track = made.recording.tracks[TOPIC]
    return replace(made, recording=replace(made.recording, tracks={TOPIC: replace(track, values=change(track.values))}))


def test_bad_data(rng: np.random.Generator) -> None:
    made = campaign(rng)
    few = made.recording.scans.part(0, 5 * PER_STOP)
    track = made.recording.tracks[TOPIC]
    short = replace(track, stamps_ns=track.stamps_ns[: 5 * PER_STOP], values=track.values[: 5 * PER_STOP])
    with pytest.raises(PosorError, match=r"5 stops of the reference; expected at least 9"):
        run(replace(made, recording=Recording(few, {TOPIC: short}, "simulated")))
    with pytest.raises(TrackError, match=r"axis y moves with the readings, axis x does not; the axes look swapped"):
        run(with_track(made, lambda values: values[:, [1, 0, 2]]))
    with pytest.raises(TrackError, match=r"25\.\d* times as far as the present calibration says"):
        run(with_track(made, lambda values: 25.4 * values), still=1e-4)
    with pytest.raises(TrackError, match="falls where the readings rise"):
        run(made, direction=-1)
    with pytest.raises(FitError, match="diode 'nobody'; expected one of diode_1, diode_2"):
        run(made, diode="nobody")
    stuck = made.recording.scans.diode_currents.copy()
    stuck[:, 0] = stuck[0, 0]
    scans = made.recording.scans.with_fields({"diode_currents": stuck})
    with pytest.raises(FitError, match=r"diode diode_1, x ratio .*stuck"):
        run(replace(made, recording=replace(made.recording, scans=scans)))


def test_outliers_are_named_and_survived(rng: np.random.Generator) -> None:
    made = campaign(rng)
    wrong = rng.choice(LINES**2, size=4, replace=False)  # 5 % of the stops

    def bumped(values: FloatArray) -> FloatArray:
        stops = values.reshape(-1, PER_STOP, 3).copy()
        stops[wrong, :, 0] += 60e-6
        return stops.reshape(-1, 3)

    outcome = run(with_track(made, bumped))
    assert any("left out stop at" in sentence for sentence in outcome.warnings)
    stack = calibrated(made, outcome)
    inside = rng.uniform(-4e-3, 4e-3, (50, 2))
    scans = empty_scans(np.arange(50, dtype=np.int64)).with_fields({"lit_sources": np.tile([0, 1], (50, 1))})
    scans = scans.with_fields(made.truth.encode(np.tile(inside, 2), scans))
    assert positions_of(stack, scans) == pytest.approx(inside, abs=4e-6)
