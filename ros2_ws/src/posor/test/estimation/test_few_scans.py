# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Exposures, stamps and time offsets in few scans, so that ``make coverage`` observes their kernels uncompiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from posor import Estimates, Posor, Scans, State, simulate

from .test_clocks import FIRST_NS, JOINTS, RATE, START, calibration_of, poses

COUNT, PERIOD_S = 12, 5e-3
TIMES = PERIOD_S * np.arange(COUNT)
NAMES = ("gap_voltages", "ring_voltages", "diode_currents")


def turned(kind: str, times: NDArray[Any], period_s: float = PERIOD_S) -> Scans:
    """Return scans without noise of a joint that turns; stamps at regular times."""
    scans = simulate(calibration_of(kind), poses(times))
    stamps = FIRST_NS + np.round(period_s * 1e9 * np.arange(len(times))).astype(np.int64)
    return scans.with_fields({"stamps_ns": stamps, "numbers": np.arange(len(times), dtype=np.uint64)})


def estimate(kind: str, scans: Scans) -> Estimates:
    posor = Posor(calibration_of(kind))
    posor.confirm_theta(START, 1e-4)
    return posor.estimate_all(scans)


def read_in_turn(kind: str, offsets: NDArray[Any]) -> Scans:
    """Return scans whose probes and diodes are read one after another; the light source does not change meanwhile."""
    fields, first = {}, 0
    plain = turned(kind, TIMES)
    for name in NAMES:
        values = getattr(plain, name).copy()
        for channel in np.ndindex(values.shape[1:]):
            moved = turned(kind, TIMES + offsets[first])
            same = (moved.lit_sources == plain.lit_sources).all(axis=1)
            values[(same, *channel)] = getattr(moved, name)[(same, *channel)]
            first += 1
        fields[name] = values
    return plain.with_fields({name: values for name, values in fields.items() if values.size})


@pytest.mark.parametrize("kind", JOINTS)
def test_channels_in_turn_give_the_pose_at_the_stamp_if_stated(kind: str) -> None:
    plain = turned(kind, TIMES)
    count = sum(math.prod(getattr(plain, name).shape[1:]) for name in NAMES)
    offsets = 40e-6 * (np.arange(count) - 0.5 * (count - 1))
    read, ideal = read_in_turn(kind, offsets), estimate(kind, plain)
    span = {"exposure_spans": np.full(COUNT, np.ptp(offsets))}
    stated = estimate(kind, read.with_fields({"exposure_offsets": np.tile(offsets, (COUNT, 1)), **span}))
    unknown = estimate(kind, read.with_fields({"exposure_offsets": np.full((COUNT, count), np.nan), **span}))
    ignored = estimate(kind, read)
    off = [np.abs(each.natives - ideal.natives)[4:] / ideal.standard_uncertainties[4:] for each in (stated, ignored)]
    assert off[0].max() < 0.1
    assert not (off[1].max(axis=1) <= 1.0).any()  # NaN: LOST
    assert (stated.states == State.OK)[6:].all()
    assert not (unknown.states == State.OK)[4:].any()


def test_the_uncertainty_of_the_stamps_enters_the_random_covariance() -> None:
    scans = turned("light ring", TIMES)
    plain, grown = (
        estimate("light ring", scans.with_fields({"stamp_uncertainties": np.full(COUNT, s)})).covariances_random[-1]
        for s in (0.0, 1e-3)
    )
    assert grown[5, 5] - plain[5, 5] == pytest.approx((1e-3 * RATE) ** 2, rel=0.05)


@pytest.mark.parametrize("late_s", [0.04, -0.04])
def test_an_encoder_shows_the_offset_of_the_stamps_in_motion(late_s: float) -> None:
    """The joint turns forth and back, so that an error of the encoder's zero is distinguished from the offset."""
    times = 0.02 * np.arange(60)
    scans, rng = turned("light ring", np.abs(times - late_s - 0.6), 0.02), np.random.default_rng(2)
    posor = Posor(calibration_of("light ring"))
    for n in range(len(scans)):
        theta = START + RATE * abs(times[n] - 0.6)
        posor.confirm_theta(theta + 6e-3 * rng.standard_normal(), 6e-3, scans[n].stamp_ns)
        posor.estimate(scans[n])
    offset, uncertainty = posor.time_offset
    assert abs(offset - late_s) < 4.0 * uncertainty < 0.05
