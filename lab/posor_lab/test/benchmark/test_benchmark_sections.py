# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest
from posor_lab.benchmark.benchmark_sections import RATE_LADDER, SEPARATE_LADDER, find_highest_rate, least_lost_share


@pytest.mark.parametrize(
    ("holds_to", "allowed", "expected"),
    [(2600, 0.0, 2500), (499, 0.0, None), (500, 0.0, 500), (1e5, 0.0, 10_000), (1, 0.2, 10_000)],
)
def test_highest_rate_is_found_by_bisection(holds_to: float, allowed: float, expected: int | None) -> None:
    measured: list[int] = []

    def lost_share(rate: int) -> float:
        measured.append(rate)
        return 0.1 if rate > holds_to else 0.0

    assert find_highest_rate(lost_share, allowed) == expected
    assert len(measured) <= 4
    assert set(measured) <= set(RATE_LADDER)


@pytest.mark.parametrize(
    ("shares", "allowed", "expected", "tries"),
    [([0.0, 9.0], 0.0, 0.0, 1), ([0.3, 0.0], 0.0, 0.0, 2), ([0.3, 0.2, 0.0], 0.1, 0.2, 2), ([0.05, 0.0], 0.1, 0.05, 1)],
)
def test_rate_is_measured_twice_before_it_fails(
    shares: list[float], allowed: float, expected: float, tries: int
) -> None:
    remaining, measured = iter(shares), dict[int, list[float]]()
    for _ in range(2):  # the second call measures nothing
        assert least_lost_share(lambda _: next(remaining), 500, allowed, measured) == expected
    assert measured == {500: shares[:tries]}


def test_highest_rate_of_another_ladder() -> None:
    assert find_highest_rate(lambda rate: 0.0005 if rate <= 250 else 0.5, 0.001, SEPARATE_LADDER) == 250
