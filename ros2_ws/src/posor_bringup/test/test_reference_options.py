# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Numbers of options by the name of a reference: numbers in another unit are refused."""

from __future__ import annotations

import pytest
from posor.errors import ParameterError
from posor_bringup.reference_options import (
    PLACE_LIMITS,
    TOOL_UNCERTAINTY_LIMITS,
    UNCERTAINTY_LIMITS,
    Limits,
    named_numbers,
    numbers_of,
)


def test_numbers_are_read_by_name() -> None:
    found = named_numbers("program", ["a=15e-6,6e-6", "b=0.005"], (1, 2, 3), UNCERTAINTY_LIMITS)
    assert found == {"a": [15e-6, 6e-6], "b": [0.005]}


@pytest.mark.parametrize(
    ("text", "counts", "limits"),
    [
        ("0.015,0.006", (1, 2), UNCERTAINTY_LIMITS),  # in mm
        ("15", (1, 2), UNCERTAINTY_LIMITS),  # in um
        ("0", (1, 2), UNCERTAINTY_LIMITS),
        ("1e-300", (1, 2), UNCERTAINTY_LIMITS),
        ("-1e-6", (1, 2), UNCERTAINTY_LIMITS),
        ("1e-6,1e-6,1e-6,1e-6", (1, 2, 3), UNCERTAINTY_LIMITS),
        ("nan", (1, 2), UNCERTAINTY_LIMITS),
        ("1_0e-6", (1, 2), UNCERTAINTY_LIMITS),
        ("0.05,0", (2,), TOOL_UNCERTAINTY_LIMITS),
        ("50,0.2", (2,), TOOL_UNCERTAINTY_LIMITS),
        ("0,0,50", (3, 6), PLACE_LIMITS),
        ("0,0,0.05,0,0,90", (3, 6), PLACE_LIMITS),
    ],
)
def test_numbers_in_another_unit_are_refused(text: str, counts: tuple[int, ...], limits: Limits) -> None:
    with pytest.raises(ParameterError, match=f"^program: '{text}'; expected "):
        numbers_of("program", text, counts, limits)
