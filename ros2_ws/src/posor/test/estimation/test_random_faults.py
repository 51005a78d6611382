# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Random faults against the truth: no wrong pose is usable, and sound scans outside a latch stay OK."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from posor.calibration.designs import sized_design
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.fault import Fault, State
from posor.model.native_coordinates import native_from_rotation, rotation_from_native
from posor.model.scan import NO_SOURCE, Scan, Scans
from posor.numerics.array_types import FloatArray
from posor_lab.harness.random_poses import TICK_NS, errors_in_parent

RUNS, COUNT, ONSET = 40, 400, 50
RUN_SEED = 20

DESIGNS = ("triad_bumpy_ring", "triad_light_ring", "quad_light_ring")


def moving(posor: Posor, random: np.random.Generator) -> tuple[Scans, FloatArray, FloatArray]:
    """Noisy scans at 1 kHz of a joint that oscillates with random phases, within half its limits of motion."""
    time, phases = np.arange(COUNT) * 1e-3, random.uniform(0.0, 2.0 * math.pi, 6)
    rates = random.uniform(0.2, 3.0, 6) * 2.0 * math.pi

    def wave(i: int, most: float, fastest: float) -> FloatArray:
        return np.asarray(min(most, 0.5 * fastest / rates[i]) * np.sin(rates[i] * time + phases[i]))

    natives = [wave(0, 4e-4, 0.02), wave(1, 4e-4, 0.02), wave(2, 0.5, 3.0)]
    rotations = np.array([rotation_from_native(*native) for native in np.transpose(natives)])
    translations = np.column_stack([wave(3, 5e-5, 0.02), wave(4, 5e-5, 0.02), 0.72e-3 + wave(5, 1e-4, 0.02)])
    stamps = np.arange(1, COUNT + 1, dtype=np.int64) * TICK_NS
    scans = scans_at(posor.stack, rotations, translations, stamps, noise=random).editable()
    scans.supply_voltages[:], scans.temperatures[:], scans.reference_voltages[:] = 15.0, 293.15, 5.0
    return scans, rotations, translations


def shifted_gap(scans: Scans, span: slice, random: np.random.Generator) -> None:
    """At least twice the 60 mV that the gate of the motion sees: 0.12 V are 14 um."""
    size = random.choice([-1.0, 1.0]) * random.uniform(0.12, 1.5)
    scans.gap_voltages[span, random.integers(scans.gap_voltages.shape[1])] += size


def stuck_gap(scans: Scans, span: slice, random: np.random.Generator) -> None:
    probe = random.integers(scans.gap_voltages.shape[1])
    scans.gap_voltages[span, probe] = 0.0 if abs(scans.gap_voltages[span.start, probe]) > 0.2 else 2.0


def all_frozen(scans: Scans, span: slice, random: np.random.Generator) -> None:
    del random
    for readings in (scans.gap_voltages, scans.ring_voltages, scans.diode_currents):
        readings[span] = readings[span.start - 1]


def invalid_supply(scans: Scans, span: slice, random: np.random.Generator) -> None:
    scans.supply_voltages[span] = random.choice([0.0, 16.0, math.inf])


def invalid_temperature(scans: Scans, span: slice, random: np.random.Generator) -> None:
    scans.temperatures[span] = random.choice([0.0, 20.0, 313.0, -math.inf])


def spurious_marks(scans: Scans, span: slice, random: np.random.Generator) -> None:
    scans.at_home[span] = random.integers(0, 2, len(scans.at_home[span]))


def slipped_sources(scans: Scans, span: slice, random: np.random.Generator) -> None:
    if scans.lit_sources.shape[1]:
        lit = scans.lit_sources[span]
        lit[:] = (lit + random.integers(1, lit.max())) % (lit.max() + 1)


def unlit(scans: Scans, span: slice, random: np.random.Generator) -> None:
    if scans.lit_sources.shape[1]:
        scans.lit_sources[span, random.integers(scans.lit_sources.shape[1])] = NO_SOURCE


def missing(scans: Scans, span: slice, random: np.random.Generator) -> None:
    scans.gap_voltages[span, random.integers(scans.gap_voltages.shape[1])] = math.nan


FAULTS: tuple[Callable[[Scans, slice, np.random.Generator], None], ...] = (
    shifted_gap,
    stuck_gap,
    all_frozen,
    invalid_supply,
    invalid_temperature,
    spurious_marks,
    slipped_sources,
    unlit,
    missing,
)


@pytest.mark.parametrize("name", DESIGNS)
def test_no_wrong_pose_is_usable(name: str) -> None:
    posor = Posor(sized_design(name, 0.1524, frames=("receiving", "target"), title=name))  # type: ignore[arg-type]
    random = np.random.default_rng(RUN_SEED)
    sound_scans = sound_ok = faulted = detected = 0
    for run in range(RUNS):
        posor.reset()
        scans, rotations, translations = moving(posor, random)
        before, fault = scans._records.copy(), FAULTS[run % len(FAULTS)]
        begin = ONSET + int(random.integers(0, 100))
        span = slice(begin, begin + int(random.choice([1, 2, 3, 10, 300])))
        fault(scans, span, random)
        changed = scans._records != before
        posor.confirm_theta(native_from_rotation(rotations[0])[2], 1e-3)
        found = posor.estimate_all(scans)
        usable = np.isin(found.states, [State.OK, State.DEGRADED])
        total = found.covariances()[usable]
        sigmas = np.sqrt(np.diagonal(total, axis1=1, axis2=2))
        true = rotations[usable], translations[usable]
        errors = errors_in_parent(found.rotations[usable], found.translations[usable], *true)
        worst = (np.abs(errors) / sigmas).max(axis=1)
        assert worst.max() < 5.0, f"{fault.__name__}, run {run}: {np.flatnonzero(usable)[worst.argmax()]} of {span}"
        faulted, detected = faulted + changed.sum(), detected + (changed & ~usable).sum()
        # Readings of a ring that has lost its count contradict one another at a wrong bump.
        expected = Fault.LATCHED if posor.tracker["counted"] else Fault.LATCHED | Fault.RESIDUAL
        sound = ~changed & (found.faults & expected == 0) & (found.states != State.UNCOUNTED)
        sound_scans, sound_ok = sound_scans + sound.sum(), sound_ok + (sound & (found.states == State.OK)).sum()
    assert sound_ok >= 0.998 * sound_scans
    assert detected > 0.5 * faulted


@pytest.mark.parametrize("name", DESIGNS)
def test_one_scan_many_and_a_fault_give_the_same(name: str) -> None:
    """The latch depends on the scans alone, not on how many are estimated in one call."""
    posor = Posor(sized_design(name, 0.1524, frames=("receiving", "target"), title=name))  # type: ignore[arg-type]
    scans, rotations, _ = moving(posor, np.random.default_rng(5))
    theta = native_from_rotation(rotations[0])[2]
    shifted_gap(scans, slice(80, 82), np.random.default_rng(6))
    spurious_marks(scans, slice(100, 104), np.random.default_rng(7))
    all_frozen(scans, slice(120, 123), np.random.default_rng(8))
    posor.confirm_theta(theta, 1e-3)
    together = posor.estimate_all(scans)
    posor.reset()
    posor.confirm_theta(theta, 1e-3)
    singles: list[Scan] = [scans[n] for n in range(len(scans))]
    alone = [posor.estimate(scan) for scan in singles]
    assert [estimate.state for estimate in alone] == together.states.tolist()
    assert [estimate.faults for estimate in alone] == together.faults.tolist()
    assert {State.OK, State.LOST} <= set(together.states.tolist())
