"""The estimator on simulated scans: exact inversion, honest uncertainty, states and faults."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from posor_estimator.accuracy.closure import closure
from posor_estimator.accuracy.consistency import monte_carlo, nees
from posor_estimator.accuracy.health import FAULTS, detection, visibility
from posor_estimator.accuracy.poses import STACKS, TICK_NS
from posor_estimator.core.calibration.model import calibration_from
from posor_estimator.core.designs import design
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.forward import scans_at
from posor_estimator.core.native import rotation_from_native
from posor_estimator.core.posor import Posor
from posor_estimator.core.scan import NO_SOURCE, Scan
from posor_estimator.golden import largest_errors

if TYPE_CHECKING:
    from posor_estimator.core.designs import DesignName
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import FloatArray

DATA = Path(__file__).resolve().parent / "data"
SEED = 7


def sweep(posor: Posor, thetas: FloatArray, noise: np.random.Generator | None = None) -> tuple[Scans, FloatArray]:
    """Scans at 1 kHz of a target that turns, and the rotations."""
    rotations = np.array([rotation_from_native(1e-4, -2e-4, theta) for theta in thetas])
    translations = np.tile([2e-5, 1e-5, 0.7e-3], (len(thetas), 1))
    stamps = np.arange(1, len(thetas) + 1, dtype=np.int64) * TICK_NS
    return scans_at(posor.stack, rotations, translations, stamps, noise=noise), rotations


def test_ray_traced_cases() -> None:
    for stack, errors in largest_errors(DATA / "posor_cases.jsonl").items():
        assert errors["prediction_m"] < 1e-12, stack
        assert errors["translation_m"] < 1e-9, stack
        assert errors["rotation_rad"] < 1e-9, stack


@pytest.mark.parametrize("stack", STACKS)
def test_closure_over_the_full_range(stack: DesignName) -> None:
    exact, simple = closure(stack, 500, SEED)
    assert exact.translation_m < 1e-9
    assert exact.rotation_rad < 1e-9
    assert simple.translation_m > 1e-6  # the closed form is worth replacing
    assert simple.rotation_rad > 1e-5


@pytest.mark.parametrize("stack", STACKS)
def test_a_pose_is_the_same_wherever_the_solver_came_from(stack: DesignName) -> None:
    """Noise contradicts itself, and a bumpy ring is far from linear: there each step leaves a share of itself."""
    posor = Posor(design(stack))
    scans, _ = sweep(posor, np.linspace(0.05, 0.208, 80), np.random.default_rng(4))
    every, others = posor.locate_all(scans), [np.arange(0, 80, 2), np.arange(0, 80, 7)]
    for some in others:
        posor.reset()
        found = posor.locate_all(scans.chosen(some))
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
def test_normalised_errors_are_in_their_band(stack: DesignName) -> None:
    figures = nees(stack, 1000, SEED)
    assert figures.low < figures.mean < figures.high


@pytest.mark.parametrize("stack", STACKS)
def test_both_covariances_agree_with_monte_carlo(stack: DesignName) -> None:
    figures = monte_carlo(stack, 4000, SEED)
    assert figures.random_ratio == pytest.approx(1.0, abs=0.05)
    assert figures.systematic_ratio == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_flagged_in_their_first_scan(fault: str) -> None:
    figures = detection(fault, 100, SEED)
    assert figures.detected_fraction == 1.0
    assert figures.false_alarm_fraction < 5e-3


def test_smallest_visible_shift_is_what_the_estimator_flags() -> None:
    posor = Posor(design("triad_diodes", motion=True))
    scans, _ = sweep(posor, np.zeros(3))
    row = visibility("triad_diodes")[0]
    slope = -0.118e-3  # [m/V] of the design's probes in the middle of their range
    for times, state in ((0.8, State.OK), (1.25, State.LOST)):
        posor.reset()
        posor.locate(scans[0])
        volts = scans[1].gap_voltages.copy()
        volts[0] += times * row.smallest_m / slope
        assert posor.locate(replace(scans[1], gap_voltages=volts)).state is state


@pytest.mark.parametrize("stack", STACKS)
def test_one_by_one_and_all_at_once_are_the_same(stack: DesignName) -> None:
    posor = Posor(design(stack))
    scans, _ = sweep(posor, np.linspace(0.0, 0.08, 40), np.random.default_rng(SEED))
    scans.gap_voltages[17, 1] = math.nan
    scans.at_home[3] = 1
    together = posor.locate_all(scans)
    assert together.states[17] == State.LOST
    posor.reset()
    for n in range(len(scans)):
        alone = posor.locate(scans[n])
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
    scans, _ = sweep(Posor(calm), np.zeros(1))
    one, two = Posor(calm).locate(scans[0]), Posor(loud).locate(scans[0])
    assert two.covariance_random == pytest.approx(4.0 * one.covariance_random, rel=1e-9)
    assert two.covariance_systematic == pytest.approx(one.covariance_systematic, rel=1e-9)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_light_ring_is_handed_over_all_around(direction: float) -> None:
    posor = Posor(design("triad_light_ring"))
    thetas = direction * np.linspace(0.0, 4.2 * math.pi, 3000)
    scans, rotations = sweep(posor, thetas)
    found = posor.locate_all(scans)
    assert (found.states == State.OK).all()
    assert found.rotations == pytest.approx(rotations, abs=1e-10)
    assert found.thetas == pytest.approx(thetas, abs=1e-9)  # turns are counted
    assert len(np.unique(scans.lit_sources)) == 36


def test_comes_back_after_a_long_silence() -> None:
    posor = Posor(design("triad_light_ring"))
    scans, rotations = sweep(posor, np.array([0.0, 2.5]))
    assert posor.locate(scans[0]).state is State.OK
    estimate = posor.locate(scans[1])
    assert estimate.state is State.OK
    assert estimate.T_R_T is not None
    assert estimate.T_R_T.rotation == pytest.approx(rotations[1], abs=1e-10)


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
    scans, _ = sweep(posor, np.zeros(2))
    assert posor.locate(scans[0]).state is State.OK
    estimate = posor.locate(spoiled(scans[1], **spoil(scans[1])))
    assert estimate.state is State.LOST
    assert estimate.faults == fault
    assert sentence in estimate.reason
    assert estimate.reason.endswith(".")
    assert estimate.T_R_T is None
    assert np.isnan(estimate.native).all()
    assert np.isnan(estimate.covariance_random).all()


def test_a_jump_faster_than_the_target_moves_is_a_fault() -> None:
    posor = Posor(design("triad_diodes", motion=True))
    scans, _ = sweep(posor, np.array([0.0, 0.05, 1e-4]))
    assert posor.locate(scans[0]).state is State.OK
    estimate = posor.locate(scans[1])
    assert (estimate.state, estimate.faults) == (State.LOST, Fault.INNOVATION)
    assert posor.locate(scans[2]).state is State.OK
