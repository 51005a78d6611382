# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""One scan at a time: the same bits as many at once, whatever the scan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from posor.calibration.designs import DesignName, design
from posor.errors import ShapeError
from posor.estimation.posor import Posor
from posor.model.fault import Fault, State
from posor.model.scan import Scans
from posor_lab.harness.random_poses import STACKS, turning_scans

COUNT = 40


def moving(posor: Posor) -> Scans:
    """Noisy scans of a target that turns, one of them unfit, one contradictory."""
    scans = turning_scans(posor, 0.05 + 2e-3 * np.arange(float(COUNT)), 4, home=[2])
    scans.gap_voltages[17, 1] = np.nan
    for spoiled in (scans.ring_voltages, scans.diode_currents[:, :, 0]):
        spoiled[25:26, 0:1] *= 1.05
    return scans


@pytest.mark.parametrize("stack", STACKS)
def test_one_scan_gives_the_bits_of_many_at_once(stack: DesignName) -> None:
    posor = Posor(design(stack, motion=True))
    scans = moving(posor)
    together = posor.estimate_all(scans)
    assert {State.OK, State.LOST} <= {State(int(state)) for state in together.states}
    posor.reset()
    for n in range(COUNT):
        alone = posor.estimate(scans[n])
        assert (alone.state, alone.faults) == (together.states[n], together.faults[n])
        assert (alone.reason == "") == (alone.faults == 0)
        for found, expected in (
            (alone.covariance_random, together.covariances_random[n]),
            (alone.covariance_systematic, together.covariances_systematic[n]),
        ):
            assert found.tobytes() == expected.tobytes()
            assert np.isnan(found).all() if alone.state == State.LOST else np.isfinite(found).all()
        if alone.T_R_T is not None:
            assert alone.T_R_T.rotation.tobytes() == together.rotations[n].tobytes()
            assert together.poses[n].tobytes() == np.asarray(pin.SE3ToXYZQUAT(alone.T_R_T)).tobytes()
            assert (alone.residual, alone.redundancy) == (together.residuals[n], posor.redundancy)


def test_a_scan_with_a_missing_reading_is_lost_with_a_reason_and_harms_nothing() -> None:
    posor = Posor(design("triad_diodes"))
    scans = moving(posor)
    assert posor.estimate(scans[0]).state is State.OK
    lost = posor.estimate(replace(scans[1], gap_voltages=scans[1].gap_voltages[:2]))
    assert (lost.state, lost.faults, lost.redundancy) == (State.LOST, Fault.BAD_READING, 0)
    assert "2 gap probe voltages; expected 3" in lost.reason
    found = posor.estimate(scans[1])
    assert (found.state, found.reason, found.redundancy) == (State.OK, "", 1)


def test_a_wrong_shape_names_field_received_and_expected_shape() -> None:
    posor = Posor(design("triad_diodes"))
    scans = moving(posor)
    with pytest.raises(ShapeError, match=r"gap_voltages has shape \(9,\); expected at most 8 readings"):
        posor.estimate(replace(scans[0], gap_voltages=np.zeros(9)))
    with pytest.raises(ShapeError, match=r"temperatures has shape \(3,\); expected \(40,\)"):
        scans.with_fields({"temperatures": np.zeros(3)})
    with pytest.raises(ShapeError, match=r"ring_voltages has shape \(40, 9\); expected \(40, ...\) with at most 8"):
        scans.with_fields({"ring_voltages": np.zeros((COUNT, 9))})


def test_an_estimate_stays_when_the_next_scan_comes() -> None:
    posor = Posor(design("triad_diodes"))
    scans = moving(posor)
    first = posor.estimate(scans[0])
    kept = first.covariance_random.copy(), first.covariance_systematic.copy()
    posor.estimate(scans[1])
    np.testing.assert_array_equal(first.covariance_random, kept[0])
    np.testing.assert_array_equal(first.covariance_systematic, kept[1])


def test_scans_may_be_read_only_and_strided() -> None:
    posor = Posor(design("triad_diodes"))
    scans = moving(posor)
    expected = posor.estimate_all(scans)
    posor.reset()
    strided = Scans(np.repeat(scans._records, 2)[::2])
    strided._records.flags.writeable = False
    assert posor.estimate_all(strided).poses.tobytes() == expected.poses.tobytes()
