"""Offset of the diodes' axes: one simulated source over both diodes of designs and of the rig of 1985."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_estimator.core.calibrate.diode_axes import PROCEDURE
from posor_estimator.core.calibrate.recording import Recording
from posor_estimator.core.calibrate.track import Track
from posor_estimator.core.designs import design
from posor_estimator.core.forward import empty_scans
from posor_estimator.core.kernels.rows import evaluate_all
from posor_estimator.core.native import rotation_from_native
from posor_estimator.core.sensors.diodes import Diodes
from posor_estimator.errors import FitError, TrackError
from posor_estimator.testing.campaign import exact

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.procedure import Outcome
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

TOPIC = "/stage"
STEP_NS = 20_000_000
PER_STOP = 15
LINES = 6
STOPS = LINES**2
"""Over each diode."""
SIGMA = 0.3e-6


@dataclass(frozen=True)
class Campaign:
    calibration: Calibration
    recording: Recording
    truth: dict[str, float]


def spots_of_one_source(sensor: Diodes, translations: FloatArray, source: int) -> FloatArray:
    """Return where each diode would see one source, (n, 4)."""
    rows = np.concatenate([2 * (d * 2 + source) + np.arange(2) for d in range(2)])
    chosen = np.tile(rows, (len(translations), 1))
    out = np.empty((len(translations), 4))
    rotations = np.tile(np.eye(3), (len(translations), 1, 1))
    evaluate_all(sensor.pool.kinds, sensor.pool.rows, chosen, rotations, translations, out)
    return out


def campaign(random: np.random.Generator) -> Campaign:
    calibration = exact(design("triad_diodes"))
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
    translations = np.repeat(true_stage @ turn.T + [2e-4, -3e-4, 0.0], PER_STOP, axis=0)
    stamps = (1 + np.arange(len(translations), dtype=np.int64)) * STEP_NS
    scans = empty_scans(stamps).with_fields({"lit_sources": np.zeros((len(stamps), 2), dtype=np.int64)})
    scans = scans.with_fields(sensor.encode(spots_of_one_source(sensor, translations, 0), scans))
    scans = scans.with_fields(sensor.disturbed(scans, random))
    currents = np.where(np.isfinite(scans.diode_currents), scans.diode_currents, 1e-7)  # dark
    scans = scans.with_fields({"diode_currents": currents})
    track = Track(stamps, np.repeat(stage, PER_STOP, axis=0), np.full(3, SIGMA), TOPIC)
    return Campaign(calibration, Recording(scans, {TOPIC: track}, "simulated"), truth)


def run(made: Campaign, **options: Any) -> Outcome:
    return PROCEDURE.run(made.recording, made.calibration, PROCEDURE.options(**options))


def test_offset_is_found_and_intervals_cover(rng: np.random.Generator) -> None:
    normalised = []
    for _ in range(30):
        made = campaign(rng)
        new = {one.key: one for one in run(made).replacements}
        for name, key, i in (
            ("origins[1,0]", "sensors[1].diodes[1].origin", 0),
            ("origins[1,1]", "sensors[1].diodes[1].origin", 1),
            ("x_axes[1,1]", "sensors[1].diodes[1].x_axis", 1),
            ("y_axes[1,0]", "sensors[1].diodes[1].y_axis", 0),
        ):
            value, sigma = np.array(new[key].value)[i], np.array(new[key].sigma)[i]
            normalised.append((value - made.truth[name]) / sigma)
    assert np.mean(np.abs(normalised) < 1.96) == pytest.approx(0.95, abs=0.04)
    assert np.std(normalised) == pytest.approx(1.0, abs=0.15)


def test_table_has_the_offset(rng: np.random.Generator) -> None:
    made = campaign(rng)
    rows = run(made).tables[0].rows
    assert float(rows[1][1]) == pytest.approx(made.truth["origins[1,1]"] - 0.0381, abs=3e-6)
    assert 0.0 < float(rows[1][2]) < 2e-6


def with_values(made: Campaign, values: FloatArray) -> Campaign:
    track = replace(made.recording.tracks[TOPIC], values=values)
    return replace(made, recording=replace(made.recording, tracks={TOPIC: track}))


def test_bad_data(rng: np.random.Generator) -> None:
    made = campaign(rng)
    values = made.recording.tracks[TOPIC].values
    with pytest.raises(TrackError, match="the axes look swapped"):
        run(with_values(made, values[:, [1, 0, 2]]))
    with pytest.raises(TrackError, match=r"moves 25\.\d* times as far"):
        run(with_values(made, 25.4 * values), still=1e-4)
    with pytest.raises(TrackError, match="falls where the readings rise"):
        run(made, direction=-1)
    half = Recording(made.recording.scans.part(0, STOPS * PER_STOP), made.recording.tracks, "simulated")
    with pytest.raises(FitError, match="only diode_1 sees the light; expected two diodes at least"):
        run(replace(made, recording=half))
    lit = made.recording.scans.lit_sources.copy()
    lit[STOPS * PER_STOP :] = 1
    other = replace(made.recording, scans=made.recording.scans.with_fields({"lit_sources": lit}))
    with pytest.raises(FitError, match="the diodes see source_1, source_2; expected one and the same source"):
        run(replace(made, recording=other))


def test_outliers_are_named(rng: np.random.Generator) -> None:
    made = campaign(rng)
    values = made.recording.tracks[TOPIC].values.copy()
    values[5 * PER_STOP : 6 * PER_STOP, 0] += 50e-6
    outcome = run(with_values(made, values), loss="soft_l1")
    assert any("spot x of diode_1 at stop 6" in sentence for sentence in outcome.warnings)
    found = {one.key: one for one in outcome.replacements}["sensors[1].diodes[1].origin"]
    assert np.array(found.value)[:2] == pytest.approx(
        [made.truth["origins[1,0]"], made.truth["origins[1,1]"]], abs=5e-6
    )
