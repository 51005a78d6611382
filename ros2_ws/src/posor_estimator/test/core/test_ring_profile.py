"""Profile of a bumpy ring: simulated full turns of a ring whose true profile is known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_estimator.core.calibrate.recording import Recording
from posor_estimator.core.calibrate.ring_profile import PROCEDURE
from posor_estimator.core.calibrate.track import Track
from posor_estimator.core.calibration.model import Calibration, calibration_from
from posor_estimator.core.designs import design
from posor_estimator.core.forward import scans_at
from posor_estimator.core.native import rotation_from_native
from posor_estimator.core.posor import Posor
from posor_estimator.errors import FitError, TrackError
from posor_estimator.testing.campaign import exact

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.procedure import Outcome
    from posor_estimator.core.types import FloatArray

THETA = "/theta"
THETA_SIGMA = 2e-6
RUNOUT = 1e-6
AMPLITUDE = 1e-6
RADIUS = 5e-6
CAMPAIGNS = 8
ORDERS = (1, 2, 3, 4, 35, 36, 37, 38, 72, 108)
"""Of the true ring; the calibration has 1, 2, 36, 72, 108."""
TOLD_ALONE = (
    "cos 2",
    "sin 2",
    "cos 4",
    "sin 4",
    "cos 36",
    "cos 38",
    "sin 38",
    "cos 72",
    "sin 72",
    "cos 108",
    "sin 108",
)


@dataclass(frozen=True)
class Campaign:
    calibration: Calibration
    recording: Recording
    truth: dict[str, float]


def true_ring(random: np.random.Generator) -> tuple[Calibration, dict[str, float]]:
    content = design("triad_bumpy_ring").model_dump(mode="json")
    ring = content["sensors"][1]["ring"]
    truth: dict[str, float] = {}
    for name in ("cos", "sin"):
        known = dict(zip(ring["orders"], ring[name]["value"], strict=True))
        truth |= {f"{name} {k}": known.get(k, 0.0) + AMPLITUDE * random.normal() for k in ORDERS}
        ring[name] = {"value": [truth[f"{name} {k}"] for k in ORDERS], "unit": "m"}
    ring["orders"] = list(ORDERS)
    ring["mean_radius"]["value"] += RADIUS * random.normal()
    return calibration_from(content), truth


def campaign(random: np.random.Generator, turns: float = 1.5, count: int = 320, first: float = 0.0) -> Campaign:
    calibration, truth = true_ring(random)
    thetas = first + np.linspace(0.0, 2.0 * np.pi * turns, count)
    rotations = np.array([rotation_from_native(1e-3, -5e-4, theta) for theta in thetas])
    translations = np.column_stack([RUNOUT * random.normal(size=(count, 2)), np.full(count, 0.7e-3)])
    stamps = (1 + np.arange(count, dtype=np.int64)) * 10_000_000
    scans = scans_at(Posor(calibration).stack, rotations, translations, stamps, noise=random)
    home = np.zeros(count, dtype=np.int64)
    home[0] = 1
    said = thetas + THETA_SIGMA * random.normal(size=count)
    track = Track(stamps, said[:, None], np.array([THETA_SIGMA]), THETA)
    recording = Recording(scans.with_fields({"at_home": home}), {THETA: track}, "simulated")
    return Campaign(exact(design("triad_bumpy_ring")), recording, truth)


def run(made: Campaign, **options: Any) -> Outcome:
    given = {"orders": ORDERS, "expected_amplitude": AMPLITUDE, **options}
    return PROCEDURE.run(made.recording, made.calibration, PROCEDURE.options(**given))


def normalised(made: Campaign, outcome: Outcome, names: tuple[str, ...]) -> FloatArray:
    fit = outcome.fits["ring_profile"]
    return np.array([(fit.value(name) - made.truth[name]) / fit.sigma(name) for name in names])


def test_full_turns_tell_the_even_orders(rng: np.random.Generator) -> None:
    errors = []
    for _ in range(CAMPAIGNS):
        made = campaign(rng)
        outcome = run(made)
        errors.append(normalised(made, outcome, TOLD_ALONE))
    assert np.mean(np.abs(errors) < 1.96) == pytest.approx(0.95, abs=0.06)
    assert np.std(errors) == pytest.approx(1.0, abs=0.25)
    fit = outcome.fits["ring_profile"]
    assert max(fit.sigma(name) for name in ("cos 2", "cos 4", "cos 36", "cos 38")) < 0.05e-6
    said = [sentence for sentence in outcome.warnings if "cannot be separated from runout" in sentence]
    assert said[0].startswith("Orders 1, 3, 35, 36, 37 cannot be separated")
    assert "a reference of theta or runout_sigma would tell more" in said[0]


def test_references_tell_the_others(rng: np.random.Generator) -> None:
    made = campaign(rng)
    outcome = run(made, theta=THETA, runout_sigma=RUNOUT)
    names = tuple(f"{name} {k}" for k in ORDERS for name in ("cos", "sin"))
    assert np.max(np.abs(normalised(made, outcome, names))) < 4.0
    assert outcome.fits["ring_profile"].sigma("sin 36") < 0.02e-6
    assert outcome.fits["ring_profile"].spread == pytest.approx(1.0, abs=0.08)
    assert not any("cannot be separated" in sentence for sentence in outcome.warnings)


def test_the_new_profile_measures_better(rng: np.random.Generator) -> None:
    made = campaign(rng)
    (part,) = run(made, theta=THETA, runout_sigma=RUNOUT).parts
    assert part.key == "sensors[1].ring"
    content = made.calibration.model_dump(mode="json")
    content["sensors"][1]["ring"] = part.content
    track = made.recording.tracks[THETA].values[:, 0]
    rms = []
    for calibration in (made.calibration, calibration_from(content)):
        found = Posor(calibration, false_alarm=0.0).locate_all(made.recording.scans)
        rms.append(float(np.std(found.thetas - track)))
    assert rms[1] < 0.2 * rms[0]


def test_turns_are_counted_by_the_reference(rng: np.random.Generator) -> None:
    made = campaign(rng, turns=2.0, count=400)
    assert run(made, theta=THETA).method.startswith("self-calibration over 2.00 turns, 400 scans")
    made = campaign(rng, turns=1.5)
    assert run(made).method.startswith("self-calibration over 1.50 turns, 320 scans")
    # A little to and fro where the POSOR's own theta goes from pi to -pi is no turn.
    made = campaign(rng, turns=0.2 / (2.0 * np.pi), first=np.pi - 0.1)
    with pytest.raises(FitError, match=r"ring_profile, simulated: 0\.03 of a turn; expected a full turn"):
        run(made, theta=THETA)


def test_bad_data(rng: np.random.Generator) -> None:
    made = campaign(rng, turns=0.5, count=320)
    with pytest.raises(FitError, match=r"ring_profile, simulated: 0\.50 of a turn; expected a full turn"):
        run(made)
    made = campaign(rng, count=320)
    few = replace(made.recording, scans=made.recording.scans.part(0, 100))
    with pytest.raises(FitError, match="100 scans; expected at least 288"):
        run(replace(made, recording=few))
    blind = made.recording.scans.with_fields({"at_home": np.zeros(320, dtype=np.int64)})
    with pytest.raises(FitError, match="no scan saw the home mark; expected one at least, or a reference of theta"):
        run(replace(made, recording=replace(made.recording, scans=blind)))
    with pytest.raises(TrackError, match="there is no reference /phi"):
        run(made, theta="/phi")
    volts = made.recording.scans.ring_voltages.copy()
    volts[100:, 2] = volts[100, 2]
    stuck = made.recording.scans.with_fields({"ring_voltages": volts})
    with pytest.raises(FitError, match=r"ring probe ring_3 is stuck at .* from stop 101 on"):
        run(replace(made, recording=replace(made.recording, scans=stuck)))
    scans = made.recording.scans
    skipped = replace(made.recording, scans=scans.chosen(np.r_[0:40, 45:320]))
    with pytest.raises(FitError, match=r"the count of bumps is in doubt at scan 4\d, the turns do not close"):
        run(replace(made, recording=skipped))
