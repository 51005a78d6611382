# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Stamps as times: the same one by one, in kernels and in arrays; what is no time is none."""

from __future__ import annotations

import numpy as np
import pytest
from posor.numerics.stamps import CAPACITY, TimestampLog, time_in_kernel, time_ns, times_ns


@pytest.mark.parametrize(
    ("seconds", "nanoseconds", "expected"),
    [
        (0, 0, 0),
        (1, 2, 1_000_000_002),
        (-1, 999_999_999, -1),
        (2**31 - 1, 999_999_999, 2_147_483_647_999_999_999),
        (-1, 1_000_000_000, 0),
        (5, 2**32 - 1, 0),
    ],
)
def test_time_of_a_stamp(seconds: int, nanoseconds: int, expected: int) -> None:
    assert time_ns(seconds, nanoseconds) == time_in_kernel(seconds, nanoseconds) == expected
    assert times_ns(np.array([seconds]), np.array([nanoseconds])).tolist() == [expected]


def test_a_full_log_keeps_the_last_times() -> None:
    times = iter(range(10 + CAPACITY + 3))
    log = TimestampLog(lambda: next(times))
    for reference in range(10 + CAPACITY + 3):
        log.record(-reference)
    references, recordings = log.drain()
    assert np.array_equal(recordings, np.arange(13, 13 + CAPACITY))
    assert np.array_equal(references, -recordings)
    assert [drained.size for drained in log.drain()] == [0, 0]
