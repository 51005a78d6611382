# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The estimator on simulated scans: exact inversion, honest uncertainty, states and faults."""

from __future__ import annotations

import copy
import math
from dataclasses import fields, replace

import numpy as np
import pytest
from posor.calibration.calibration_file import calibration_from
from posor.calibration.designs import DesignName, design
from posor.errors import ParameterError, ScanError, ShapeError
from posor.estimation.posor import Posor
from posor.model.fault import Fault, State
from posor.model.native_coordinates import rotation_from_native
from posor.model.scan import NO_SOURCE, Scan
from posor_lab.harness.random_poses import STACKS, turning_scans

SEED = 7


@pytest.mark.parametrize("stack", STACKS)
def test_a_pose_is_the_same_wherever_the_solver_came_from(stack: DesignName) -> None:
    """Noise contradicts itself, and a bumpy ring is far from linear: there each step leaves a share of itself."""
    posor = Posor(design(stack))
    scans = turning_scans(posor, np.linspace(0.05, 0.208, 80), 4)
    every, others = posor.estimate_all(scans), [np.arange(0, 80, 2), np.arange(0, 80, 7)]
    for some in others:
        posor.reset()
        found = posor.estimate_all(scans.select(some))
        np.testing.assert_allclose(found.translations, every.translations[some], rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(found.rotations, every.rotations[some], rtol=0.0, atol=2e-12)
        for name in ("covariances_random", "covariances_systematic"):
            one, other = getattr(found, name), getattr(every, name)[some]
            sigmas = np.sqrt(np.diagonal(other, axis1=1, axis2=2))
            np.testing.assert_allclose(
                one / sigmas[:, :, None] / sigmas[:, None, :],
                other / sigmas[:, :, None] / sigmas[:, None, :],
                rtol=0.0,
                atol=1e-8,
            )


@pytest.mark.parametrize("stack", STACKS)
def test_one_by_one_and_all_at_once_are_the_same(stack: DesignName) -> None:
    posor = Posor(design(stack))
    scans = turning_scans(posor, np.linspace(0.0, 0.08, 40), SEED, home=[3])
    scans.gap_voltages[17, 1] = math.nan
    together = posor.estimate_all(scans)
    assert together.states[17] == State.LOST
    posor.reset()
    for n in range(len(scans)):
        alone = posor.estimate(scans[n])
        assert alone.state == together.states[n]
        assert alone.faults == together.faults[n]
        if alone.T_R_T is not None:
            assert alone.T_R_T.translation == pytest.approx(together.translations[n], abs=1e-12)
            assert alone.T_R_T.rotation == pytest.approx(together.rotations[n], abs=1e-12)
            assert alone.covariance_random == pytest.approx(together.covariances_random[n], rel=1e-12)
            assert alone.covariance_systematic == pytest.approx(together.covariances_systematic[n], rel=1e-12)
            assert alone.residual == pytest.approx(together.residuals[n], rel=1e-9)


def test_noise_and_calibration_are_kept_apart() -> None:
    calm = design("triad_diodes")
    content = calm.model_dump(mode="json")
    for probe in content["sensors"][0]["probes"]:
        probe["noise"]["value"] *= 2.0
    for diode in content["sensors"][1]["diodes"]:
        diode["noise"]["value"] = [2.0 * value for value in diode["noise"]["value"]]
    loud = calibration_from(content)
    scans = turning_scans(Posor(calm), np.zeros(1))
    one, two = Posor(calm).estimate(scans[0]), Posor(loud).estimate(scans[0])
    assert two.covariance_random == pytest.approx(4.0 * one.covariance_random, rel=1e-9)
    assert two.covariance_systematic == pytest.approx(one.covariance_systematic, rel=1e-9)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_light_ring_is_handed_over_all_around(direction: float) -> None:
    posor = Posor(design("triad_light_ring"))
    thetas = direction * np.linspace(0.0, 4.2 * math.pi, 3000)
    scans = turning_scans(posor, thetas)
    rotations = np.array([rotation_from_native(1e-4, -2e-4, theta) for theta in thetas])
    found = posor.estimate_all(scans)
    assert (found.states == State.OK).all()
    assert found.rotations == pytest.approx(rotations, abs=1e-10)
    assert found.thetas == pytest.approx(thetas, abs=1e-9)  # turns are counted
    assert len(np.unique(scans.lit_sources)) == 36


def test_comes_back_after_a_long_silence() -> None:
    posor = Posor(design("triad_light_ring"))
    scans = turning_scans(posor, np.array([0.0, 2.5]))
    assert posor.estimate(scans[0]).state is State.OK
    estimate = posor.estimate(scans[1])
    assert estimate.state is State.OK
    assert estimate.T_R_T is not None
    assert estimate.T_R_T.rotation == pytest.approx(rotation_from_native(1e-4, -2e-4, 2.5), abs=1e-10)


def spoiled(scan: Scan, **fields_: object) -> Scan:
    unknown = set(fields_) - {f.name for f in fields(Scan)}
    assert not unknown
    return replace(scan, **fields_)  # type: ignore[arg-type]


BAD_SCANS = {
    "nan": (lambda s: {"gap_voltages": s.gap_voltages * math.nan}, Fault.BAD_READING, "voltage nan"),
    "count": (lambda s: {"gap_voltages": s.gap_voltages[:2]}, Fault.BAD_READING, "2 gap probe voltages"),
    "range": (lambda s: {"gap_voltages": s.gap_voltages + 9.0}, Fault.OUT_OF_RANGE, "outside the calibrated range"),
    "dark": (lambda s: {"diode_currents": s.diode_currents * 1e-3}, Fault.DARK_DIODE, "too dark"),
    "bright": (lambda s: {"diode_currents": s.diode_currents * 2.0}, Fault.SOURCE, "too bright for one light source"),
    "unlit": (lambda _: {"lit_sources": (0, NO_SOURCE)}, Fault.SOURCE, "no light source was lit"),
    "unknown": (lambda _: {"lit_sources": (0, 7)}, Fault.SOURCE, "light source 7 is unknown"),
    "sources": (lambda _: {"lit_sources": (0,)}, Fault.SOURCE, "1 lit sources"),
    "contacts": (lambda s: {"diode_currents": s.diode_currents[:1]}, Fault.BAD_READING, "4 contact currents"),
}


@pytest.mark.parametrize("name", BAD_SCANS)
def test_bad_scans_are_lost_and_say_why(name: str) -> None:
    spoil, fault, sentence = BAD_SCANS[name]
    posor = Posor(design("triad_diodes"))
    scans = turning_scans(posor, np.zeros(2))
    assert posor.estimate(scans[0]).state is State.OK
    estimate = posor.estimate(spoiled(scans[1], **spoil(scans[1])))
    assert estimate.state is State.LOST
    assert estimate.faults == fault
    assert sentence in estimate.reason
    assert estimate.reason.endswith(".")
    assert estimate.T_R_T is None
    assert np.isnan(estimate.native).all()
    assert np.isnan(estimate.covariance_random).all()


def test_a_jump_faster_than_the_target_moves_is_a_fault() -> None:
    posor = Posor(design("triad_diodes", motion=True))
    scans = turning_scans(posor, np.array([0.0, 0.05, 1e-4]))
    assert posor.estimate(scans[0]).state is State.OK
    estimate = posor.estimate(scans[1])
    assert (estimate.state, estimate.faults) == (State.LOST, Fault.INNOVATION)
    assert posor.estimate(scans[2]).state is State.OK


@pytest.mark.parametrize("value", [float("nan"), -1e-3, 1.0, 5.0])
def test_a_false_alarm_that_is_no_probability_is_refused(value: float) -> None:
    with pytest.raises(ParameterError, match="expected a probability from 0 to below 1"):
        Posor(design("triad_diodes"), false_alarm=value)


@pytest.mark.parametrize("stack", STACKS)
def test_a_copy_goes_on_by_itself(stack: DesignName) -> None:
    posor = Posor(design(stack))
    scans = turning_scans(posor, np.linspace(0.0, 0.02, 4))
    posor.estimate(scans[0])
    other = copy.deepcopy(posor)
    expected = [posor.estimate(scans[n]).native for n in range(1, 4)]
    np.testing.assert_array_equal([other.estimate(scans[n]).native for n in range(1, 4)], expected)


def test_thetas_of_another_length_are_refused_and_leave_nothing_behind() -> None:
    posor = Posor(design("triad_bumpy_ring"))
    scans = turning_scans(posor, np.linspace(0.0, 0.02, 4))
    expected = posor.estimate_all(scans).states
    posor.reset()
    with pytest.raises(ShapeError, match=r"thetas has shape \(1,\); expected \(4,\)"):
        posor.estimate_each(scans, np.array([7.0]))
    np.testing.assert_array_equal(posor.estimate_all(scans).states, expected)


def test_a_scan_that_does_not_exist_is_refused() -> None:
    scans = turning_scans(Posor(design("triad_diodes")), np.zeros(3))
    assert scans[-1].stamp_ns == scans[2].stamp_ns
    for index in (3, -4):
        with pytest.raises(IndexError, match=f"scan {index} of 3; expected -3 to 2"):
            scans[index]


def test_prediction_needs_the_lit_sources() -> None:
    posor = Posor(design("triad_diodes"))
    scan = turning_scans(posor, np.zeros(1))[0]
    pose = posor.estimate(scan).T_R_T
    assert pose is not None
    dark = replace(scan, lit_sources=(NO_SOURCE,) * len(scan.lit_sources))
    without_voltage = replace(scan, gap_voltages=np.full_like(scan.gap_voltages, np.nan))
    np.testing.assert_array_equal(posor.predict(without_voltage, pose), posor.predict(scan, pose))
    with pytest.raises(ScanError, match="source"):
        posor.predict(dark, pose)


@pytest.mark.parametrize("stack", STACKS)
def test_an_impossible_temperature_never_raises(stack: DesignName) -> None:
    posor = Posor(design(stack))
    scan = replace(turning_scans(posor, np.zeros(1))[0], temperature=1e300)
    assert posor.estimate(scan).state == State.LOST


def test_a_prediction_does_not_depend_on_former_predictions() -> None:
    calibration = design("triad_bumpy_ring")
    posor, fresh = Posor(calibration), Posor(calibration)
    turning_scans(posor, np.linspace(0.0, 0.3, 7))
    after, alone = (turning_scans(each, np.array([0.1])).ring_voltages for each in (posor, fresh))
    np.testing.assert_array_equal(after, alone)
