"""Zero-drift search: simulated truth, bad data, and the tests of 1985 from their recorded tables."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_estimator.core.calibrate.recording import Recording
from posor_estimator.core.calibrate.track import Track
from posor_estimator.core.calibrate.zero_drift import PROCEDURE
from posor_estimator.core.calibration.load import load_calibration
from posor_estimator.core.designs import design
from posor_estimator.core.forward import scans_at
from posor_estimator.core.native import rotation_from_native
from posor_estimator.core.posor import Posor
from posor_estimator.errors import FitError, TrackError
from posor_estimator.testing.campaign import exact
from scipy.spatial.transform import Rotation

from .slocum1985 import LEVER, recorded

if TYPE_CHECKING:
    from pathlib import Path

    from posor_estimator.core.calibrate.procedure import Outcome
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

TOPIC = "/truth"
STEP_NS = 100_000_000
SIGMA = 3e-6


@dataclass(frozen=True)
class Campaign:
    calibration: Calibration
    recording: Recording
    shifts: FloatArray


def campaign(random: np.random.Generator, count: int = 40) -> Campaign:
    """The target leans along a figure of eight; a pose reference watches it; all probes have drifted."""
    calibration = exact(design("triad_diodes"))
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
    return Campaign(calibration, Recording(scans, {TOPIC: track}, "simulated"), shifts)


def run(made: Campaign, **options: Any) -> Outcome:
    return PROCEDURE.run(made.recording, made.calibration, PROCEDURE.options(**options))


def test_drift_is_found_and_intervals_cover(rng: np.random.Generator) -> None:
    normalised = []
    for _ in range(30):
        made = campaign(rng)
        fit = run(made).fits["zero_drift"]
        normalised.append((fit.values[:3] - made.shifts) / fit.sigmas[:3])
    assert np.mean(np.abs(normalised) < 1.96) == pytest.approx(0.95, abs=0.03)
    assert np.std(normalised) == pytest.approx(1.0, abs=0.12)


def test_replacements(rng: np.random.Generator) -> None:
    made = campaign(rng)
    outcome = run(made)
    assert [new.key for new in outcome.replacements] == [f"sensors[0].probes[{k}].zero_shift" for k in range(3)]
    found = np.array([new.value for new in outcome.replacements])
    assert found == pytest.approx(made.shifts, abs=0.06)
    assert outcome.covariances[0].matrix == pytest.approx(outcome.fits["zero_drift"].covariance[:3, :3])
    before, after = (np.array([row[i] for row in outcome.tables[2].rows[:2]], dtype=float) for i in (1, 2))
    assert (after < before).all()


def test_little_motion_is_said_to_tell_little(rng: np.random.Generator) -> None:
    made = campaign(rng, count=6)
    outcome = run(made, expected_drift=0.01)
    assert any(sentence.startswith("The data hardly tell zero shift of gap_") for sentence in outcome.warnings)


def test_alpha_alone_hardly_tells_the_first_probe(rng: np.random.Generator) -> None:
    outcome = run(campaign(rng), angles=("alpha",))
    assert any(said.startswith("The data hardly tell zero shift of gap_1") for said in outcome.warnings)


def changed_poses(made: Campaign, rotations: Rotation) -> Campaign:
    track = made.recording.tracks[TOPIC]
    values = np.column_stack([track.values[:, :3], rotations.as_quat()])
    return replace(made, recording=replace(made.recording, tracks={TOPIC: replace(track, values=values)}))


def test_bad_data(rng: np.random.Generator) -> None:
    made = campaign(rng)
    turns = Rotation.from_quat(made.recording.tracks[TOPIC].values[:, 3:])
    with pytest.raises(TrackError, match=r"alpha of the reference: axis beta moves with the readings, axis alpha does"):
        run(changed_poses(made, Rotation.from_rotvec(turns.as_rotvec()[:, [1, 0, 2]])))
    with pytest.raises(TrackError, match=r"alpha of the reference: moves 25\.\d* times as far"):
        run(changed_poses(made, Rotation.from_rotvec(25.4 * turns.as_rotvec())))
    with pytest.raises(TrackError, match="alpha of the reference: turns the other way than the POSOR"):
        run(changed_poses(made, turns.inv()))
    volts = made.recording.scans.gap_voltages.copy()
    volts[20:, 1] = volts[20, 1]
    stuck = replace(made.recording, scans=made.recording.scans.with_fields({"gap_voltages": volts}))
    with pytest.raises(FitError, match=r"gap probe gap_2 is stuck at .* from stop 21 on"):
        run(replace(made, recording=stuck))
    few = replace(made.recording, scans=made.recording.scans.part(0, 2))
    with pytest.raises(FitError, match="2 scans while the reference was recorded; expected at least 5"):
        run(replace(made, recording=few))
    late = replace(made.recording.tracks[TOPIC], stamps_ns=made.recording.tracks[TOPIC].stamps_ns + 10**12)
    with pytest.raises(FitError, match="0 scans while the reference was recorded"):
        run(replace(made, recording=replace(made.recording, tracks={TOPIC: late})))
    with pytest.raises(TrackError, match=r"no topic holds a point"):
        run(made, lever=1.0)


def test_outliers_are_survived(rng: np.random.Generator) -> None:
    made = campaign(rng)
    turns = Rotation.from_quat(made.recording.tracks[TOPIC].values[:, 3:])
    kicks = np.zeros((40, 3))
    kicks[[7, 33]] = 400e-6  # 5 %
    bad = changed_poses(made, Rotation.from_rotvec(kicks) * turns)
    outcome = run(bad, loss="soft_l1")
    fit = outcome.fits["zero_drift"]
    assert np.max(np.abs(fit.values[:3] - made.shifts) / fit.sigmas[:3]) < 4.0
    assert any(
        "of 80 readings are outliers (alpha of scan 7, beta of scan 7," in sentence for sentence in outcome.warnings
    )


@pytest.mark.parametrize("test", ["ymo", "yzmo"])
def test_of_1985(rig_calibrations: dict[str, Path], test: str) -> None:
    calibration = load_calibration(rig_calibrations["section84"])
    made = Campaign(calibration, recorded(test), np.zeros(3))
    outcome = run(made, lever=LEVER, session=test, first_sigma=0.0)
    # The file's own shifts are those of the thesis: what is found leaves less error.
    for row in outcome.tables[2].rows[:2]:
        assert float(row[2]) < float(row[1]), row
    (new,) = outcome.replacements
    assert new.key == f"sessions.{test}.zero_shifts"
    assert np.abs(outcome.fits["zero_drift"].correlations[:3, :3]).min() > 0.5
