from __future__ import annotations

import numpy as np
import pytest
from posor_drivers.simulator.converter import converted

RANGE = np.array([-8.0, 8.0])
STEP = 16.0 / 4096
LAST = 8.0 - STEP


@pytest.mark.parametrize(
    ("value", "code_value", "ended"),
    [
        (0.0, 0.0, False),
        (0.4 * STEP, 0.0, False),
        (0.6 * STEP, STEP, False),
        (-8.0 + STEP, -8.0 + STEP, False),
        (-8.0, -8.0, True),
        (-9.0, -8.0, True),
        (LAST - STEP, LAST - STEP, False),
        (LAST, LAST, True),
        (7.99999, LAST, True),
        (100.0, LAST, True),
    ],
)
def test_value_becomes_the_nearest_code_and_an_end_code_is_told(
    value: float, code_value: float, *, ended: bool
) -> None:
    values, ends = converted(np.array([[value, 1.0], [1.0, 1.0]]), RANGE, 12, steps=True)
    assert values[0, 0] == code_value
    assert ends.tolist() == [ended, False]


def test_without_steps_only_the_range_is_left() -> None:
    values, ends = converted(np.array([[0.4 * STEP], [20.0]]), RANGE, 12, steps=False)
    assert values[:, 0] == pytest.approx([0.4 * STEP, LAST], abs=1e-12)
    assert ends.tolist() == [False, True]
