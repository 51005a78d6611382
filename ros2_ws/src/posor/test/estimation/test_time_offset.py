# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Stamps that are wrong by a constant: bounded by ``stamp_limit``, found by an encoder."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from posor import Estimate, Fault, Posor, Scan, Scans, State, simulate
from posor.chain.fault_bounds import COVERAGE_FACTOR
from posor.model.scan import STATED_HOME
from posor.numerics.array_types import FloatArray

from .test_clocks import FIRST_NS, JOINTS, PERIOD_S, calibration_of, errors

COUNT, MOVING = 800, 200  # scans, and those at rest before the joint swings
TIMES: FloatArray = np.asarray(np.arange(COUNT) * PERIOD_S, dtype=np.float64)
SPEED, ANGULAR = 0.5, 0.5 * math.pi  # largest rate [rad/s], angular frequency of the swing [rad/s]
LATE_S, SIGMA = 0.04, 4e-3  # by which content is older than its stamps [s]; of an encoder [rad]: 5 of them are 40 ms


def thetas(times: FloatArray) -> FloatArray:
    swinging = ANGULAR * np.maximum(times - MOVING * PERIOD_S, 0.0)
    return np.asarray(SPEED / ANGULAR * (1.0 - np.cos(swinging)))


def poses(times: FloatArray) -> FloatArray:
    """Return the true poses at times [s], shape (n, 7)."""
    theta = thetas(times)
    out = np.zeros((len(times), 7))
    out[:, 0], out[:, 1], out[:, 2] = 4e-6 * np.cos(theta), 4e-6 * np.sin(theta), 0.735e-3
    out[:, 5], out[:, 6] = np.sin(0.5 * theta), np.cos(0.5 * theta)
    return out


def swung(kind: str, late_s: float, limit_s: float = 0.0, times: FloatArray = TIMES) -> Scans:
    """Return scans whose content is older than their stamps."""
    scans = simulate(calibration_of(kind), poses(times - late_s), seed=1)
    index = np.arange(len(times))
    fields = {"stamps_ns": FIRST_NS + np.round(times * 1e9).astype(np.int64), "numbers": index.astype(np.uint64)}
    fields["at_home"] = np.where(index == 0, STATED_HOME * (kind == "bumpy ring"), 0)
    return scans.with_fields({**fields, "stamp_limits": np.full(len(times), limit_s)})


@pytest.mark.parametrize("late_s", [1e-4, 0.01, LATE_S, -LATE_S])
def test_a_stated_limit_bounds_the_error_of_late_and_early_stamps(late_s: float) -> None:
    kind, times, limit = "light ring", TIMES + MOVING * PERIOD_S + 0.5, abs(late_s)
    posor = Posor(calibration_of(kind))
    found = posor.estimate_all(swung(kind, late_s, limit, times))
    assert (found.states == State.OK).all()
    off, which = np.abs(errors(found, poses(times))), [0, 1, 2, 5]
    bound, sigmas = found.stamp_shifts[:, which], found.standard_uncertainties[:, which]
    assert (off <= bound + COVERAGE_FACTOR * sigmas).all()
    motion = posor.calibration.motion
    assert motion is not None
    assert motion.acceleration is not None
    largest = limit * np.array([*[motion.translation.number] * 3, motion.theta.number])
    assert bound[0] == pytest.approx(largest, rel=0.01, abs=1e-5)
    accelerations = np.array([*[motion.acceleration.translation.number] * 3, motion.acceleration.theta.number])
    widest = off[1:].max(axis=0) + limit * accelerations * (limit + PERIOD_S) + 1e-5
    assert (bound[1:] <= np.minimum(widest, 1.02 * largest)).all()


@pytest.mark.parametrize("late_s", [LATE_S, -LATE_S])
def test_a_motion_that_begins_within_the_limit_is_bounded(late_s: float) -> None:
    kind = "light ring"
    assert errors(Posor(calibration_of(kind)).estimate_all(swung(kind, late_s)), poses(TIMES)).any()
    found = Posor(calibration_of(kind)).estimate_all(swung(kind, late_s, abs(late_s)))
    allowed = found.stamp_shifts + COVERAGE_FACTOR * found.standard_uncertainties
    assert (np.abs(errors(found, poses(TIMES))) <= allowed[:, [0, 1, 2, 5]]).all()


def test_a_mean_over_an_accelerated_motion_is_bounded_by_its_exposure() -> None:
    """The mean of a swing is behind the pose at its middle, and no reading contradicts another."""
    kind, size = "light ring", 5
    single, groups = swung(kind, 0.0), np.arange(COUNT).reshape(-1, size)
    lit = single.lit_sources[groups]
    groups = groups[(lit == lit[:, :1]).all(axis=(1, 2))]  # one source, as of conditioned scans
    middle, span_s = groups[:, size // 2], (size - 1) * PERIOD_S
    channels = single.gap_voltages.shape[1] + single.diode_currents[0].size
    fields = {name: getattr(single, name)[groups].mean(axis=1) for name in ("gap_voltages", "diode_currents")}
    fields |= {"exposure_spans": np.full(len(groups), span_s), "exposure_offsets": np.zeros((len(groups), channels))}
    means = single.select(np.isin(np.arange(COUNT), middle)).with_fields(fields)
    found = Posor(calibration_of(kind)).estimate_all(means)
    assert (found.states == State.OK).all()
    off = np.abs(errors(found, poses(TIMES[middle])))
    beyond = off - COVERAGE_FACTOR * found.standard_uncertainties[:, [0, 1, 2, 5]]
    assert (beyond[:, 3] > 0.0).any()
    assert (beyond <= found.stamp_shifts[:, [0, 1, 2, 5]]).all()
    motion = calibration_of(kind).motion
    assert motion is not None
    assert motion.acceleration is not None
    along = 0.125 * span_s**2 * motion.acceleration.translation.number
    np.testing.assert_allclose(
        found.stamp_shifts[:, 2], min(along, 0.5 * span_s * motion.translation.number), rtol=1e-9
    )


def test_without_motion_limits_nothing_is_bounded_and_without_accelerations_by_the_velocity() -> None:
    calibration, limit = calibration_of("light ring"), 1e-3
    motion = calibration.motion
    assert motion is not None
    scans = swung("light ring", 0.0, limit)
    unknown = Posor(calibration.model_copy(update={"motion": None})).estimate_all(scans)
    assert np.isinf(unknown.stamp_shifts).all()
    slow = motion.model_copy(update={"acceleration": None})
    found = Posor(calibration.model_copy(update={"motion": slow})).estimate_all(scans)
    np.testing.assert_allclose(found.stamp_shifts[:, 2], limit * motion.translation.number)


def test_without_a_limit_or_a_pose_nothing_is_added() -> None:
    scans = swung("light ring", 0.0, 0.01).editable()
    scans.stamp_limits[300:320], scans.gap_voltages[350] = 0.0, math.nan
    shifts = Posor(calibration_of("light ring")).estimate_all(scans).stamp_shifts
    assert not shifts[300:320].any()
    assert shifts[0, 5] > 2.0 * shifts[299, 5] > 0.0
    assert np.isnan(shifts[350]).all()
    assert (shifts[351:] > 0.0).all()


def one_by_one(scans: Scans) -> list[Scan]:
    return [scans[n] for n in range(len(scans))]


def confirmed(
    kind: str, scans: Scans, sigma: float, error: Callable[[float], float], age_s: float = 0.0
) -> list[Estimate]:
    """Return the estimates of scans with a reading of an encoder for each, older than its stamp by up to ``age_s``."""
    posor, rng, found = Posor(calibration_of(kind)), np.random.default_rng(4), []
    for scan in one_by_one(scans):
        time_s = (scan.stamp_ns - FIRST_NS) * 1e-9 - age_s * rng.uniform()
        theta = float(thetas(np.array([time_s]))[0]) + error(time_s)
        posor.confirm_theta(theta, sigma, FIRST_NS + round(time_s * 1e9))
        found.append(posor.estimate(scan))
    return found


def faulty(estimates: list[Estimate]) -> list[int]:
    return [n for n, each in enumerate(estimates) if each.faults & Fault.ENCODER]


NOISE = np.random.default_rng(5)
ENCODER_ERRORS: dict[str, Callable[[float], float]] = {
    "noise": lambda _: SIGMA * NOISE.standard_normal(),
    "eccentricity": lambda time_s: 1.4 * SIGMA * math.sin(7.0 * thetas(np.array([time_s]))[0]),
    "backlash": lambda time_s: math.copysign(SIGMA, math.sin(ANGULAR * (time_s - MOVING * PERIOD_S))),
}


@pytest.mark.parametrize("kind", JOINTS)
@pytest.mark.parametrize("error", ENCODER_ERRORS)
def test_an_encoder_within_its_uncertainty_raises_no_fault(kind: str, error: str) -> None:
    estimates = confirmed(kind, swung(kind, 0.0), SIGMA, ENCODER_ERRORS[error])
    assert faulty(estimates) == []
    assert all(each.state == State.OK for each in estimates[10:])


@pytest.mark.parametrize("kind", JOINTS)
@pytest.mark.parametrize("late_s", [LATE_S, -LATE_S])
@pytest.mark.parametrize("error", ENCODER_ERRORS)
def test_a_time_offset_is_named_soon_in_motion_where_the_angle_still_agrees(
    kind: str, late_s: float, error: str
) -> None:
    estimates = confirmed(kind, swung(kind, late_s), SIGMA, ENCODER_ERRORS[error])
    first = next(n for n, each in enumerate(estimates) if "time offset" in each.reason)
    assert MOVING < first < MOVING + 2.0 / PERIOD_S
    assert SPEED * LATE_S <= 5.0 * SIGMA  # the angle alone agrees, but for its error
    assert all(each.state == State.LOST for each in estimates[first:])
    stated = float(estimates[-1].reason.split("encoder is ")[1].split(" ms")[0])
    assert stated == pytest.approx(1e3 * late_s, abs=15.0)
    assert "expected at most 0 ms, the stated stamp_limit" in estimates[-1].reason


def test_a_precise_encoder_tells_the_offset_precisely_and_its_uncertainty_holds() -> None:
    scans = swung("light ring", LATE_S)
    posor = Posor(calibration_of("light ring"))
    assert all(math.isnan(value) for value in posor.time_offset)
    for scan in one_by_one(scans):
        theta = float(thetas(np.array([(scan.stamp_ns - FIRST_NS) * 1e-9]))[0])
        posor.confirm_theta(theta + 1e-4 * NOISE.standard_normal(), 1e-4, scan.stamp_ns)
        posor.estimate(scan)
    offset, uncertainty = posor.time_offset
    assert abs(offset - LATE_S) < 5.0 * uncertainty < 1e-3


def test_a_stated_limit_tolerates_the_offset_in_angle_and_time() -> None:
    scans = swung("light ring", LATE_S, 1.1 * LATE_S)
    estimates = confirmed("light ring", scans, 1e-3, lambda _: 0.0)
    assert faulty(estimates) == []
    assert all(each.state == State.OK for each in estimates)


def test_a_reading_is_used_at_its_own_time() -> None:
    """Readings up to 20 ms old, of an encoder that is much better than the motion meanwhile, 10 mrad."""
    estimates = confirmed("light ring", swung("light ring", 0.0), 1e-4, lambda _: 0.0, age_s=0.02)
    assert faulty(estimates) == []


def test_an_acknowledgement_forgets_the_offset() -> None:
    scans = swung("light ring", LATE_S)
    posor = Posor(calibration_of("light ring"))
    for scan in one_by_one(scans.part(0, 500)):
        posor.confirm_theta(float(thetas(np.array([(scan.stamp_ns - FIRST_NS) * 1e-9]))[0]), SIGMA, scan.stamp_ns)
        posor.estimate(scan)
    assert posor.acknowledge()
    assert math.isnan(posor.time_offset[0])
    assert posor.estimate(scans[500]).faults == Fault.ACKNOWLEDGED
