# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Release of a latched joint whose ambient light is removed: what its last scans must show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from posor.errors import ParameterError
from posor.estimation.posor import Posor
from posor.messages.message_definitions import MessageTypes
from posor.messages.message_stream import RawScanStream
from posor.model.fault import Fault, State
from posor.model.scan import NO_SOURCE, Scan
from posor.ros_names import RAW_SCAN
from posor.uncertainty.budget_poses import scan_at
from posor_bringup.arms import load_checked_arm
from posor_drivers.message_builder import raw_scan, scan_fields
from posor_estimator.fault_release import EncoderReading, check_plausible

PERIOD_NS, THETA = 10_000_000, 0.3


class Joint:
    """The POSOR of an elbow, and its scans as messages."""

    def __init__(self) -> None:
        arm = load_checked_arm("six_axis")
        self.posor = Posor(arm.calibration("elbow"))
        self._lit = scan_at(self.posor, arm.chain().nominal_joint("elbow", THETA))
        self._frame = arm.calibration("elbow").frames.parent
        self._stream: RawScanStream | None = None
        self._random = np.random.default_rng(1985)

    def scan(self, number: int, *, dark: bool = False) -> Scan:
        """Return a scan of the joint at rest."""
        gaps, currents = self._lit.gap_voltages, self._lit.diode_currents
        scan = replace(
            self._lit,
            number=number,
            stamp_ns=number * PERIOD_NS,
            gap_voltages=gaps + self._random.normal(scale=1e-3, size=gaps.shape),
            diode_currents=currents + self._random.normal(scale=1e-10, size=currents.shape),
        )
        if not dark:
            return scan
        sources = (NO_SOURCE,) * len(scan.lit_sources)
        return replace(scan, lit_sources=sources, diode_currents=scan.diode_currents - currents)

    def receive(self, scan: Scan) -> RawScanStream:
        """Estimate a scan as posor_node does; return the stream."""
        types = MessageTypes()
        message = raw_scan(types, scan.stamp_ns, self._frame, **(scan_fields(scan) | {"scan": scan.number}))
        data = types.serialize(message, RAW_SCAN)
        self._stream = self._stream or RawScanStream(self.posor, data)
        assert self._stream.estimate_message(data) is not None
        return self._stream


@pytest.fixture
def joint() -> Joint:
    return Joint()


@pytest.mark.parametrize("dark_after", [0, 1])
def test_the_last_lit_scan_is_plausible_by_the_ambient_light_that_is_known(joint: Joint, dark_after: int) -> None:
    joint.receive(joint.scan(1, dark=True))
    stream = joint.receive(joint.scan(2))
    for _ in range(dark_after):
        stream = joint.receive(joint.scan(3, dark=True))
    lit = stream.last_lit_scan()
    assert lit is not None
    assert lit.number == 2
    before = joint.posor.tracker.tobytes()
    check_plausible(joint.posor, lit, EncoderReading(THETA, 1e-3, lit.stamp_ns))
    assert joint.posor.tracker.tobytes() == before
    assert joint.posor.estimate(joint.scan(4)).state == State.OK


def test_a_scan_that_contradicts_itself_or_the_encoder_is_not_plausible(joint: Joint) -> None:
    joint.receive(joint.scan(1, dark=True))
    lit = joint.receive(joint.scan(2)).last_lit_scan()
    assert lit is not None
    wrong = replace(lit, gap_voltages=lit.gap_voltages + np.array([1.0, 0.0, 0.0, 0.0]))
    for scan, theta in ((wrong, THETA), (lit, THETA + 0.1)):
        with pytest.raises(ParameterError, match="the last scan is not plausible"):
            check_plausible(joint.posor, scan, EncoderReading(theta, 1e-3, lit.stamp_ns))


def test_light_that_dark_scans_hold_does_not_prevent_its_release(joint: Joint) -> None:
    joint.receive(joint.scan(1, dark=True))
    lit = joint.receive(replace(joint.scan(2), status=0)).last_lit_scan()
    joint.posor.tracker["ambient"]["light_left"] = 1  # as motion between dark scans shows
    assert joint.posor.estimate(replace(joint.scan(3), status=0)).faults == Fault.AMBIENT
    check_plausible(joint.posor, lit, None)
    assert joint.posor.acknowledge()
    assert joint.posor.estimate(joint.scan(4, dark=True)).state == State.DEGRADED
    assert joint.posor.estimate(replace(joint.scan(5), status=0)).state == State.OK


def test_two_dark_scans_in_a_row_release_nothing(joint: Joint) -> None:
    for number in (1, 2):
        stream = joint.receive(joint.scan(number, dark=True))
    assert stream.last_lit_scan() is None
    with pytest.raises(ParameterError, match="no lit scan has arrived"):
        check_plausible(joint.posor, None, None)
