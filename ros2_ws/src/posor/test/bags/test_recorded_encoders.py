# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Readings of encoders between their stamps."""

from __future__ import annotations

import numpy as np
from posor.bags.recorded_encoders import RecordedEncoders
from posor.numerics.array_types import FloatArray, IntArray


def test_readings_without_an_effort_are_left_out_where_others_have_one() -> None:
    stamps_ns = 10_000_000 * np.arange(1, 22)
    positions, efforts = 0.1 * np.arange(21.0)[:, None], 3.0 * np.arange(21.0)[:, None]
    missing = efforts.copy()
    missing[1::2] = np.nan
    for given, expected in ((efforts, efforts), (missing, efforts), (np.full((21, 1), np.nan), 0.0 * efforts)):
        found = RecordedEncoders(stamps_ns, positions, given, "bag").at(0, stamps_ns)
        np.testing.assert_allclose(found, np.hstack([positions, expected]), rtol=1e-12)


def test_positions_between_readings_follow_an_acceleration() -> None:
    def position(stamps_ns: IntArray) -> FloatArray:
        return np.asarray(0.2 * np.sin(2.0 * np.pi * 1e-9 * stamps_ns))

    stamps_ns, between_ns = 40_000_000 * np.arange(100), 40_000_000 * np.arange(1, 98) + 20_000_000
    encoders = RecordedEncoders(stamps_ns, position(stamps_ns)[:, None], np.full((100, 1), np.nan), "bag")
    np.testing.assert_allclose(encoders.at(0, between_ns)[:, 0], position(between_ns), atol=2e-5)  # a line: 1.6e-3
    assert np.isnan(encoders.at(0, between_ns + 4_000_000_000)).all()
