# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Beams that follow the vibration of their links, by the readings of accelerometers."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.beam_vibration import FROZEN_S, BeamVibrations
from posor.chain.joint_measurements import MeasuredJoint
from posor.chain.kinematic_chain import Chain
from posor.errors import ChainError
from posor.estimation.fault_model import JointCauses
from posor.numerics.array_types import FloatArray
from posor.numerics.stamps import NS
from posor_lab.harness.beams import beams_file, plate, quantity, tube, uncertainty
from scipy.integrate import solve_ivp

ARM = Path(__file__).with_name("two_beams.urdf").read_text(encoding="utf-8")
LENGTH, GIMBALS = math.hypot(0.8, 0.1), (0.15, 0.7)
FREQUENCY, DAMPING, SPREAD, RATE, AGE_S = 100.0, 0.05, 2.0, 4000, 0.002
GRAVITY = np.array([0.0, 0.0, -9.80665])
STILL = {name: MeasuredJoint(pin.SE3.Identity()) for name in ("shoulder", "elbow")}
NAMES = ("near", "far")


def vibrating_beam(*, sag: bool = True, version: int = 4, **changes: Any) -> Any:
    accelerometers = {
        "names": list(NAMES),
        "uncertainty": quantity(0.01, "m/s^2"),
        "delay": quantity(1e-5, "s"),
        "range": quantity(200.0, "m/s^2"),
        "age": quantity(AGE_S, "s"),
    } | changes.pop("accelerometers", {})
    vibration = {
        "frequency": {**quantity(FREQUENCY, "Hz"), "sigma": 1.0},
        "damping": quantity(DAMPING, "1"),
        "uncertainty": quantity(0.1, "1"),
        "spread": quantity(SPREAD, "m/s^2"),
        "accelerometers": accelerometers,
    } | changes
    entry: dict[str, Any] = {
        "joint": "upper_arm",
        "uncertainty": uncertainty([0.0] * 3, [0.0] * 3),
        "vibration": vibration,
    }
    if sag:
        entry["sag"] = {
            "tube": tube(0.05, 0.045),
            "gimbals": quantity(list(GIMBALS), "m"),
            "plates": [plate("target", 0.0, 1.5), plate("receiving", LENGTH, 0.8)],
            "uncertainty": quantity(0.0, "1"),
        }
    return beams_file(entry, version=version)


class Rig:
    """A chain with a vibrating beam, fed with readings at RATE and asked at the last of them."""

    def __init__(self, **changes: Any) -> None:
        self.chain = Chain(ARM, "tip", vibrating_beam(**changes))
        self.estimator = self.chain.estimator()
        self.vibrations = BeamVibrations(self.chain.beams, self.estimator)
        self.estimator.set_measurements(STILL)
        assert self.estimator.estimate(1)  # computes gravity in the axes of the beam
        self.gravity = self.estimator.static_forces[0].copy()

    def feed(self, accelerations: FloatArray, first_s: float = 1.0) -> int:
        """Add readings under accelerations (n, 2, 3) of both gimbals, ask at the last one; return its stamp."""
        for n, pair in enumerate(accelerations):
            stamp_ns = round((first_s + n / RATE) * NS)
            for name, acceleration in zip(NAMES, pair, strict=True):
                x, y, z = (acceleration - self.gravity).tolist()
                self.vibrations.add(name, stamp_ns, (x, y, z))
        self.vibrations.update(stamp_ns)
        return stamp_ns


def sines(frequency: float, near: float, far: float, seconds: float) -> FloatArray:
    """Return accelerations of both gimbals along Y, which is across the beam, (n, 2, 3), with a trace of noise."""
    out = 1e-6 * np.random.default_rng(7).normal(size=(round(seconds * RATE), 2, 3))
    out[:, :, 1] += np.sin(2.0 * math.pi * frequency * np.arange(len(out)) / RATE)[:, None] * (near, far)
    return out


@pytest.mark.parametrize("frequency", [15.0, 45.0, 80.0])
def test_the_beam_follows_as_an_oscillator(frequency: float) -> None:
    """Compared with the differential equation, and the sag with both gains of the beam."""
    rig, (near, far) = Rig(), (3.0, 8.0)
    driven = sines(frequency, near, far, 0.4)
    stamp_ns, angular, w = rig.feed(driven), 2.0 * math.pi * FREQUENCY, 2.0 * math.pi * frequency
    end = (len(driven) - 1) / RATE
    found = solve_ivp(
        lambda t, y: [y[1], angular**2 * (-math.sin(w * t) - y[0]) - 2.0 * DAMPING * angular * y[1]],
        (0.0, end),
        [0.0, 0.0],
        rtol=1e-9,
        atol=1e-9,
    )
    u = found.y[0, -1]
    share, stretch = (0.5 * LENGTH - GIMBALS[0]) / (GIMBALS[1] - GIMBALS[0]), LENGTH / (GIMBALS[1] - GIMBALS[0])
    mean = rig.gravity + np.array([0.0, ((1.0 - share) * near + share * far) * u, 0.0])
    difference = np.array([0.0, stretch * (far - near) * u, 0.0])
    written = rig.estimator.vibrations[0, 0]
    np.testing.assert_allclose(written["mean"], mean, rtol=0.0, atol=0.02 * 8.0)
    np.testing.assert_allclose(written["difference"], difference, rtol=0.0, atol=0.03 * 8.0)
    assert rig.estimator.estimate(stamp_ns)
    beam = rig.chain.beams[0]
    start, stop = (
        gain @ written["mean"] + tilt @ written["difference"]
        for gain, tilt in ((beam.start_gain, beam.start_tilt_gain), (beam.end_gain, beam.end_tilt_gain))
    )
    moved = [pin.SE3(pin.exp3(m[3:]), m[:3]) for m in (start, stop)]
    rotation, translation = moved[1].rotation @ beam.T_start_end.rotation, beam.T_start_end.translation
    expected = moved[0].inverse() * pin.SE3(rotation, translation + moved[1].translation)
    np.testing.assert_allclose(rig.estimator.beam_transforms[0], pin.SE3ToXYZQUAT(expected), rtol=0.0, atol=1e-9)


def test_the_uncertainty_grows_with_the_vibration_and_enters_the_covariance() -> None:
    sigmas, variances = [], []
    for amplitude in (0.001, 5.0, 20.0):
        rig = Rig()
        stamp_ns = rig.feed(sines(40.0, amplitude, amplitude, 0.5))
        assert (rig.vibrations.reason, rig.estimator.vibrations[0, 0]["bounded"]) == ("", 1)
        assert rig.estimator.estimate(stamp_ns)
        beam, record = rig.chain.beams[0], rig.estimator.vibrations[0, 0]
        sigmas.append(float(record["sigma_mean"]))
        gains = record["sigma_mean"] * beam.sag_gain[3:], record["sigma_difference"] * beam.tilt_gain[3:]
        expected = sum(gain @ gain.T for gain in gains)
        found = rig.estimator.covariance_systematic[3:, 3:]  # in the axes of the base
        np.testing.assert_allclose(np.linalg.eigvalsh(found), np.linalg.eigvalsh(expected), rtol=1e-6, atol=1e-24)
        variances.append(float(np.trace(rig.estimator.covariance_systematic)))
    assert sigmas[0] < 0.05 < sigmas[1] < sigmas[2]
    np.testing.assert_allclose(sigmas[2] / sigmas[1], 4.0, rtol=0.1)
    assert variances[0] < variances[1] < variances[2]


def test_beyond_the_limit_the_level_is_not_bounded() -> None:
    levels = []
    for frequency in (40.0, 50.0):
        rig = Rig()
        rig.estimator.use_causes([JointCauses(("a",), (0,), (0,))] * 2)
        rig.estimator.fault_effects[:] = 0.0
        rig.estimator.fault_effects[..., 6] = 1.0
        assert rig.estimator.estimate(rig.feed(sines(frequency, 10.0, 10.0, 0.5)))
        rig.estimator.bound_error()
        levels.append(rig.estimator.protection_level.copy())
    assert np.all(np.isfinite(levels[0]))
    assert np.all(np.isinf(levels[1]))
    sentence = "vibrates faster than 45 Hz, 0.45 of its first natural frequency: the protection level is not bounded"
    assert rig.vibrations.reason == f"beam 'upper_arm' {sentence}"


GOOD = sines(30.0, 5.0, 5.0, 0.5)
OLD = f"has no reading whose stamp is at most {AGE_S:g} s old"
CAUSES: dict[str, tuple[Any, str]] = {
    "missing": (lambda rig: rig.vibrations.update(2 * NS), OLD),
    "begins": (lambda rig: rig.feed(GOOD[:200]), "has begun to read; the beam is not yet followed"),
    "a gap": (
        lambda rig: (rig.feed(GOOD), rig.feed(GOOD[:200], 1.6)),
        f"has readings {0.1 + 1.0 / RATE:g} s apart, more than {AGE_S:g} s; the beam is not yet followed",
    ),
    "too slow": (
        lambda rig: [rig.feed(GOOD[n : n + 1], 1.0 + 0.01 * n) for n in range(100)],
        f"has readings 0.01 s apart, more than {AGE_S:g} s; the beam is not yet followed",
    ),
    "not a number": (lambda rig: rig.feed(np.concatenate([GOOD, [np.full((2, 3), np.nan)]])), "does not read numbers"),
    "too large": (lambda rig: rig.feed(np.concatenate([GOOD, 60.0 * GOOD[-40:-39]])), "reads more than 200 m/s^2"),
    "frozen": (
        lambda rig: rig.feed(np.concatenate([GOOD, np.repeat(GOOD[-1:], round(FROZEN_S * RATE) + 2, axis=0)])),
        f"has read the same along X for {FROZEN_S:g} s",
    ),
    "one axis frozen": (lambda rig: rig.feed(GOOD * [1.0, 1.0, 0.0]), f"has read the same along Z for {FROZEN_S:g} s"),
    "one sensor with both topics": (
        lambda rig: [rig.feed(GOOD[n : n + 20, [0, 0]], 1.0 + n / RATE) for n in range(0, len(GOOD), 20)],
        f"has read the same as 'far' for {FROZEN_S:g} s",
    ),
    "asked once, one sensor with both topics": (
        lambda rig: rig.feed(GOOD[:, [0, 0]]),
        f"has read the same as 'far' for {FROZEN_S:g} s",
    ),
    "another clock": (
        lambda rig: (rig.vibrations.update(1000 * NS), rig.feed(GOOD), rig.vibrations.update(1001 * NS)),
        OLD + ": its stamps are more than 1 s behind those of the scans",
    ),
    "without gravity": (
        lambda rig: rig.feed(GOOD + rig.gravity),
        "does not read gravity as the arm stands: check its unit, its axes, and whether it is exchanged",
    ),
    "in g": (
        lambda rig: rig.feed(GOOD / 9.81 + rig.gravity * (1.0 - 1.0 / 9.81)),
        "does not read gravity as the arm stands: check its unit, its axes, and whether it is exchanged",
    ),
    "turned over": (
        lambda rig: rig.feed(2.0 * rig.gravity - GOOD),
        "does not read gravity as the arm stands: check its unit, its axes, and whether it is exchanged",
    ),
}


@pytest.mark.parametrize("cause", CAUSES)
def test_an_accelerometer_that_cannot_be_used_is_named_and_its_beam_at_rest(cause: str) -> None:
    feed, sentence = CAUSES[cause]
    rig = Rig()
    feed(rig)
    assert rig.vibrations.reason.split("; accelerometer")[0] == f"accelerometer 'near' of beam 'upper_arm' {sentence}"
    record = rig.estimator.vibrations[0, 0]
    assert np.isnan(record["mean"]).all()
    assert (record["sigma_mean"], record["sigma_difference"], record["bounded"]) == (SPREAD, SPREAD, 1)


def test_exchanged_plugs_a_replay_and_a_refused_message_are_noticed() -> None:
    rig = Rig()
    stamp_ns = rig.feed(GOOD)
    assert not rig.vibrations.reason
    rig.vibrations.update(1)  # time has gone back
    assert "has no reading" in rig.vibrations.reason
    rig.feed(GOOD)
    assert not rig.vibrations.reason
    rig.vibrations.refuse("near", "has sent an invalid message: too short")
    rig.vibrations.update(stamp_ns)
    sentence = "has sent an invalid message: too short"
    assert str(rig.vibrations.reason) == f"accelerometer 'near' of beam 'upper_arm' {sentence}"
    rig.vibrations.add("near", stamp_ns + 1, (0.0, 0.0, 9.8), "far")
    rig.vibrations.update(stamp_ns + 1)
    assert "receives the readings of 'far'" in rig.vibrations.reason
    rig.vibrations.restart()
    rig.feed(GOOD, 3.0)
    assert not rig.vibrations.reason


def test_a_reading_of_another_accelerometer_and_one_of_the_future_change_nothing() -> None:
    found = []
    for is_foreign in (False, True):
        rig = Rig()
        stamp_ns = rig.feed(GOOD)
        if is_foreign:
            rig.vibrations.add("near", stamp_ns + 200_000, (99.0, 0.0, 9.8), "far")
            rig.vibrations.add("near", stamp_ns + 10**15, (99.0, 0.0, 9.8), "near")
        rig.feed(GOOD[:2], stamp_ns / NS + 1.0 / RATE)
        assert not rig.vibrations.reason
        found.append(rig.estimator.vibrations[0].copy())
    np.testing.assert_array_equal(*found)


def test_the_uncertainty_of_the_time_enters_that_of_the_force() -> None:
    """The force changes by at most its amplitude times 2 pi times its frequency."""
    frequency, amplitude, delay_s = 30.0, 5.0, 1e-3
    sigmas = []
    for each in (1e-7, delay_s):
        rig = Rig(accelerometers={"delay": quantity(each, "s")})
        rig.feed(sines(frequency, amplitude, amplitude, 0.5))
        sigmas.append(rig.estimator.vibrations["sigma_mean"][0, 0])
    added = math.sqrt(sigmas[1] ** 2 - sigmas[0] ** 2)
    gain = 1.0 / (1.0 - (frequency / FREQUENCY) ** 2)
    np.testing.assert_allclose(added, gain * amplitude * 2.0 * math.pi * frequency * delay_s / 2.0**0.5, rtol=0.05)


def test_gravity_is_looked_for_before_a_quick_oscillator_is_used() -> None:
    """The oscillator forgets its beginning in 5 ms, but a sensor that leaves gravity out is not used even then."""
    quick = {"frequency": {**quantity(FREQUENCY, "Hz"), "sigma": 1.0}, "damping": quantity(0.3, "1")}
    for turn in (0.0, 15.0):
        rig = Rig(**quick)
        R = pin.exp3(np.radians([turn, 0.0, 0.0]))
        wrong = GOOD + rig.gravity if not turn else (GOOD - rig.gravity) @ R.T + rig.gravity
        for n in range(0, len(wrong), 40):
            rig.feed(wrong[n : n + 40], 1.0 + n / RATE)
            assert "accelerometer 'near'" in rig.vibrations.reason


def test_without_accelerometers_the_beam_is_at_rest_with_its_spread() -> None:
    plain = Chain(ARM, "tip", vibrating_beam(spread=quantity(1e-3, "m/s^2"))).estimate(STILL)
    spread = Chain(ARM, "tip", vibrating_beam()).estimate(STILL)
    np.testing.assert_array_equal(plain.T_base_endpoint.homogeneous, spread.T_base_endpoint.homogeneous)
    assert np.trace(spread.covariance()) > 1e3 * np.trace(plain.covariance())


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"version": 3}, "vibration in a file of version 3; expected version 4"),
        ({"sag": False}, "'vibration' without 'sag'; expected 'sag', which vibration changes"),
        ({"frequency": quantity(100.0, "Hz")}, "sigma 0 Hz; expected more than 0 to 20 Hz"),
        ({"frequency": {**quantity(0.1, "Hz"), "sigma": 0.01}}, "frequency 0.1 Hz; expected 1 to 100000 Hz (in kHz?)"),
        ({"damping": quantity(2.0, "1")}, "damping 2 1; expected 1e-05 to 0.3 1 (in percent?)"),
        ({"limit": quantity(50.0, "1")}, "limit 50 1; expected 0.05 to 0.9 1 (in percent?)"),
        ({"spread": quantity(0.0, "m/s^2")}, "spread 0 m/s^2; expected 0.0001 to 1000 m/s^2"),
        ({"uncertainty": quantity(5.0, "1")}, "uncertainty 5 1; expected 0 to 1 1 (in percent?)"),
        (
            {
                "frequency": {**quantity(2.0 * math.pi * FREQUENCY, "Hz"), "sigma": 1.0},
                "accelerometers": {"age": quantity(0.0005, "s")},
            },
            "natural frequency 628.3 Hz; expected 43",
        ),
        ({"frequency": {**quantity(30.0, "Hz"), "sigma": 1.0}}, "natural frequency 30 Hz; expected 43"),
        (
            {"accelerometers": {"age": quantity(0.02, "s")}},
            "age 0.02 s; expected at most 0.0111 s: slower readings do not show a vibration of 45 Hz, at 'limit'",
        ),
        ({"accelerometers": {"delay": quantity(0.1, "s")}}, "delay 0.1 s; expected 1e-07 to 0.02 s (in ms?)"),
        ({"damping": quantity(-0.01, "1")}, "damping -0.01 1; expected 1e-05 to 0.3 1"),
        ({"accelerometers": {"names": ["a", "a"]}}, "two accelerometers have the name 'a'"),
        ({"accelerometers": {"names": ["a b", "c"]}}, "name 'a b'; expected a letter"),
        ({"accelerometers": {"names": ["a"]}}, "names"),
        ({"accelerometers": {"range": quantity(2.0, "m/s^2")}}, "range 2 m/s^2; expected 15 to 100000 m/s^2 (in stand"),
        ({"accelerometers": {"age": quantity(2.0, "s")}}, "age 2 s; expected 0.0001 to 0.1 s (in ms?)"),
    ],
)
def test_a_wrong_vibration_is_refused(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises((ValueError, ChainError), match=re.escape(sentence)):
        Chain(ARM, "tip", vibrating_beam(**changes))
