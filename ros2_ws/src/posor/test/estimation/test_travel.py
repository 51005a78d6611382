# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses beyond the travel of the bearing, and readings that contradict one another at some angles only."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from posor.calibration.calibration_file import Calibration, calibration_from
from posor.calibration.designs import STANDOFF, sized_design, travel_limits
from posor.estimation.estimate import Estimates
from posor.estimation.posor import Posor
from posor.estimation.scan_checks import RESIDUAL_RUN
from posor.model.fault import Fault, State
from posor.model.native_coordinates import rotation_from_native
from posor.model.scan import Scans
from posor.numerics.array_types import FloatArray
from posor.uncertainty.protection_level import joint_protection_levels
from posor_lab.harness.random_poses import errors_in_parent
from posor_lab.true_scans import TruePosor

PERIOD_NS = 10_000_000  # 100 Hz
COUNT, RESTART, PAUSE_NS = 900, 200, 3_000_000_000
HALF_RANGE, LEAN = 5e-5, 2e-4
USABLE = [State.OK, State.DEGRADED]
GAIN = {"name": "gain of amplifiers", "moves": "all gap probes", "unit": "1", "unlimited": True, "source": "reset"}


def joint(name: str = "checked_light_ring", *, travel: bool = True, causes: tuple[Any, ...] = ()) -> Calibration:
    made = sized_design(name, 0.1524, frames=("receiving", "target"), title="joint")  # type: ignore[arg-type]
    content = made.model_dump(mode="json", exclude_none=True)
    content["causes"] = list(causes)
    if travel:
        content["motion"]["travel"] = travel_limits(STANDOFF, HALF_RANGE, LEAN)
    return calibration_from(content)


MISTAKES = (
    ("gap", [1.0, -1.0], "gap \\[1.0, -1.0\\]; expected \\[lowest, highest\\]"),
    ("gap", 1.0, "travel.gap\n.*one number; expected 2 numbers"),
    ("lean", 0.0, "lean 0 rad"),
    ("gap", [0.685, 0.785], "gap \\[0.685, 0.785\\]; expected .* less than 0.01 m"),
    ("lean", 0.2, "lean 0.2 rad"),
)


@pytest.mark.parametrize(("key", "value", "what"), MISTAKES)
def test_an_invalid_travel_is_refused(key: str, value: Any, what: str) -> None:
    content = joint().model_dump(mode="json")
    content["motion"]["travel"][key]["value"] = value
    with pytest.raises(ValueError, match=what):
        calibration_from(content)


def test_the_travel_needs_version_3_and_changes_the_hash() -> None:
    assert joint().content_hash != joint(travel=False).content_hash
    content = joint("quad_light_ring").model_dump(mode="json", exclude_none=True)
    for key in ("environment", "converter", "causes"):
        content.pop(key, None)
    content["motion"].pop("acceleration")
    with pytest.raises(ValueError, match="travel in a file of version 2"):
        calibration_from(content | {"version": 2})


def turning(calibration: Calibration, count: int = COUNT) -> tuple[Scans, FloatArray, FloatArray]:
    """Return scans by the independent truth, with a pause in which a device restarts; rotations and translations.

    The joint turns by 2 rad and back, with error motions of 30 urad and 3 um.
    """
    time_s = np.arange(count) * PERIOD_NS * 1e-9
    thetas = 0.5 - np.cos(0.7 * time_s)
    rotations = np.array([rotation_from_native(3e-5 * math.cos(t), 3e-5 * math.sin(t), t) for t in thetas])
    translations = np.column_stack([3e-6 * np.cos(thetas), 3e-6 * np.sin(thetas), STANDOFF + 3e-6 * np.sin(2 * thetas)])
    stamps = (np.arange(count, dtype=np.int64) + 1) * PERIOD_NS
    stamps[RESTART:] += PAUSE_NS
    scans = TruePosor(calibration).scans_at(
        Posor(calibration).stack,
        rotations,
        translations,
        stamps,
        supply_voltages=np.full(count, 15.0),
        temperatures=np.full(count, 293.15),
        noise=np.random.default_rng(1),
    )
    scans = scans.editable()
    scans.numbers[:] = np.arange(count)
    scans.numbers[RESTART:] += PAUSE_NS // PERIOD_NS
    return scans, rotations, translations


def with_gain(scans: Scans, gain: float) -> Scans:
    volts = scans.gap_voltages.copy()
    volts[RESTART:] *= gain
    return scans.with_fields({"gap_voltages": volts})


def leans_off(found: Estimates, rotations: FloatArray, translations: FloatArray) -> FloatArray:
    """Return the largest error of each usable pose about X and Y [rad], (k,)."""
    return np.asarray(np.abs(errors_of_usable(found, rotations, translations)[:, 3:5]).max(axis=1))


def errors_of_usable(found: Estimates, rotations: FloatArray, translations: FloatArray) -> FloatArray:
    usable = np.isin(found.states, USABLE)
    return errors_in_parent(
        found.rotations[usable], found.translations[usable], rotations[usable], translations[usable]
    )


def test_a_common_gain_of_the_gap_probes_is_beyond_the_travel_and_latched() -> None:
    scans, rotations, translations = turning(joint())
    scans = with_gain(scans, 1.2)
    unaware = Posor(joint(travel=False)).estimate_all(scans)
    assert np.isin(unaware.states, USABLE)[RESTART:].mean() > 0.99
    assert leans_off(unaware, rotations, translations).max() > 2.5e-4  # the fault is there, and not seen
    posor = Posor(joint())
    found = posor.estimate_all(scans)
    assert np.all(found.states[:RESTART] == State.OK)
    assert np.all(found.states[RESTART:] == State.LOST)
    assert found.faults[RESTART] == Fault.TRAVEL
    single = Posor(joint()).estimate(scans[RESTART])
    pose = Posor(joint(travel=False)).estimate(scans[RESTART])
    assert pose.T_R_T is not None
    lean = math.acos(pose.T_R_T.rotation[2, 2])
    assert single.reason == (
        f"scan {scans.numbers[RESTART]}: a pose is beyond the travel of the bearing, by 'motion' of the calibration "
        f"(the last one: gap {pose.T_R_T.translation[2]:.4g} m, lean {lean:.3g} rad); "
        "expected a gap of 0.000685 to 0.000785 m and a lean of at most 0.0002 rad."
    )
    assert "(the last one: gap" in found.reason(RESTART + 1)  # also while it is latched
    assert posor.latched == Fault.TRAVEL


def test_a_latch_by_the_travel_outlasts_consistent_poses_until_somebody_acknowledges() -> None:
    scans, _, _ = turning(joint())
    volts = scans.gap_voltages.copy()
    volts[RESTART : RESTART + 50] *= 1.2
    posor = Posor(joint())
    found = posor.estimate_all(scans.with_fields({"gap_voltages": volts}).part(0, COUNT - 1))
    assert np.all(found.states[RESTART:] == State.LOST)
    assert found.faults[-1] == Fault.TRAVEL | Fault.LATCHED
    assert posor.acknowledge()
    assert posor.estimate(scans[COUNT - 1]).state is State.DEGRADED


def test_a_single_pose_beyond_the_travel_is_released_by_the_motion_before_it() -> None:
    scans, _, _ = turning(joint())
    volts = scans.gap_voltages.copy()
    volts[100] *= 1.2
    found = Posor(joint()).estimate_all(scans.with_fields({"gap_voltages": volts}).part(0, RESTART))
    assert found.states[100] == State.LOST
    assert np.all(found.states[101:] == State.OK)


def test_a_joint_that_begins_beyond_its_travel_has_no_pose_until_somebody_acknowledges() -> None:
    scans, _, _ = turning(joint())
    posor = Posor(joint())
    found = posor.estimate_all(with_gain(scans, 1.2).part(RESTART, COUNT))
    assert np.all(found.states == State.LOST)
    assert found.faults[0] == Fault.TRAVEL
    assert np.all(found.faults[1:] == Fault.TRAVEL | Fault.LATCHED)


def test_a_bumpy_ring_that_begins_at_another_bump_is_counted_by_its_home_mark() -> None:
    """By a wrong bump the tilt of the target plane leans beyond the travel, and the readings agree."""
    calibration = joint("quad_bumpy_ring")
    posor, count, away = Posor(calibration), 160, 100
    home, bump = float(posor.settings["home_theta"]), float(posor.settings["bump_angle"])
    thetas = home + np.append(np.linspace(8.0 * bump, 0.0, away), np.zeros(count - away))
    rotations = np.array([rotation_from_native(0.0, 0.0, theta) for theta in thetas])
    translations = np.tile([0.0, 0.0, STANDOFF], (count, 1))
    stamps = (np.arange(count, dtype=np.int64) + 1) * PERIOD_NS
    scans = TruePosor(calibration).scans_at(
        posor.stack, rotations, translations, stamps, noise=np.random.default_rng(4)
    )
    marks = (np.abs(thetas - home) < 0.3 * bump).astype(np.int64)
    scans = scans.with_fields({"at_home": marks})
    found = posor.estimate_all(scans)
    assert np.any(leans_by_pose(found)[:away] > 2.0 * LEAN)  # of uncounted poses
    assert not np.any(found.faults & Fault.TRAVEL)
    assert np.all(found.states[away + 10 :] == State.OK)
    volts = scans.gap_voltages.copy()
    volts[-5:] *= 1.2
    posor.reset()
    beyond = posor.estimate_all(scans.with_fields({"gap_voltages": volts}))
    assert beyond.faults[-5] & Fault.TRAVEL


def leans_by_pose(found: Estimates) -> FloatArray:
    """Return the inclination of each pose [rad], (n,); zero where there is none."""
    return np.nan_to_num(np.hypot(found.rotations[:, 0, 2], found.rotations[:, 1, 2]))


@pytest.mark.parametrize("gap", [STANDOFF - HALF_RANGE, STANDOFF + HALF_RANGE])
def test_poses_at_the_ends_of_the_travel_are_sound(gap: float) -> None:
    calibration = joint()
    thetas = np.linspace(0.0, 0.5, 200)
    rotations = np.array([rotation_from_native(0.7 * LEAN, -0.7 * LEAN, t) for t in thetas])
    translations = np.tile([0.0, 0.0, gap], (len(thetas), 1))
    stamps = (np.arange(len(thetas), dtype=np.int64) + 1) * PERIOD_NS
    stack, noise = Posor(calibration).stack, np.random.default_rng(2)
    scans = TruePosor(calibration).scans_at(stack, rotations, translations, stamps, noise=noise)
    assert np.all(Posor(calibration).estimate_all(scans).states == State.OK)


@pytest.mark.parametrize("gain", [1.03, 1.08, 1.12])
def test_a_stated_gain_of_the_amplifiers_within_the_travel_is_within_the_level(gain: float) -> None:
    calibration = joint(causes=(GAIN,))
    scans, rotations, translations = turning(calibration)
    posor = Posor(calibration)
    found = posor.estimate_all(with_gain(scans, gain), fault_effects=True)
    levels = joint_protection_levels(posor, found).levels
    usable = np.isin(found.states, USABLE)
    assert usable[RESTART:].any()
    assert np.all(np.isfinite(levels[usable]))
    assert np.all(np.abs(errors_of_usable(found, rotations, translations)) <= levels[usable])
    assert np.all(levels[usable][:, 3:5] < 4.5e-4)  # twice the travel, noise and what is always there
    without = joint(travel=False, causes=(GAIN,))
    posor = Posor(without)
    found = posor.estimate_all(scans.part(0, 50), fault_effects=True)
    assert np.all(np.isinf(joint_protection_levels(posor, found).levels[:, 3:5]).any(axis=1))


def test_the_travel_bounds_the_level_of_three_gap_probes() -> None:
    levels = []
    for travel in (False, True):
        calibration = joint("triad_light_ring", travel=travel)
        posor = Posor(calibration)
        found = posor.estimate_all(turning(calibration, 300)[0].part(0, RESTART), fault_effects=True)
        assert np.all(found.states == State.OK)
        levels.append(joint_protection_levels(posor, found).levels)
    assert np.all(np.isinf(levels[0]).any(axis=1))
    assert np.all(np.isfinite(levels[1]))


def test_a_contradiction_at_some_angles_is_not_released_at_others() -> None:
    calibration = joint(travel=False)
    scans, _, _ = turning(calibration)
    scans = with_gain(scans, 1.7)
    found = Posor(calibration).estimate_all(scans)
    first = int(np.flatnonzero(found.faults & Fault.LATCHED)[0])
    assert first > RESTART
    assert np.all(found.states[first:] == State.LOST)
    each = Posor(calibration).estimate_each(scans.part(first, COUNT))
    passed = np.count_nonzero(np.isin(each.states, USABLE))
    assert passed > 20 * RESIDUAL_RUN  # at other angles the readings agree, on wrong poses


def turned_to(thetas: FloatArray) -> Scans:
    """Return scans of a joint without travel at angles [rad]."""
    calibration = joint(travel=False)
    rotations = np.array([rotation_from_native(0.0, 0.0, t) for t in thetas])
    translations = np.tile([0.0, 0.0, STANDOFF], (len(thetas), 1))
    stamps = (np.arange(len(thetas), dtype=np.int64) + 1) * PERIOD_NS
    stack, noise = Posor(calibration).stack, np.random.default_rng(3)
    return TruePosor(calibration).scans_at(stack, rotations, translations, stamps, noise=noise).editable()


def test_a_contradiction_that_has_gone_is_released_where_it_was() -> None:
    scans = turned_to(np.full(100, 0.3))
    scans.gap_voltages[20:40, 0] += 0.1
    found = Posor(joint(travel=False)).estimate_all(scans)
    end = 40 + RESIDUAL_RUN
    assert np.all(found.states[20 : end - 1] == State.LOST)
    assert np.all(found.states[end:] == State.OK)


def test_a_contradiction_outlasts_a_start_with_stamps_that_scatter() -> None:
    index = np.arange(100)
    scans = turned_to(np.where(index < 20, 0.3, 0.5))
    scans.gap_voltages[:20, 0] += 0.1
    scans.stamps_ns[:] += PERIOD_NS * (7 - index % 8) + 1000 * (index % 8)  # the scans come in bursts
    found = Posor(joint(travel=False)).estimate_all(scans)
    assert np.all(found.states[20:] == State.LOST)


def test_a_single_contradiction_elsewhere_does_not_move_the_place_of_release() -> None:
    there = np.linspace(0.3, 0.34, 50)
    thetas = np.concatenate([np.full(40, 0.3), there, there[::-1], np.full(40, 0.3)])
    scans = turned_to(thetas)
    scans.gap_voltages[20:40, 0] += 0.1
    scans.gap_voltages[90, 0] += 0.2
    found = Posor(joint(travel=False)).estimate_all(scans)
    assert np.all(found.states[60:120] == State.LOST)
    assert np.all(found.states[-20:] == State.OK)
