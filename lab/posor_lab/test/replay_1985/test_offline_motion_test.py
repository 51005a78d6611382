"""Motion tests estimated without nodes: the same figures as those of a replay."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from posor_bringup.installed import BAGS, CALIBRATIONS, Bag, CalibrationName
from posor_lab.replay_1985.comparison import compare_with_thesis
from posor_lab.replay_1985.expectations import STEPS
from posor_lab.replay_1985.offline_motion_test import offline_motion_test

if TYPE_CHECKING:
    from posor_lab.replay_1985.printed_results import PrintedColumns


@pytest.mark.parametrize("bag", BAGS)
@pytest.mark.parametrize("calibration", CALIBRATIONS)
def test_every_expectation_of_the_replay_holds(bag: Bag, calibration: CalibrationName, printed: PrintedColumns) -> None:
    test = offline_motion_test(bag, calibration)
    assert len(test.steps) == STEPS[bag]
    assert compare_with_thesis(test, bag, calibration, printed if bag == "ymo" else None).holds


def test_the_endpoint_moves_with_the_beam() -> None:
    test = offline_motion_test("ymo", "section84")
    side = test.endpoint_displacement[:, 1]
    # The lever of the endpoint is 33.4 in, that of the machining centre's line 31.43 in.
    np.testing.assert_allclose(side[1:] / test.truth_displacement[1:, 1], 33.4 / 31.43, rtol=0.25)
    assert np.isnan(offline_motion_test("yzmo", "printed").endpoint_displacement[13]).all()
