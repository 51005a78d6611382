# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Profile of a bumpy ring: simulated full turns of a ring whose true profile is known."""

from __future__ import annotations

import numpy as np
import pytest
from posor.bags.recording import Recording, Track
from posor.calibration.calibration_file import Calibration, calibration_from
from posor.calibration.designs import design
from posor.errors import FitError, TrackError
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.native_coordinates import rotation_from_native
from posor.numerics.array_types import FloatArray
from posor_calibration.procedure import Outcome
from posor_calibration.procedures.ring_profile import PROCEDURE
from posor_lab.harness.simulated_recordings import without_uncertainties

from .simulated_case import SimulatedCase, check_coverage

THETA = "/theta"
THETA_SIGMA = 2e-6
RUNOUT = 1e-6
AMPLITUDE = 1e-6
RADIUS = 5e-6
CAMPAIGNS = 8
ORDERS = (1, 2, 3, 4, 35, 36, 37, 38, 72, 108)  # of the true ring; the calibration has 1, 2, 36, 72, 108
OBSERVABLE = ("cos 36", *(f"{phase} {order}" for order in (2, 4, 38, 72, 108) for phase in ("cos", "sin")))
"""Amplitudes that turns without a reference determine."""
OPTIONS = {"orders": ORDERS, "expected_amplitude": AMPLITUDE}


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


def simulate(random: np.random.Generator, turns: float = 1.5, count: int = 320, first: float = 0.0) -> SimulatedCase:
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
    return SimulatedCase(PROCEDURE, without_uncertainties(design("triad_bumpy_ring")), recording, truth)


def normalised_errors(case: SimulatedCase, outcome: Outcome, names: tuple[str, ...]) -> FloatArray:
    fit = outcome.fits["ring_profile"]
    return np.array([(fit.value(name) - case.truth[name]) / fit.sigma(name) for name in names])


@pytest.mark.long
def test_full_turns_determine_the_even_orders(rng: np.random.Generator) -> None:
    errors = []
    for _ in range(CAMPAIGNS):
        case = simulate(rng)
        outcome = case.identify(**OPTIONS)
        errors.append(normalised_errors(case, outcome, OBSERVABLE))
    check_coverage(errors, 0.06, 0.25)
    fit = outcome.fits["ring_profile"]
    assert max(fit.sigma(name) for name in ("cos 2", "cos 4", "cos 36", "cos 38")) < 0.05e-6
    [sentence] = [warning for warning in outcome.warnings if "cannot be separated from runout" in warning]
    assert sentence.startswith("Orders 1, 3, 35, 36, 37 cannot be separated")
    assert "a reference of theta or runout_sigma would determine more" in sentence


def test_references_determine_the_others(rng: np.random.Generator) -> None:
    case = simulate(rng)
    outcome = case.identify(theta=THETA, runout_sigma=RUNOUT, **OPTIONS)
    names = tuple(f"{name} {k}" for k in ORDERS for name in ("cos", "sin"))
    assert np.max(np.abs(normalised_errors(case, outcome, names))) < 4.0
    assert outcome.fits["ring_profile"].sigma("sin 36") < 0.02e-6
    assert outcome.fits["ring_profile"].spread == pytest.approx(1.0, abs=0.08)
    assert not any("cannot be separated" in sentence for sentence in outcome.warnings)


def test_each_value_of_a_reference_counts_once(rng: np.random.Generator) -> None:
    single = simulate(rng)
    scans = single.recording.scans.select(np.repeat(np.arange(320), 2))
    twice = single.with_scans(scans.with_fields({"stamps_ns": scans.stamps_ns + np.tile([0, 10], 320)}))
    found, expected = (case.identify(theta=THETA, **OPTIONS).fits["ring_profile"] for case in (twice, single))
    assert found.sigmas == pytest.approx(expected.sigmas, rel=1e-3)


@pytest.mark.long
def test_the_new_profile_measures_better(rng: np.random.Generator) -> None:
    case = simulate(rng)
    (part,) = case.identify(theta=THETA, runout_sigma=RUNOUT, **OPTIONS).parts
    assert part.key == "sensors[1].ring"
    content = case.calibration.model_dump(mode="json")
    content["sensors"][1]["ring"] = part.content
    rms = []
    for calibration in (case.calibration, calibration_from(content)):
        found = Posor(calibration, false_alarm=0.0).estimate_all(case.recording.scans)
        rms.append(float(np.std(found.thetas - case.reference.values[:, 0])))
    assert rms[1] < 0.2 * rms[0]


@pytest.mark.long
def test_turns_are_counted_by_the_reference(rng: np.random.Generator) -> None:
    method = simulate(rng, turns=2.0, count=400).identify(theta=THETA, **OPTIONS).method
    assert method.startswith("self-calibration over 2.00 turns, 400 scans")
    method = simulate(rng, turns=1.5).identify(**OPTIONS).method
    assert method.startswith("self-calibration over 1.50 turns, 320 scans")
    # A small oscillation where the POSOR's own theta wraps from pi to -pi is no turn.
    small = simulate(rng, turns=0.2 / (2.0 * np.pi), first=np.pi - 0.1)
    sentence = r"ring_profile, simulated: 0\.03 of a turn; expected at least a full turn"
    small.check_refusal(FitError, sentence, theta=THETA, **OPTIONS)


def test_bad_data(rng: np.random.Generator) -> None:
    half = simulate(rng, turns=0.5, count=320)
    half.check_refusal(FitError, r"ring_profile, simulated: 0\.50 of a turn; expected at least a full turn", **OPTIONS)
    case = simulate(rng, count=320)
    case.check_refusal(TrackError, "there is no reference /phi", theta="/phi", **OPTIONS)
    scans = case.recording.scans
    for changed, sentence in (
        (
            scans.with_fields({"at_home": np.zeros(320, dtype=np.int64)}),
            "no scan with a pose saw the home mark; expected at least one",
        ),
        (scans.select(np.r_[0:40, 45:320]), r"the count of bumps is in doubt at scan 4\d; expected home marks at"),
    ):
        case.with_scans(changed).check_refusal(FitError, sentence, **OPTIONS)
