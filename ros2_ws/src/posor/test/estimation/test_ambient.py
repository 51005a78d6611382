# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Ambient light that dark scans show, and the gain of a converter that reads a known voltage."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from posor.calibration.calibration_file import Calibration, calibration_from
from posor.calibration.designs import STANDOFF, sized_design
from posor.estimation.corrected_scans import corrected_scans
from posor.estimation.digital_zero import find_digital_zero
from posor.estimation.estimate import Estimates
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.fault import Fault, State
from posor.model.native_coordinates import rotation_from_native
from posor.model.scan import DARK_SUBTRACTED, NO_SOURCE, Scans
from posor.numerics.array_types import FloatArray

COUNT, PERIOD_NS = 600, 10_000_000  # 100 Hz
DARK = np.arange(0, COUNT, 200)
LEAN, AMBIENT_A, NOISE_A = (1e-4, -2e-4), 8e-7, 1e-9  # the ambient light is 1 % of that of a source


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return sized_design("checked_light_ring", 0.1524, frames=("receiving", "target"), title="joint")


@pytest.fixture
def posor(calibration: Calibration) -> Posor:
    return Posor(calibration)


def moving(posor: Posor) -> tuple[Scans, FloatArray]:
    """Return scans without ambient light, noisy, and the true natives (n, 6)."""
    time_s = np.arange(COUNT) * PERIOD_NS * 1e-9
    natives = np.zeros((COUNT, 6))
    natives[:, 0], natives[:, 1] = 4e-5 * np.sin(time_s), 3e-5 * np.cos(1.3 * time_s)
    natives[:, 2], natives[:, 3:5] = STANDOFF + 1e-5 * np.sin(time_s), LEAN
    natives[:, 5] = 0.4 * np.sin(0.9 * time_s)
    rotations = np.array([rotation_from_native(*native) for native in natives[:, 3:]])
    stamps = (np.arange(COUNT) + 1) * PERIOD_NS
    scans = scans_at(posor.stack, rotations, natives[:, :3], stamps, noise=np.random.default_rng(1))
    return scans, natives


def lit_by(scans: Scans, ambient_a: Any = AMBIENT_A, dark: Any = DARK) -> Scans:
    """Return the scans with ambient light, some of them dark; it may be a current for each scan."""
    out, random = scans.editable(), np.random.default_rng(2)
    out.statuses[:] &= ~DARK_SUBTRACTED
    out.lit_sources[dark] = NO_SOURCE
    out.diode_currents[dark] = NOISE_A * random.normal(size=out.diode_currents[dark].shape)
    out.diode_currents[:] += np.broadcast_to(ambient_a, len(scans))[:, None, None]
    return out


def sigmas_off(estimates: Estimates, natives: FloatArray, which: Any) -> float:
    errors = np.abs(estimates.natives[which] - natives[which])
    variances = np.diagonal(estimates.covariances()[which], axis1=1, axis2=2)
    return float(np.max(errors / np.sqrt(variances)))


def test_ambient_light_that_a_dark_scan_has_shown_is_removed(posor: Posor) -> None:
    scans, natives = moving(posor)
    found = posor.estimate_all(lit_by(scans))
    lit = np.setdiff1d(np.arange(COUNT), DARK)
    assert np.all(found.states[lit] == State.OK)
    assert sigmas_off(found, natives, lit) < 5.0
    design = sized_design("quad_light_ring", 0.1524, frames=("receiving", "target"), title="joint")
    unaware = Posor(design.model_copy(update={"motion": None}))  # no latch
    two = lit_by(moving(unaware)[0], dark=[])  # the same light on two diodes, which contradict it at some angles only
    usable = np.isin((wrong := unaware.estimate_all(two)).states, [State.OK, State.DEGRADED])
    assert usable.any()
    assert sigmas_off(wrong, natives, usable) > 20.0


def test_a_dark_scan_has_a_pose_by_the_gap_probes_and_the_motion(posor: Posor) -> None:
    scans, natives = moving(posor)
    scans = lit_by(scans)
    found = posor.estimate_all(scans)
    assert (found.states[0], found.faults[0]) == (State.LOST, Fault.AMBIENT)
    assert found.reason(0) == (
        "scan 0: no light source is lit (a dark scan) while no pose is known; expected lit scans around it."
    )
    assert np.all(found.states[DARK[1:]] == State.DEGRADED)
    assert np.all(found.faults[DARK[1:]] == Fault.AMBIENT | Fault.ILL_CONDITIONED)
    assert "a dark scan" in found.reason(200)
    assert sigmas_off(found, natives, DARK[1:]) < 5.0
    sigmas = np.sqrt(np.diagonal(found.covariances_random[200]))
    assert sigmas[2] < 5e-7  # by the lean, x and y change the gaps
    assert sigmas[5] == pytest.approx(3.0 * PERIOD_NS * 1e-9, rel=0.05)  # the largest rate of theta for a scan


def test_a_dark_scan_must_have_come_and_not_be_too_old(posor: Posor) -> None:
    scans, _ = moving(posor)
    assert np.all(posor.estimate_all(scans).states == State.OK)  # flagged: without ambient light
    content = posor.calibration.model_dump(mode="json")
    content["sensors"][1]["ambient"]["max_age"]["value"] = 3.0
    posor, scans = Posor(calibration_from(content)), lit_by(scans, 0.0, dark=[0])
    before = posor.estimate(scans[1])
    assert (before.state, before.faults) == (State.LOST, Fault.AMBIENT)
    expected = "the ambient light is unknown; expected a dark scan before, or STATUS_DARK_SUBTRACTED."
    assert before.reason == f"scan 1: {expected}"
    posor = Posor(posor.calibration)
    found = posor.estimate_all(scans)
    assert np.all(found.states[1:301] == State.OK)
    assert np.all(found.states[301:] == State.DEGRADED)
    assert np.all(found.faults[301:] == Fault.AMBIENT)
    variances = found.covariances_systematic[:, 0, 0]
    assert variances[599] > variances[2]  # the light drifts
    assert found.reason(400) == (
        "scan 400: the ambient light may have changed since the last dark scan; expected one at least every 3 s, or "
        "STATUS_DARK_SUBTRACTED."
    )


def test_a_known_voltage_that_is_no_longer_read_degrades(posor: Posor) -> None:
    scans, _ = moving(posor)
    assert posor.estimate(scans[0]).state is State.OK
    missing = posor.estimate(replace(scans[1], reference_voltage=math.nan))
    assert (missing.state, missing.faults) == (State.DEGRADED, Fault.ENVIRONMENT)
    assert "reference voltage is no longer measured" in missing.reason
    assert posor.estimate(scans[2]).state is State.OK


def test_a_change_of_the_light_is_seen_and_taken_over_at_once(posor: Posor) -> None:
    scans, natives = moving(posor)
    found = posor.estimate_all(lit_by(scans, np.where(np.arange(COUNT) < 150, 1e-7, AMBIENT_A)))
    assert np.all(found.states[1:150] == State.OK)
    assert np.all(found.states[150:200] == State.LOST)
    assert np.all(found.states[220:400] == State.OK)  # after the latch of RESIDUAL is released
    assert sigmas_off(found, natives, slice(220, 400)) < 5.0
    posor.reset()
    assert posor.estimate(lit_by(scans)[590]).state is State.OK  # the ambient light outlives the pose


def test_light_in_a_dark_scan_is_a_fault_of_the_source(posor: Posor) -> None:
    scans = lit_by(moving(posor)[0])
    posor.estimate_all(scans.part(0, 50))
    lost = posor.estimate(replace(scans[50], lit_sources=(NO_SOURCE,) * 3))
    assert (lost.state, lost.faults) == (State.LOST, Fault.SOURCE)
    assert "light in a dark scan" in lost.reason
    assert posor.dark_currents == pytest.approx(np.full((3, 4), AMBIENT_A), abs=5.0 * NOISE_A)


def with_light_left(scans: Scans, dark: Any, share: float, which: Any) -> Scans:
    """Return the scans with dark ones, of which ``which`` hold a share of the light of the scan before."""
    out = lit_by(scans, dark=dark).editable()
    out.diode_currents[which] += share * scans.diode_currents[np.asarray(which) - 1]
    return out


@pytest.mark.parametrize("share", [-0.01, 0.01, 0.1])
def test_light_that_is_left_in_dark_scans_is_seen_until_two_hold_none(posor: Posor, share: float) -> None:
    scans, natives = moving(posor)
    dark, left = np.arange(0, COUNT, 100), [100, 200]
    found = posor.estimate_all(with_light_left(scans, dark, share, left))
    lit = np.setdiff1d(np.arange(COUNT), dark)
    assert np.all(found.states[lit[lit < 100]] == State.OK)
    during = lit[(lit > 100) & (lit < 300)]
    assert np.all(found.states[during] == State.LOST)
    assert np.all(found.faults[during] == Fault.AMBIENT)
    assert found.reason(150) == (
        "scan 150: light of the sources is left in the dark scans, whose currents change as the spots move; expected "
        "more time without light before, then two dark scans at different spots, or ~/acknowledge and one."
    )
    after = lit[lit > 500]
    assert np.all(found.states[after] == State.OK)
    assert sigmas_off(found, natives, after) < 5.0


def test_a_joint_at_rest_after_light_in_a_dark_scan_is_acknowledged(posor: Posor) -> None:
    scans, natives = moving(posor)
    dark, left = np.arange(0, COUNT, 100), [100]
    lit = with_light_left(scans, dark, 0.05, left)
    posor.estimate_all(lit.part(0, 150))
    assert posor.estimate(lit[150]).faults == Fault.AMBIENT
    assert posor.latched == Fault.NONE
    assert posor.acknowledge()
    assert not posor.acknowledge()
    found = posor.estimate_all(lit.part(151, 300))
    assert np.all(found.states[:49] == State.LOST)  # until the next dark scan
    after = np.arange(151, 300) > 200
    assert np.all(found.states[after] == State.OK)
    assert sigmas_off(found, natives[151:300], after) < 5.0


def test_an_invalid_current_before_a_dark_scan_leaves_the_covariances_finite(posor: Posor) -> None:
    scans, _ = moving(posor)
    lit = lit_by(scans).editable()
    lit.diode_currents[DARK[1] - 1, 0, 0] = math.nan
    found = posor.estimate_all(lit)
    assert found.states[DARK[1] - 1] == State.LOST
    after = np.setdiff1d(np.arange(DARK[1], COUNT), DARK)
    assert np.all(found.states[after] == State.OK)
    assert np.all(np.isfinite(found.covariances()[after]))


@pytest.mark.parametrize(("dark", "state"), [((0, 200), State.OK), ((0, 100, 200), State.LOST)])
def test_other_ambient_light_releases_only_what_it_may_have_caused(
    posor: Posor, dark: tuple[int, ...], state: State
) -> None:
    """A gap probe contradicts the others; the next dark scan shows the same light, or that of a lamp."""
    scans, _ = moving(posor)
    ambient_a = np.where(np.arange(COUNT) < 199, AMBIENT_A, 3.0 * AMBIENT_A)
    lit = lit_by(scans, ambient_a, np.array(dark)).editable()
    lit.gap_voltages[50:70, 0] += 0.1
    found = posor.estimate_all(lit)
    assert np.all(found.states[50:199] == State.LOST)
    assert np.all(found.states[220:270] == state)  # at other angles than then


def test_a_lamp_is_not_light_of_the_sources(posor: Posor) -> None:
    scans, natives = moving(posor)
    lamp = np.random.default_rng(4).uniform(0.5, 1.5, (3, 1)) * np.array([1.02, 1.0, 0.98, 1.0]) * AMBIENT_A
    lit = lit_by(scans, 0.0).editable()
    lit.diode_currents[199:] += lamp  # unlike on the diodes, and a little on their contacts
    found = posor.estimate_all(lit)
    assert np.all(found.states[201:400] == State.OK)
    assert sigmas_off(found, natives, slice(201, 400)) < 5.0


def test_a_stated_share_of_light_that_is_left_is_in_the_covariance(posor: Posor) -> None:
    content, share = posor.calibration.model_dump(mode="json"), 0.01
    scans, natives = moving(posor)
    left = with_light_left(scans, DARK, share, DARK[1:])
    content["sensors"][1]["ambient"]["source_light"] = {"value": share, "unit": "1"}
    stated, lit = Posor(calibration_from(content)), np.setdiff1d(np.arange(COUNT), DARK)
    found = stated.estimate_all(left)
    assert np.all(found.states[lit] == State.OK)
    assert sigmas_off(found, natives, lit) < 5.0
    theta_off = np.abs(found.natives[lit, 5] - natives[lit, 5])
    assert theta_off.max() > 1e-4  # the light is left
    deviations = np.sqrt(found.covariances_systematic[lit, 5, 5])
    before = DARK[np.searchsorted(DARK, lit) - 1] - 1
    moved, same = np.abs(natives[lit, 5] - natives[before, 5]), lit > DARK[1]
    same &= np.all(left.lit_sources[lit] == left.lit_sources[before], axis=1)
    np.testing.assert_allclose(deviations[same], share * moved[same], rtol=0.1, atol=1e-5)


def test_light_below_the_noise_of_dark_scans_is_in_the_covariance_of_all_that_are_averaged(posor: Posor) -> None:
    content, share = posor.calibration.model_dump(mode="json"), 5e-5
    scans, _ = moving(posor)
    dark = np.arange(0, COUNT, 50)
    without, left = lit_by(scans, dark=dark), with_light_left(scans, dark, share, dark[1:])
    content["sensors"][1]["ambient"]["source_light"] = {"value": share, "unit": "1"}
    stated = Posor(calibration_from(content)).estimate_all(left)
    lit = np.setdiff1d(np.arange(200, COUNT), dark)
    assert np.all(stated.states[lit] == State.OK)
    errors = np.abs(stated.natives[lit, 5] - Posor(posor.calibration).estimate_all(without).natives[lit, 5])
    variances = stated.covariances_systematic[lit, 5, 5]
    deviations = np.sqrt(variances - Posor(posor.calibration).estimate_all(left).covariances_systematic[lit, 5, 5])
    clear = errors > 0.3 * errors.max()
    assert clear.mean() > 0.1
    np.testing.assert_allclose(deviations[clear], errors[clear], rtol=0.15)


def test_the_systematic_covariance_holds_the_uncertainty_of_the_dark_currents(posor: Posor) -> None:
    still, places = np.tile(rotation_from_native(*LEAN, 0.1), (2, 1, 1)), np.array([[0.0, 0.0, STANDOFF]] * 2)
    both = scans_at(posor.stack, still, places, np.array([1, 2]) * PERIOD_NS)
    dark, lit = both[0], both[1]
    without = posor.estimate(lit)
    content, noise_a = posor.calibration.model_dump(mode="json"), 3e-8
    content["sensors"][1]["ambient"]["noise"]["value"] = noise_a
    noisy, poses, random = Posor(calibration_from(content), false_alarm=1e-9), [], np.random.default_rng(3)
    for _ in range(400):
        noisy.reset()
        noisy.tracker["ambient"]["known"] = 0
        currents = noise_a * random.normal(size=(3, 4))
        changed: dict[str, Any] = {"gap_voltages": dark.gap_voltages + 1e-4, "status": 0}  # not frozen
        noisy.estimate(replace(dark, diode_currents=currents, lit_sources=(NO_SOURCE,) * 3, **changed))
        poses.append(noisy.estimate(replace(lit, status=0)))
    assert all(each.state is State.OK for each in poses)
    added = np.diagonal(poses[0].covariance_systematic - without.covariance_systematic)[[0, 1, 5]]
    drawn = np.var([each.native for each in poses], axis=0)[[0, 1, 5]]
    np.testing.assert_allclose(drawn / added, 1.0, atol=0.3)  # 4 standard deviations of a variance of 400 draws


@pytest.mark.parametrize("name", ["checked_light_ring", "checked_bumpy_ring"])
@pytest.mark.parametrize("error", [-0.015, 0.001])
def test_the_gain_of_the_converter_is_corrected(name: Any, error: float) -> None:
    posor = Posor(sized_design(name, 0.1524, frames=("receiving", "target"), title="joint"))
    natives = np.array([[2e-5, -1e-5, STANDOFF + 3e-4, *LEAN, 0.02]])
    scan = scans_at(posor.stack, rotation_from_native(*LEAN, 0.02)[None], natives[:, :3], np.array([PERIOD_NS]))[0]

    def estimate(**fields: Any) -> Any:
        posor.reset()
        posor.confirm_theta(0.02, 1e-3)
        return posor.estimate(replace(scan, at_home=2, **fields))

    volts = {"gap_voltages": scan.gap_voltages * (1.0 + error), "ring_voltages": scan.ring_voltages * (1.0 + error)}
    true, corrected = estimate(), estimate(**volts, reference_voltage=5.0 * (1.0 + error))
    np.testing.assert_allclose(corrected.native, true.native, atol=1e-12)
    unmeasured, shifted = estimate(reference_voltage=math.nan), estimate(reference_voltage=5.0 * (1.0 - 1e-4))
    effect = (shifted.T_R_T.translation - true.T_R_T.translation)[2] / 1e-4 * 1e-3  # at the spread of .1 %
    grown = unmeasured.covariance_systematic[2, 2] - true.covariance_systematic[2, 2]
    assert math.sqrt(grown) == pytest.approx(abs(effect), rel=0.01)
    for volt in (4.89, 5.11, 0.0, math.inf):
        assert estimate(reference_voltage=volt).faults == Fault.ENVIRONMENT
    sentence = "scan 0: reference voltage 4.89 V is outside the calibration's range; expected 4.9 to 5.1 V."
    assert estimate(reference_voltage=4.89).reason == sentence


def test_raw_readings_are_corrected_for_procedures(calibration: Calibration) -> None:
    posor = Posor(calibration)
    count, home = 40, (STANDOFF, 0.0, 0.0)
    still = np.tile(rotation_from_native(0.0, 0.0, 0.1), (count, 1, 1))
    places = np.tile([1e-5, 0.0, STANDOFF], (count, 1))
    sound = scans_at(posor.stack, still, places, (1 + np.arange(count)) * PERIOD_NS, noise=np.random.default_rng(5))
    scans = lit_by(sound, dark=[0, 20]).editable()
    for name in ("gap_voltages", "reference_voltages"):
        getattr(scans, name)[:] *= 1.01
    corrected, lit = corrected_scans(scans, calibration), ~scans.dark
    assert np.count_nonzero(~lit) == 2
    np.testing.assert_allclose(corrected.diode_currents, sound.diode_currents[lit], atol=6.0 * NOISE_A)
    relative = corrected.gap_voltages / sound.gap_voltages[lit]
    assert np.abs(relative - 1.0).max() < 1e-4  # the noise of the reference voltage is 1e-5
    assert np.all(corrected.statuses & DARK_SUBTRACTED)
    for part, dark_currents in ((scans, None), (scans.part(21, 40), np.full((3, 4), AMBIENT_A))):
        changes = find_digital_zero(calibration, part, home, dark_currents).changes
        assert np.abs(changes).max() < 1e-3  # the noise of a voltage


WRONG: tuple[tuple[int, str, str, float, str], ...] = (
    (1, "ambient", "noise", 0.0, "noise 0 A"),
    (1, "ambient", "max_age", -1.0, "max_age -1 s"),
    (1, "ambient", "remaining", 1.0, "remaining 1 1"),
    (1, "ambient", "source_light", 0.0, "source_light 0 1"),
    (0, "reference", "voltage", 0.0, "voltage 0 V"),
    (0, "reference", "limit", 1.0, "limit 1 1"),
    (0, "reference", "spread", -0.1, "spread -0.1 1"),
)


@pytest.mark.parametrize(("sensor", "part", "key", "value", "what"), WRONG)
def test_invalid_numbers_are_refused(
    calibration: Calibration, sensor: int, part: str, key: str, value: float, what: str
) -> None:
    content = calibration.model_dump(mode="json")
    content["sensors"][1]["ambient"]["source_light"] = {"value": 1e-4, "unit": "1"}
    calibration_from(content)
    content["sensors"][sensor][part][key]["value"] = value
    with pytest.raises(ValueError, match=what):
        calibration_from(content)


def test_dark_scans_need_motion_limits_and_leave_the_hash_of_other_files(calibration: Calibration) -> None:
    with pytest.raises(ValueError, match="ambient without motion"):
        calibration_from(calibration.model_dump(mode="json") | {"motion": None})
    former = sized_design("quad_light_ring", 0.1524, frames=("receiving", "target"), title="joint")
    assert former.motion is not None
    motion = former.motion.model_copy(update={"acceleration": None})
    former = former.model_copy(update={"motion": motion})
    assert former.content_hash == "85a51eadbc1c7fd977335201da4b720b913c81e99a374aa8cbe8b459bb5fceaa"
