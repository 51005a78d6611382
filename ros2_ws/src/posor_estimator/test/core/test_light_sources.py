"""Inclination of the light sources: simulated travel along Z of a stage that is not square, with and without a turn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_estimator.core.calibrate.light_sources import PROCEDURE
from posor_estimator.core.calibrate.recording import POINT, Recording
from posor_estimator.core.calibrate.track import Track
from posor_estimator.core.designs import design
from posor_estimator.core.forward import scans_at
from posor_estimator.core.native import rotation_from_native
from posor_estimator.core.posor import Posor
from posor_estimator.errors import FitError
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.procedure import Outcome
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

TOPIC = "/stage"
PER_STOP = 12
STEP_NS = 20_000_000
SIGMA = 0.3e-6
FACING = np.radians(5.0)
"""Where a source of the ring stands over the middle of each diode [rad]."""
STAGE_LEAN = np.array([1.5e-3, -0.8e-3])


@dataclass(frozen=True)
class Campaign:
    calibration: Calibration
    recording: Recording
    truth: dict[int, FloatArray]


def campaign(random: np.random.Generator, thetas: tuple[float, ...] = (FACING, FACING + np.pi)) -> Campaign:
    calibration = design("triad_light_ring")
    stack = Posor(calibration).stack
    names, values = list(stack.parameter_names), stack.parameter_values
    truth = {}
    for source in range(36):
        where = [names.index(f"Diodes.source_directions[{source},{i}]") for i in range(3)]
        leaning = values[where] + [*(2e-3 * random.normal(size=2)), 0.0]
        values[where] = truth[source] = leaning / np.linalg.norm(leaning)
    heights = np.linspace(0.0, 12e-3, 7)
    stops = [(theta, height) for theta in thetas for height in heights]
    said = np.array([[0.0, 0.0, height] for _, height in stops])
    seats = {theta: 100e-6 * random.normal(size=2) for theta in thetas}
    true = [[*(seats[theta] + STAGE_LEAN * height + SIGMA * random.normal(size=2)), height] for theta, height in stops]
    rotations = np.array([rotation_from_native(0.0, 0.0, theta) for theta, _ in stops])
    stamps = (1 + np.arange(len(stops) * PER_STOP, dtype=np.int64)) * STEP_NS
    scans = scans_at(
        stack.with_parameter_values(values),
        np.repeat(rotations, PER_STOP, axis=0),
        np.repeat(np.array(true), PER_STOP, axis=0),
        stamps,
        noise=random,
    )
    poses = np.column_stack([said, Rotation.from_matrix(rotations).as_quat()])
    track = Track(stamps, np.repeat(poses, PER_STOP, axis=0), np.array([SIGMA] * 3 + [1e-4] * 4), TOPIC)
    return Campaign(calibration, Recording(scans, {TOPIC: track}, "simulated"), truth)


def run(made: Campaign, **options: Any) -> Outcome:
    return PROCEDURE.run(made.recording, made.calibration, PROCEDURE.options(**options))


def test_reversal_tells_rays_from_stage_and_intervals_cover(rng: np.random.Generator) -> None:
    normalised = []
    for _ in range(30):
        made = campaign(rng)
        outcome = run(made)
        for new in outcome.replacements:
            source = int(new.key.split("[")[2].split("]")[0])
            normalised.append((np.array(new.value)[:2] - made.truth[source][:2]) / np.array(new.sigma)[:2])
        fit = outcome.fits["light_sources"]
        assert fit.value("lean of the stage along X") == pytest.approx(STAGE_LEAN[0], abs=5.0 * fit.sigmas[0])
    assert len(outcome.replacements) == 2
    assert np.mean(np.abs(normalised) < 1.96) == pytest.approx(0.95, abs=0.04)
    assert np.std(normalised) == pytest.approx(1.0, abs=0.15)


def test_without_a_reversal(rng: np.random.Generator) -> None:
    made = campaign(rng, thetas=(FACING,))
    with pytest.raises(FitError, match="the target was not turned, so that the rays' lean and the stage's are one"):
        run(made)
    outcome = run(made, stage_sigma=2e-3)
    fit = outcome.fits["light_sources"]
    assert fit.sigmas[0] == pytest.approx(2e-3, rel=0.05)  # no better than the stage is known
    (one, other) = outcome.replacements
    assert any("vary together" in sentence for sentence in outcome.warnings)
    for new in (one, other):
        source = int(new.key.split("[")[2].split("]")[0])
        assert np.array(new.value)[:2] == pytest.approx(made.truth[source][:2], abs=6e-3)


def test_a_point_will_do_where_nothing_turns(rng: np.random.Generator) -> None:
    made = campaign(rng, thetas=(FACING,))
    track = made.recording.tracks[TOPIC]
    point = replace(track, values=track.values[:, :POINT], sigmas=track.sigmas[:POINT])
    made = replace(made, recording=replace(made.recording, tracks={TOPIC: point}))
    assert run(made, stage_sigma=1e-5).fits["light_sources"].freedoms > 0


def test_bad_data(rng: np.random.Generator) -> None:
    made = campaign(rng)
    track = made.recording.tracks[TOPIC]
    flat = replace(track, values=track.values * [1.0, 1.0, 1e-3, 1.0, 1.0, 1.0, 1.0])
    with pytest.raises(FitError, match=r"the stage travels 1.2e-05 m along Z"):
        run(replace(made, recording=replace(made.recording, tracks={TOPIC: flat})), still=5e-7)
    short = Recording(made.recording.scans.part(0, 2 * PER_STOP), {TOPIC: track}, "simulated")
    with pytest.raises(FitError, match=r"the target was not turned|stops of the reference|readings for"):
        run(replace(made, recording=short))


def test_other_sources_after_the_turn_tell_nothing(rng: np.random.Generator) -> None:
    with pytest.raises(FitError, match=r"the readings do not tell .*lean of the stage along .*apart"):
        run(campaign(rng, thetas=(FACING, FACING + np.radians(60.0))))
