# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Motion tests made from the printed result table: real data, known to the microradian."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from posor.model.fault import Fault, State
from posor.numerics.array_types import FloatArray
from posor_lab.replay_1985.motion_test import TRUTH_LEVER, MotionStep, MotionTest
from posor_lab.replay_1985.printed_results import PRINTED_FILES, PrintedColumns, read_printed
from posor_lab.thesis_data import data_path

OFFSET = np.array([3e-3, -2e-3, 0.1])  # angles of the first step [rad]; no figure may depend on them


@pytest.fixture(scope="session")
def printed() -> PrintedColumns:
    return read_printed(data_path(PRINTED_FILES["ymo"]))


@pytest.fixture(scope="session")
def printed_test(printed: PrintedColumns) -> Callable[..., MotionTest]:
    """Return a function that makes the printed test YMO with some steps changed."""

    def make(
        shifts: Mapping[int, FloatArray] | None = None,
        lost: tuple[int, ...] = (),
        statuses: Mapping[int, int] | None = None,
        count: int = 15,
    ) -> MotionTest:
        steps = []
        for number in range(1, count + 1):
            moved = np.array([0.0, *(-np.tan(printed.truth[number - 1, 1:]) * TRUTH_LEVER)])
            is_lost, missing = number in lost, np.full(3, np.nan)
            angles = OFFSET + printed.posor[number - 1] + (shifts or {}).get(number, 0.0)
            steps.append(
                MotionStep(
                    number=number,
                    state=State.LOST if is_lost else State.OK,
                    faults=Fault.OUT_OF_RANGE if is_lost else Fault.NONE,
                    scan_status=(statuses or {}).get(number, 0),
                    angles=missing if is_lost else angles,
                    truth=np.array([0.5, 0.6, 0.7]) + moved,
                    endpoint=missing if is_lost else np.array([-0.8, 0.0, 0.0]) + 1.1 * moved,
                )
            )
        return MotionTest(tuple(steps))

    return make
