# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Readings of encoders between their stamps."""

from __future__ import annotations

import numpy as np
from posor.bags.recorded_encoders import RecordedEncoders


def test_readings_without_an_effort_are_left_out_where_others_have_one() -> None:
    stamps_ns = 10_000_000 * np.arange(1, 22)
    positions, efforts = 0.1 * np.arange(21.0)[:, None], 3.0 * np.arange(21.0)[:, None]
    missing = efforts.copy()
    missing[1::2] = np.nan
    for given, expected in ((efforts, efforts), (missing, efforts), (np.full((21, 1), np.nan), 0.0 * efforts)):
        found = RecordedEncoders(stamps_ns, positions, given, "bag").at(0, stamps_ns)
        np.testing.assert_allclose(found, np.hstack([positions, expected]), rtol=1e-12)
