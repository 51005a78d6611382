# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faults latch the joint out: short ones are left by themselves, lasting ones by a reference or an operator."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from posor.calibration.calibration_file import calibration_from
from posor.calibration.designs import BUMPS, design, sized_design
from posor.errors import ParameterError
from posor.estimation.clocks import LATE_RUN
from posor.estimation.estimate import Estimates
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.estimation.scan_checks import MARKS, RESIDUAL_RUN, SAME_THETA
from posor.model.fault import Fault, State
from posor.model.native_coordinates import rotation_from_native
from posor.model.scan import NO_SOURCE, STATED_HOME, Scans
from posor.numerics.array_types import FloatArray
from posor.numerics.vector import thetas_of
from posor_lab.harness.random_poses import TICK_NS, errors_in_parent, turning_scans

INCH = 0.0254
COUNT = 4000
ONSET = 500


def sized(name: str) -> Posor:
    return Posor(sized_design(name, 6.0 * INCH, frames=("receiving", "target"), title=name))  # type: ignore[arg-type]


def oscillating(posor: Posor, seed: int = 1, count: int = COUNT) -> tuple[Scans, FloatArray, FloatArray]:
    """Noisy scans at 1 kHz of a joint that oscillates widely in all freedoms, counted at once; the true poses.

    ``posor``: a sized one.
    """
    scans, rotations, translations = simulated(posor.calibration.name, seed, count)
    return scans.editable(), rotations, translations


@cache
def simulated(name: str, seed: int, count: int) -> tuple[Scans, FloatArray, FloatArray]:
    time = np.arange(count) * 1e-3
    thetas = 0.3 * np.sin(2.0 * math.pi * 0.7 * time)
    alphas, betas = 4e-4 * np.sin(2.0 * math.pi * 1.9 * time), 4e-4 * np.cos(2.0 * math.pi * 2.3 * time)
    rotations = np.array([rotation_from_native(a, b, t) for a, b, t in zip(alphas, betas, thetas, strict=True)])
    translations = np.column_stack(
        [5e-5 * np.sin(9.0 * time), 5e-5 * np.cos(7.0 * time), 0.72e-3 + 1e-4 * np.sin(11.0 * time)]
    )
    stamps = np.arange(1, count + 1, dtype=np.int64) * TICK_NS
    scans = scans_at(sized(name).stack, rotations, translations, stamps, noise=np.random.default_rng(seed)).editable()
    scans.at_home[0] = STATED_HOME
    scans.supply_voltages[:], scans.temperatures[:] = 15.0, 293.15
    return scans, rotations, translations


def wrong(found: Estimates, translations: FloatArray, rotations: FloatArray) -> FloatArray:
    """Return which estimates are usable and beyond 5 standard deviations in z, lean or theta, (n,)."""
    usable = np.isin(found.states, [State.OK, State.DEGRADED])
    out = np.zeros(len(usable), dtype=bool)
    errors = errors_in_parent(
        found.rotations[usable], found.translations[usable], rotations[usable], translations[usable]
    )
    total = found.covariances()
    sigmas = np.sqrt(np.diagonal(total, axis1=1, axis2=2))[usable]
    out[usable] = (np.abs(errors) > 5.0 * sigmas).any(axis=1)
    return out


@pytest.mark.parametrize("name", ["triad_bumpy_ring", "triad_light_ring"])
@pytest.mark.parametrize("volts", [0.1, 0.3, 1.0, None])
def test_a_lasting_fault_of_a_gap_probe_is_never_accepted_by_chance(name: str, volts: float | None) -> None:
    posor = sized(name)
    for seed, onset in ((1, ONSET), (2, 777), (3, 1333)):
        posor.reset()
        scans, rotations, translations = oscillating(posor, seed)
        if volts is None:  # stuck
            scans.gap_voltages[onset:, 1] = 0.0 if abs(scans.gap_voltages[onset, 1]) > 0.3 else 3.0
        else:
            scans.gap_voltages[onset:, 1] += volts
        found = posor.estimate_all(scans)
        assert np.mean(found.states[:onset] == State.OK) > 0.99
        assert not wrong(found, translations, rotations).any()
        assert found.faults[-1] & Fault.LATCHED
        assert posor.latched & Fault.INNOVATION


@pytest.mark.parametrize("length", [1, 2, 3])
@pytest.mark.parametrize("name", ["triad_bumpy_ring", "triad_light_ring"])
def test_short_glitches_are_left_by_themselves(name: str, length: int) -> None:
    posor = sized(name)
    scans, rotations, translations = oscillating(posor)
    glitches = range(100, COUNT - 100, 100)
    for n in glitches:
        scans.gap_voltages[n : n + length, 0] += 1.0
    found = posor.estimate_all(scans)
    glitched = np.zeros(COUNT, dtype=bool)
    for n in glitches:
        glitched[n : n + length] = True
    assert (found.states[glitched] == State.LOST).all()
    assert np.mean(found.states[~glitched] == State.OK) >= 0.998
    assert not wrong(found, translations, rotations).any()


@pytest.mark.parametrize(("length", "is_left"), [(12, True), (18, True), (20, False), (40, False)])
@pytest.mark.parametrize("seed", range(4))
def test_a_burst_of_disturbances_is_left_by_itself_within_20_ms(seed: int, length: int, *, is_left: bool) -> None:
    posor = Posor(design("triad_light_ring", motion=True))
    scans = turning_scans(posor, 0.3 * np.sin(2.0 * math.pi * 0.7 * np.arange(400) * 1e-3), seed)
    scans.gap_voltages[100 : 100 + length] += 1.0
    found = posor.estimate_all(scans)
    assert (found.states[:100] == State.OK).all()
    assert (found.states[100 : 100 + length] == State.LOST).all()
    assert set(found.states[100 + length :]) == {State.OK if is_left else State.LOST}


def test_a_lasting_fault_is_acknowledged_by_the_operator() -> None:
    posor = sized("triad_light_ring")
    scans, _, _ = oscillating(posor)
    scans.gap_voltages[100:200, 0] += 1.0
    found = posor.estimate_all(scans.part(0, 300))
    assert (found.states[100:] == State.LOST).all()
    assert found.faults[299] == Fault.INNOVATION | Fault.LATCHED
    assert "or ~/acknowledge is called" in posor.estimate(scans[300]).reason
    assert posor.acknowledge()
    released = posor.estimate(scans[301])
    assert (released.state, released.faults) == (State.DEGRADED, Fault.ACKNOWLEDGED)
    assert "~/acknowledge" in released.reason
    assert not posor.acknowledge()
    assert posor.estimate(scans[302]).state is State.DEGRADED
    posor.confirm_theta(float(posor.estimate(scans[303]).native[5]), 1e-3)
    assert posor.estimate(scans[304]).state is State.OK


def test_the_gate_does_not_widen_after_a_fault_nor_after_a_restart() -> None:
    posor = sized("triad_light_ring")
    scans, _, _ = oscillating(posor)
    scans.gap_voltages[100:, 0] += 1.0
    posor.estimate_all(scans.part(0, 200))
    other = Posor(posor.calibration)
    other.continue_from(posor)  # as after ~/reload
    later = scans.part(1000, 1100)
    assert (other.estimate_all(later).states == State.LOST).all()
    back = scans.part(50, 99)  # the stamps go back
    assert (posor.estimate_all(back).states == State.LOST).all()


def test_missing_scans_without_a_fault_widen_the_gate() -> None:
    posor = sized("triad_light_ring")
    scans, _, _ = oscillating(posor)
    assert posor.estimate_all(scans.part(0, 100)).states[-1] == State.OK
    assert posor.estimate(scans[600]).state is State.OK


@pytest.mark.parametrize(("missing", "state"), [(3, State.OK), (60, State.UNCOUNTED)])
def test_a_count_that_nobody_followed_for_long_is_given_up(missing: int, state: State) -> None:
    """The joint stands still in the pause, at its turning point, but it could have turned by half a bump."""
    posor = sized("triad_bumpy_ring")
    scans, _, _ = oscillating(posor)
    assert posor.estimate_all(scans.part(0, 330)).states[-1] == State.OK
    assert posor.estimate(scans[329 + missing]).state is state


@pytest.mark.parametrize("slip", [1, 5, 12, -1])
@pytest.mark.parametrize("first", [0, 100])
def test_light_sources_that_slip_are_lost(slip: int, first: int) -> None:
    posor = sized("triad_light_ring")
    scans, rotations, translations = oscillating(posor)
    sources = len(posor.calibration.sensors[1].model_dump()["light_sources"])
    lit = scans.lit_sources.copy()
    lit[first:700] = (lit[first:700] + slip) % sources
    scans = scans.with_fields({"lit_sources": lit})
    found = posor.estimate_all(scans)
    assert not wrong(found, translations, rotations).any()
    assert (found.states[first:700] == State.LOST).all()
    if first == 0:  # nothing was accepted before; the angles at which the slip was seen were wrong
        posor.acknowledge()
        assert np.isin(posor.estimate_all(scans.part(710, 1000)).states, [State.OK, State.DEGRADED]).mean() > 0.99


def even_ring() -> Posor:
    content = design("triad_light_ring", motion=True).model_dump(mode="json")
    sources = content["sensors"][1]["light_sources"]
    for i, source in enumerate(sources):
        phi = 2.0 * math.pi * i / len(sources)
        source["origin"]["value"][:2] = [0.044 * math.cos(phi), 0.044 * math.sin(phi)]
    for diode, phi in zip(content["sensors"][1]["diodes"], (0.25 * math.pi, 1.25 * math.pi), strict=True):
        diode["origin"]["value"][:2] = [0.044 * math.cos(phi), 0.044 * math.sin(phi)]
    return Posor(calibration_from(content))


def test_an_even_light_ring_is_uncounted_until_a_reference_confirms_it() -> None:
    posor = even_ring()
    thetas = np.linspace(0.1, 0.5, 400)
    scans = turning_scans(posor, thetas)
    assert (posor.estimate_all(scans.part(0, 100)).states == State.UNCOUNTED).all()
    posor.confirm_theta(thetas[100], 0.01)
    found = posor.estimate_all(scans.part(100, 400))
    assert (found.states == State.OK).all()
    assert found.thetas == pytest.approx(thetas[100:], abs=1e-9)


def test_an_even_light_ring_that_has_slipped_is_refused_by_the_encoder() -> None:
    posor = even_ring()
    thetas = np.linspace(0.1, 0.5, 400)
    scans = turning_scans(posor, thetas)
    slipped = scans.with_fields({"lit_sources": (scans.lit_sources + 1) % 36})
    assert (posor.estimate_all(slipped.part(0, 100)).states == State.UNCOUNTED).all()
    posor.confirm_theta(thetas[100], 0.01)
    refused = posor.estimate(slipped[100])
    assert (refused.state, refused.faults & Fault.ENCODER) == (State.LOST, Fault.ENCODER)
    assert (posor.estimate_all(slipped.part(101, 200)).states == State.LOST).all()
    posor.confirm_theta(thetas[200], 0.01)
    assert posor.estimate(slipped[200]).state is State.LOST
    assert posor.acknowledge()
    posor.confirm_theta(thetas[201], 0.01)
    assert posor.estimate(scans[201]).state is State.OK


def test_a_slip_after_counting_latches_until_the_encoder_agrees() -> None:
    posor = even_ring()
    thetas = np.linspace(0.1, 0.5, 400)
    scans = turning_scans(posor, thetas)
    slipped = scans.with_fields({"lit_sources": (scans.lit_sources + 1) % 36})
    posor.confirm_theta(thetas[0], 0.01)
    assert (posor.estimate_all(scans.part(0, 100)).states == State.OK).all()
    assert (posor.estimate_all(slipped.part(100, 150)).states == State.LOST).all()
    assert (posor.estimate_all(scans.part(150, 160)).states == State.LOST).all()  # too late to be regained
    posor.confirm_theta(thetas[160], 0.01)
    found = posor.estimate_all(scans.part(160, 200))
    assert (found.states == State.OK).all()
    assert found.thetas == pytest.approx(thetas[160:200], abs=1e-9)


@pytest.mark.parametrize("name", ["triad_bumpy_ring", "triad_light_ring", "triad_diodes"])
def test_an_encoder_that_disagrees_is_latched_until_it_agrees(name: str) -> None:
    posor = Posor(design(name, motion=True))  # type: ignore[arg-type]
    thetas = np.linspace(0.0, 0.05, 200)
    scans = turning_scans(posor, thetas, home=[0])
    assert (posor.estimate_all(scans.part(0, 50)).states == State.OK).all()
    posor.confirm_theta(thetas[50] + 0.06, 0.01)
    lost = posor.estimate(scans[50])
    assert (lost.state, lost.faults) == (State.LOST, Fault.ENCODER)
    assert "encoder" in lost.reason
    assert (posor.estimate_all(scans.part(51, 100)).faults == Fault.ENCODER | Fault.LATCHED).all()
    posor.confirm_theta(thetas[100], 0.01)
    found = posor.estimate_all(scans.part(100, 200))
    assert (found.states == State.OK).all()
    assert found.thetas == pytest.approx(thetas[100:], abs=1e-9)


def test_an_encoder_that_has_disagreed_does_not_count_a_bumpy_ring() -> None:
    """An encoder of the wrong sign agrees with some bump at some angles, as where the joint rests; marks count it."""
    posor = Posor(design("triad_bumpy_ring", motion=True))
    bump = 2.0 * math.pi / BUMPS
    there, back = np.linspace(2.3 * bump, 4.0 * bump, 200), np.linspace(4.0 * bump, 0.0, 400)
    thetas = np.r_[there, np.full(100, 4.0 * bump), back, np.zeros(10)]
    count = len(thetas)
    scans = turning_scans(posor, thetas, marks=range(count - 10, count))
    states = []
    for n in range(count):
        posor.confirm_theta(-thetas[n], 1e-3)
        states.append(posor.estimate(scans[n]).state)
    counted = count - 10 + MARKS - 1
    assert set(states[:counted]) == {State.LOST}
    assert set(states[counted:]) == {State.OK}


def test_an_encoder_counts_a_bumpy_ring_modulo_whole_turns() -> None:
    posor = Posor(design("triad_bumpy_ring", motion=True))
    thetas = np.linspace(1.0, 1.1, 100)
    scans = turning_scans(posor, thetas)
    assert (posor.estimate_all(scans.part(0, 50)).states == State.UNCOUNTED).all()
    posor.confirm_theta(thetas[50] + 0.02 - 4.0 * math.pi, 0.01)
    found = posor.estimate_all(scans.part(50, 100))
    assert (found.states == State.OK).all()
    assert found.thetas == pytest.approx(thetas[50:], abs=1e-9)


@pytest.mark.parametrize(
    "reference",
    [
        *((math.nan, 0.01), (0.0, 0.0), (0.0, -1.0), (math.inf, 0.1), (0.0, 0.02)),
        *((0.0, 0.01, 0), (0.0, 0.01, -1), (0.0, 0.01, 1e18)),
    ],
)
def test_a_reference_that_says_nothing_is_refused(reference: tuple[Any, ...]) -> None:
    posor = Posor(design("triad_bumpy_ring"))
    with pytest.raises(ParameterError, match="confirm_theta"):
        posor.confirm_theta(*reference)


def test_unlit_sources_latch_when_they_last() -> None:
    posor = sized("triad_light_ring")
    scans, _, _ = oscillating(posor)
    lit = scans.lit_sources.copy()
    lit[[100, 101, 102]] = NO_SOURCE
    lit[200:210] = NO_SOURCE
    found = posor.estimate_all(scans.with_fields({"lit_sources": lit}).part(0, 300))
    assert (found.states[103:200] == State.OK).mean() > 0.98
    assert (found.states[200:] == State.LOST).all()
    assert found.faults[299] == Fault.SOURCE | Fault.LATCHED
    posor.confirm_theta(float(0.3 * np.sin(2.0 * math.pi * 0.7 * 0.3)), 0.01)
    assert posor.estimate(scans[300]).state is State.OK


def test_a_lasting_contradiction_is_latched_until_it_has_passed_for_as_long_where_it_was() -> None:
    posor = sized("triad_light_ring")
    scans, rotations, _ = oscillating(posor)
    scans.diode_currents[100 : 100 + RESIDUAL_RUN, 0, 0] *= 1.01
    scans.diode_currents[300:305, 0, 0] *= 1.01
    scans.diode_currents[200, 0, 0] *= 1.03  # a single reading elsewhere; its chi-square is larger
    found = posor.estimate_all(scans)
    assert found.faults[100] & Fault.RESIDUAL
    assert found.faults[100 + RESIDUAL_RUN] & Fault.LATCHED
    passes = np.flatnonzero(np.abs(thetas_of(rotations) - thetas_of(rotations[100:101])) < SAME_THETA)
    first, released = passes[passes > 300][[0, RESIDUAL_RUN]]  # the joint comes by a few scans at a time
    assert (found.states[100 : first - RESIDUAL_RUN] == State.LOST).all()
    assert (found.states[released + 30 :] == State.OK).mean() > 0.98


def test_without_limits_of_motion_nothing_is_latched() -> None:
    posor = Posor(design("triad_diodes"))
    scans = turning_scans(posor, np.linspace(0.0, 0.05, 100))
    scans.gap_voltages[50:, 0] += 0.3
    lit = scans.lit_sources.copy()
    lit[20:30] = NO_SOURCE
    found = posor.estimate_all(scans.with_fields({"lit_sources": lit}))
    assert (found.states[30:] == State.OK).all()
    assert posor.latched == Fault.NONE


def test_a_reference_judges_only_the_scan_it_was_given_for() -> None:
    content = design("triad_diodes").model_dump(mode="json", exclude_none=True)
    first, second = content["sensors"][1]["diodes"]
    second["origin"] = first["origin"]  # both diodes see the same spot: no reading is about theta
    content["sensors"][1]["light_sources"][1]["origin"] = content["sensors"][1]["light_sources"][0]["origin"]
    posor = Posor(calibration_from(content))
    scans = turning_scans(posor, np.array([0.0]))
    posor.confirm_theta(0.0, 0.01)
    assert posor.estimate(scans[0]).faults == Fault.ILL_CONDITIONED
    assert posor.tracker["reference_sigma"] == 0.0


def test_a_stamp_that_does_not_go_on_costs_its_scan_and_not_the_gate() -> None:
    posor = sized("quad_light_ring")
    scans, rotations, translations = oscillating(posor, count=1000)
    scans.stamps_ns[500] = scans.stamps_ns[499]
    scans.gap_voltages[500:] += 2.0  # all probes: the target seems to be elsewhere, without a contradiction
    found = posor.estimate_all(scans)
    assert (found.states[500], found.faults[500]) == (State.LOST, Fault.BAD_READING)
    assert "contradicts its number" in found.reason(500)
    assert found.faults[501] & Fault.INNOVATION
    assert not wrong(found, translations, rotations).any()
    posor.reset()
    scans.gap_voltages[500:] -= 2.0
    assert (posor.estimate_all(scans).states[501:] == State.OK).mean() > 0.99


@pytest.mark.parametrize("biased", [False, True])
def test_a_clock_that_is_set_back_keeps_the_gate(biased: bool) -> None:  # noqa: FBT001
    posor = sized("quad_light_ring")
    scans, rotations, translations = oscillating(posor, count=1000)
    scans.stamps_ns[500:] -= 3600 * 10**9
    if biased:
        scans.gap_voltages[500:] += 2.0
    found = posor.estimate_all(scans)
    assert (found.states[500 + LATE_RUN :] == (State.LOST if biased else State.OK)).mean() > 0.99
    assert not wrong(found, translations, rotations).any()


def test_a_recording_that_starts_over_is_estimated_anew() -> None:
    posor = sized("quad_light_ring")
    scans, _, _ = oscillating(posor, count=300)
    first = posor.estimate_all(scans)
    posor.reset()
    again = posor.estimate_all(scans)
    assert (first.states == again.states).all()
    np.testing.assert_allclose(again.translations, first.translations, rtol=0.0, atol=1e-12)


def test_an_encoder_releases_theta_and_not_a_position_that_jumped() -> None:
    posor = sized("quad_light_ring")
    scans, rotations, _ = oscillating(posor, count=1000)
    scans.lit_sources[500:502] = NO_SOURCE
    scans.gap_voltages[500:] += 2.0
    thetas = np.arctan2(-rotations[:, 0, 1], rotations[:, 1, 1])
    assert (posor.estimate_all(scans.part(0, 502)).states[:500] == State.OK).mean() > 0.99
    for n in range(502, 520):
        posor.confirm_theta(thetas[n], 1e-3)
        assert posor.estimate(scans[n]).state is State.LOST
    assert (posor.estimate_all(scans.part(520, 1000)).states == State.LOST).all()


@pytest.mark.parametrize("biased", [False, True])
def test_a_new_calibration_keeps_the_gate(biased: bool) -> None:  # noqa: FBT001
    before = sized("quad_light_ring")
    scans, _, _ = oscillating(before, count=600)
    before.estimate_all(scans.part(0, 500))
    after = Posor(before.calibration)
    after.continue_from(before, scans[499])
    if biased:
        scans.gap_voltages[500:] += 2.0
    found = after.estimate_all(scans.part(500, 600))
    assert (found.states == (State.LOST if biased else State.OK)).mean() > 0.98
    assert bool(found.faults[0] & Fault.INNOVATION) is biased


@pytest.mark.parametrize("is_given", [True, False])
def test_a_new_calibration_gives_up_a_count_that_nobody_followed(*, is_given: bool) -> None:
    """As ``~/reload`` while a connector is out and the joint moves on."""
    before = sized("quad_bumpy_ring")
    scans, _, _ = oscillating(before, count=1000)
    scans.gap_voltages[300:900] = math.nan
    assert (before.estimate_all(scans.part(0, 900)).states[300:] == State.LOST).all()
    after = Posor(before.calibration)
    after.continue_from(before, scans[899] if is_given else None)
    assert not np.isin(after.estimate_all(scans.part(900, 1000)).states, [State.OK, State.DEGRADED]).any()


def test_a_calibration_with_another_home_mark_keeps_a_latch() -> None:
    before = sized("quad_bumpy_ring")
    scans, rotations, _ = oscillating(before, count=800)
    scans.gap_voltages[500:] += 2.0
    before.estimate_all(scans.part(0, 600))
    assert before.latched & Fault.INNOVATION
    after = Posor(before.calibration)
    after.settings["home_theta"] += 1e-3
    after.continue_from(before, scans[599])
    assert after.latched == before.latched
    after.confirm_theta(np.arctan2(-rotations[600, 0, 1], rotations[600, 1, 1]), 1e-3)
    assert (after.estimate_all(scans.part(600, 800)).states == State.LOST).all()
    assert after.acknowledge()
    assert not after.latched


def test_a_count_is_given_up_where_scans_are_missing_after_the_first() -> None:
    posor = sized("quad_bumpy_ring")
    scans, _, _ = oscillating(posor, count=1000)
    kept = np.r_[0:1, 700:1000]
    found = posor.estimate_all(scans.select(kept))
    assert found.states[0] == State.OK
    assert (found.states[1:] == State.UNCOUNTED).all()


def test_without_limits_of_motion_a_gap_does_not_end_the_count() -> None:
    posor = Posor(design("triad_bumpy_ring"))
    scans = turning_scans(posor, np.full(100, 0.02), home=[0])
    kept = np.r_[0:20, 40:100]
    assert (posor.estimate_all(scans.select(kept)).states == State.OK).all()
