# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The ages of scans show a step of the driver's clock that its stamps and numbers hide: in a restart, or in a gap."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from posor.calibration.designs import DesignName, design
from posor.estimation.posor import Posor
from posor.messages.message_stream import RawScanStream
from posor.messages.raw_scan import scan_of
from posor.model.fault import USABLE_STATES, State
from posor.numerics.stamps import NS
from posor_lab.harness.graph import scan_templates
from posor_msgs.msg import JointTransform, RawScan
from posor_ros.message_classes import schema_of_class
from rclpy.serialization import deserialize_message

if TYPE_CHECKING:
    from collections.abc import Callable

RAW_SCAN = schema_of_class(RawScan)


class RestartedDriver:
    """A joint at rest whose driver restarts after 100 scans and is away for three intervals; ages of scans in s."""

    PERIOD_S, AGE_S, AWAY = 0.02, 0.003, 3

    def __init__(self, stack: DesignName = "triad_diodes", late_s: float = 0.0) -> None:
        self.posor = Posor(design(stack, motion=True))
        self._scans = iter(scan_templates(self.posor, np.full(600, 0.05), 7))
        self._stream = self._open()
        self._now_ns, self._number, self.step_s = 10**18, 0, 0.0
        for _ in range(100):
            self.receive(late_s)
        self._now_ns += round(self.AWAY * self.PERIOD_S * NS)

    def _open(self) -> RawScanStream:
        stream = RawScanStream(self.posor, next(self._scans).at(NS, 1))
        stream.accept_ages(-0.5 * NS, 1.0 * NS)
        return stream

    def receive(self, late_s: float = 0.0, *, live: bool = True) -> JointTransform:
        """Return the transform of the next scan, whose stamp is ``step_s`` ahead."""
        self._now_ns += round(self.PERIOD_S * NS)
        self._number += 1
        return self._estimate(late_s, live=live)

    def receive_again(self) -> JointTransform:
        """Return the transform of a scan with stamp and number of the one before, and other readings."""
        self._now_ns += round(self.PERIOD_S * NS)
        self.step_s -= self.PERIOD_S
        return self._estimate()

    def _estimate(self, late_s: float = 0.0, *, live: bool = True) -> JointTransform:
        data = next(self._scans).at(self._now_ns + round(self.step_s * NS), self._number)
        arrival_ns = self._now_ns + round((self.AGE_S + late_s) * NS)
        found = self._stream.estimate_message(data, *([arrival_ns] if live else []))
        assert found is not None
        return deserialize_message(found, JointTransform)

    def reload(self) -> None:
        """Continue with another POSOR of the same calibration, as ``~/reload`` does."""
        other = Posor(self.posor.calibration)
        other.continue_from(self.posor, scan_of(self._stream.last_scan().data))
        self.posor = other
        self._stream = self._open()

    def pause(self, seconds: float, step_s: float) -> None:
        """Send nothing for a while in which the clock that numbers and stamps the scans is set; whole intervals."""
        self._now_ns += round(seconds * NS)
        self.step_s += step_s
        self._number += round((seconds + step_s) / self.PERIOD_S)

    def receive_missed(self) -> JointTransform:
        """Return the transform of a scan of the old clock, after those that were missed."""
        self._number += self.AWAY
        return self.receive()

    def set_forward(self, late_s: float = 0.0) -> JointTransform:
        """Return the transform of the next scan; the clock that numbers and stamps it was set forward by intervals."""
        self.step_s += self.AWAY * self.PERIOD_S
        self._number += self.AWAY
        return self.receive(late_s)

    def begin_numbers(self) -> None:
        """Number the scans from 0."""
        self._number = 0

    def restart(self, late_s: float = 0.0, *, live: bool = True) -> JointTransform:
        """Return the first transform with a pose after the restart."""
        self.begin_numbers()
        found = (self.receive(late_s, live=live) for _ in range(100))
        return next(each for each in found if each.state in USABLE_STATES)


@pytest.mark.parametrize("step_s", [-0.04, 0.04])
def test_ages_of_scans_show_a_step_of_the_stamps_that_a_restart_hides(step_s: float) -> None:
    driver = RestartedDriver()
    driver.step_s = step_s
    assert np.all(driver.restart().stamp_shift)
    assert driver.posor.tracker["clocks"]["step"] == pytest.approx(abs(step_s), rel=1e-6)
    assert driver.posor.acknowledge()
    for _ in range(400):
        assert not np.any(driver.receive().stamp_shift)


def test_a_restart_without_a_step_of_the_stamps_shifts_no_pose() -> None:
    assert not np.any(RestartedDriver().restart().stamp_shift)
    driver = RestartedDriver()
    driver.step_s = -0.04
    assert not np.any(driver.restart(live=False).stamp_shift)  # a recording has no ages


def test_a_late_start_of_a_restarted_driver_is_a_step_only_until_a_scan_arrives_in_time() -> None:
    driver = RestartedDriver()
    assert np.all(driver.restart(0.03).stamp_shift)
    assert not np.any(driver.receive().stamp_shift)
    assert not driver.posor.has_latch


def test_a_step_that_only_the_ages_show_gives_up_a_count() -> None:
    for step_s, is_usable in ((0.0, True), (-0.04, False)):
        driver = RestartedDriver("triad_bumpy_ring")
        driver.posor.confirm_theta(0.05, 1e-3)
        assert driver.receive_missed().state == State.OK
        driver.step_s = step_s
        driver.begin_numbers()
        states = [driver.receive().state for _ in range(10)]
        assert states[:2] == [State.LOST] * 2
        assert (states[-1] in USABLE_STATES) == is_usable


def test_a_clock_that_is_set_forward_shifts_the_poses_until_an_acknowledgement() -> None:
    driver = RestartedDriver()
    missed = [driver.receive_missed(), *(driver.receive() for _ in range(300))]
    assert not any(np.any(each.stamp_shift) for each in missed)
    found = [driver.set_forward(), *(driver.receive() for _ in range(20))]
    assert all(each.state in USABLE_STATES for each in found)
    assert all(np.all(each.stamp_shift) for each in found)
    assert driver.posor.tracker["clocks"]["step"] == pytest.approx(driver.step_s, rel=1e-3)
    assert driver.posor.acknowledge()
    assert not np.any(driver.receive().stamp_shift)


def test_scans_of_a_full_queue_after_the_start_are_no_step() -> None:
    assert not np.any(RestartedDriver(late_s=0.1).receive_missed().stamp_shift)


def settled() -> RestartedDriver:
    """Return a driver of one clock, whose scans have arrived for so long that their least age is known."""
    driver = RestartedDriver()
    for found in (driver.receive_missed(), *(driver.receive() for _ in range(300))):
        assert not np.any(found.stamp_shift)
    return driver


def young() -> RestartedDriver:
    """Return a driver with fewer scans than show its least age."""
    driver = RestartedDriver()
    assert not np.any(driver.receive_missed().stamp_shift)
    return driver


def stated_step(driver: RestartedDriver) -> float:
    return float(driver.posor.tracker["clocks"]["step"])


def test_a_late_first_scan_hides_a_step_forward_only_until_a_scan_arrives_in_time() -> None:
    driver = settled()
    driver.set_forward(late_s=0.025)
    assert stated_step(driver) == pytest.approx(driver.step_s - 0.025, abs=1e-3)
    driver.receive()
    assert stated_step(driver) == pytest.approx(driver.step_s, abs=1e-3)


@pytest.mark.parametrize("step_s", [0.0, -0.06, 0.06])
def test_a_step_while_the_driver_is_away_is_found_in_both_directions(step_s: float) -> None:
    driver = settled()
    driver.pause(0.4, step_s)
    assert driver.receive().state in USABLE_STATES
    assert stated_step(driver) == pytest.approx(abs(step_s), abs=1e-3)


def test_one_number_with_other_readings_is_a_clock_that_was_set_back() -> None:
    driver = settled()
    assert driver.receive_again().state == State.LOST
    assert np.all(driver.receive().stamp_shift)
    assert stated_step(driver) >= -driver.step_s


def test_a_reload_leaves_no_false_age_to_compare_a_restart_with(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RestartedDriver, "AGE_S", 0.04)
    driver = settled()
    driver.reload()
    for _ in range(20):
        driver.receive()
    driver.restart()
    assert stated_step(driver) == 0.0


def test_a_step_forward_is_no_time_in_which_the_joint_may_have_moved() -> None:
    driver = settled()
    before = float(driver.posor.tracker["time"])
    driver.set_forward()
    assert driver.posor.tracker["time"] - before == pytest.approx(driver.PERIOD_S, abs=1e-3)


def test_clocks_that_drift_apart_while_the_driver_is_away_are_no_step() -> None:
    driver = settled()
    driver.pause(300.0, 0.0)
    driver.step_s = 50e-6 * 300.0
    assert driver.receive().state in USABLE_STATES
    assert stated_step(driver) == 0.0


@pytest.mark.parametrize("start", [settled, young])
@pytest.mark.parametrize("seconds", [0.1, 0.5, 0.9])
def test_a_host_that_was_paused_with_its_clock_shifts_the_poses(
    seconds: float, start: Callable[[], RestartedDriver]
) -> None:
    driver = start()
    before = float(driver.posor.tracker["time"])
    driver.pause(seconds, -seconds)  # no number is missing, and no stamp
    assert driver.receive().state in USABLE_STATES
    assert stated_step(driver) == pytest.approx(seconds, abs=1e-3)
    assert driver.posor.tracker["time"] - before == pytest.approx(seconds + driver.PERIOD_S, abs=1e-3)
    assert np.all(driver.receive().stamp_shift)


def test_late_scans_after_the_start_and_behind_a_gap_are_no_step_once_scans_arrive_in_time() -> None:
    """A loaded host: the least age of few scans is not known well."""
    driver = RestartedDriver(late_s=0.05)
    driver.receive_missed()
    driver.pause(0.4, 0.0)
    driver.receive(0.1)
    assert stated_step(driver) > 0.0
    for _ in range(300):
        driver.receive()
    assert stated_step(driver) == 0.0
    assert not driver.posor.has_latch


@pytest.mark.parametrize(("seconds", "is_usable"), [(0.0, True), (0.5, False), (0.9, False)])
def test_a_ring_that_may_have_turned_while_its_host_was_paused_is_not_counted(
    *, seconds: float, is_usable: bool
) -> None:
    driver = RestartedDriver("triad_bumpy_ring")
    driver.posor.confirm_theta(0.05, 1e-3)
    assert driver.receive_missed().state == State.OK
    driver.pause(seconds, -seconds)
    assert (driver.receive().state in USABLE_STATES) == is_usable


@pytest.mark.parametrize("start", [settled, young])
def test_a_node_that_was_stopped_finds_no_step_once_its_scans_arrive_in_time(
    start: Callable[[], RestartedDriver],
) -> None:
    driver = start()
    for late in range(25, -1, -1):  # the scans of half a second, one after the other
        driver.receive(late * driver.PERIOD_S)
    assert stated_step(driver) == 0.0
    assert driver.receive().state == State.OK


@pytest.mark.parametrize("start", [settled, young])
@pytest.mark.parametrize("lost", [3, 20])
def test_the_time_of_scans_that_a_stopped_node_has_lost_counts(lost: int, start: Callable[[], RestartedDriver]) -> None:
    driver = start()
    for late_s in (0.5, 0.48):  # the scans that its queue has kept
        driver.receive(late_s)
    before = float(driver.posor.tracker["time"])
    driver.pause(lost * driver.PERIOD_S, 0.0)
    assert driver.receive().state == State.OK
    assert driver.posor.tracker["time"] - before == pytest.approx((lost + 1) * driver.PERIOD_S, abs=1e-3)
    assert stated_step(driver) == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_a_step_that_ages_no_longer_show_is_zero_to_the_last_bit(seed: int) -> None:
    driver = young()
    lateness_s = np.random.default_rng(seed).uniform(0.01, 0.4, 10)
    for late_s in (0.4, *sorted(lateness_s.tolist(), reverse=True)):
        driver.receive(late_s)
    assert stated_step(driver) > 0.0
    driver.receive()
    assert not driver.posor.has_latch
