"""One scan at a time in room made once: the same bits as many at once, whatever the scan."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
import pytest
from posor_estimator.accuracy.poses import STACKS, TICK_NS
from posor_estimator.core.designs import design
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.forward import scans_at
from posor_estimator.core.native import rotation_from_native
from posor_estimator.core.posor import Posor
from posor_estimator.core.scan import Scans

if TYPE_CHECKING:
    from posor_estimator.core.designs import DesignName
    from posor_estimator.core.lane import Lane
    from posor_estimator.core.types import FloatArray

COUNT = 40


def moving(posor: Posor) -> Scans:
    """Noisy scans of a target that turns, one of them unfit, one contradictory."""
    rotations = np.array([rotation_from_native(1e-4, -2e-4, 0.05 + 2e-3 * n) for n in range(COUNT)])
    translations = np.tile([2e-5, 1e-5, 0.7e-3], (COUNT, 1))
    stamps = np.arange(1, COUNT + 1, dtype=np.int64) * TICK_NS
    scans = scans_at(posor.stack, rotations, translations, stamps, noise=np.random.default_rng(4))
    scans.at_home[2] = 1
    scans.gap_voltages[17, 1] = np.nan
    for spoiled in (scans.ring_voltages, scans.diode_currents[:, :, 0]):
        spoiled[25:26, 0:1] *= 1.05
    return scans


def results(lane: Lane) -> list[FloatArray]:
    return [lane.pose, lane.native, lane.random, lane.systematic]


@pytest.mark.parametrize("stack", STACKS)
def test_a_lane_gives_the_bits_of_many_at_once_in_the_same_arrays(stack: DesignName) -> None:
    posor = Posor(design(stack, motion=True))
    scans = moving(posor)
    together = posor.locate_all(scans)
    assert {State.OK, State.LOST} <= {State(int(state)) for state in together.states}
    posor.reset()
    lane = posor.lane()
    arrays = results(lane)
    for n in range(COUNT):
        assert lane.takes(scans[n])
        lane.fill(scans[n])
        assert lane.run() == lane.state == together.states[n]
        assert lane.faults == together.faults[n]
        assert (lane.reason() == "") == (lane.faults == 0)
        for found, all_found in zip(
            results(lane),
            (together.poses, together.natives, together.covariances_random, together.covariances_systematic),
            strict=True,
        ):
            assert found.tobytes() == all_found[n].tobytes()
            assert np.isnan(found).all() if lane.state == State.LOST else np.isfinite(found).all()
        if lane.state != State.LOST:
            pose = pin.SE3(together.rotations[n], together.translations[n])
            assert lane.pose.tobytes() == np.asarray(pin.SE3ToXYZQUAT(pose)).tobytes()
            assert lane.residual == together.residuals[n]
    assert all(one is other for one, other in zip(results(lane), arrays, strict=True))


def test_a_lane_of_another_shape_says_what_is_wrong_and_harms_nothing() -> None:
    posor = Posor(design("triad_diodes"))
    scans = moving(posor)
    lane = posor.lane()
    lane.fill(scans[0])
    assert lane.run() == State.OK
    short = replace(scans[1], gap_voltages=scans[1].gap_voltages[:2])
    assert not lane.takes(short)
    other = posor.lane(short)
    assert other.run() == State.LOST
    assert other.faults == Fault.BAD_READING
    assert other.redundancy == 0
    assert "2 gap probe voltages; expected 3" in other.reason()
    lane.fill(scans[1])
    assert lane.run() == State.OK
    assert (lane.reason(), lane.redundancy) == ("", 1)


def test_an_estimate_stays_when_the_next_scan_comes() -> None:
    posor = Posor(design("triad_diodes"))
    scans = moving(posor)
    first = posor.locate(scans[0])
    kept = first.covariance_random.copy(), first.covariance_systematic.copy()
    posor.locate(scans[1])
    np.testing.assert_array_equal(first.covariance_random, kept[0])
    np.testing.assert_array_equal(first.covariance_systematic, kept[1])


def test_scans_may_be_read_only_and_strided() -> None:
    posor = Posor(design("triad_diodes"))
    scans = moving(posor)
    expected = posor.locate_all(scans)
    posor.reset()
    strided = Scans(**{f.name: np.repeat(getattr(scans, f.name), 2, axis=0)[::2] for f in fields(Scans)})
    for f in fields(Scans):
        getattr(strided, f.name).flags.writeable = False
    assert posor.locate_all(strided).poses.tobytes() == expected.poses.tobytes()
