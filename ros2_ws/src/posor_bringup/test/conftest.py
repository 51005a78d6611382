"""Motion tests made from the result table that the thesis printed, which is real data and known to the microradian."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from posor_bringup.installed import data_path
from posor_bringup.motion import TRUTH_LEVER, MotionTest, Step
from posor_bringup.thesis import PRINTED_FILES, PrintedColumns, read_printed
from posor_estimator.core.fault import Fault, State

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from posor_estimator.core.types import FloatArray

OFFSET = np.array([3e-3, -2e-3, 0.1])
"""Angles of the first step [rad], which no figure may depend on."""


@pytest.fixture(scope="session")
def printed() -> PrintedColumns:
    return read_printed(data_path(PRINTED_FILES["ymo"]))


@pytest.fixture(scope="session")
def printed_test(printed: PrintedColumns) -> Callable[..., MotionTest]:
    """Return a maker of YMO as it was printed, with chosen steps changed."""

    def make(
        shifts: Mapping[int, FloatArray] | None = None,
        lost: tuple[int, ...] = (),
        statuses: Mapping[int, int] | None = None,
        count: int = 15,
    ) -> MotionTest:
        steps = []
        for number in range(1, count + 1):
            angles = OFFSET + printed.posor[number - 1] + (shifts or {}).get(number, 0.0)
            away = np.array([0.0, 0.0, 0.0])
            away[1:] = -np.tan(printed.measured[number - 1, 1:]) * TRUTH_LEVER
            gone = number in lost
            steps.append(
                Step(
                    number=number,
                    state=State.LOST if gone else State.OK,
                    faults=Fault.OUT_OF_RANGE if gone else Fault.NONE,
                    scan_status=(statuses or {}).get(number, 0),
                    angles=np.full(3, np.nan) if gone else angles,
                    truth=np.array([0.5, 0.6, 0.7]) + away,
                    endpoint=np.full(3, np.nan) if gone else np.array([-0.8, 0.0, 0.0]) + 1.1 * away,
                )
            )
        return MotionTest(tuple(steps))

    return make
