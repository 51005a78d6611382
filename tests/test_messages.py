# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Messages of this workspace pass DDS unchanged."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from posor_lab.harness.graph import Graph
from posor_lab.harness.message_conversion import message_content
from posor_msgs.msg import JointTransform, RawScan


def raw_scan() -> Any:
    scan = RawScan(scan=2**63 + 1, samples=2500, status=RawScan.STATUS_SIMULATED | RawScan.STATUS_DARK_SUBTRACTED)
    scan.header.stamp.sec, scan.header.stamp.nanosec = 478_000_000, 999_999_999
    scan.header.frame_id = "receiving_plate"
    scan.gap_voltages = [-1.25, 0.1 + 0.2, math.nan]
    scan.diode_currents = [1e-6 * k for k in range(16)]
    scan.lit_sources = [3, RawScan.NO_SOURCE]
    scan.supply_voltage = math.nan
    scan.temperature = 293.15
    return scan


def joint_transform() -> Any:
    transform = JointTransform(scan=7, child_frame_id="target_plate", state=JointTransform.STATE_DEGRADED)
    transform.covariance_random = [1e-12 * k for k in range(36)]
    transform.covariance_systematic = [-1e-12 * k for k in range(36)]
    transform.native = [1e-6, -2e-6, 3e-3, math.nan, -0.0, 7.5]
    transform.faults = JointTransform.FAULT_DARK_DIODE | JointTransform.FAULT_COUNT
    return transform


@pytest.mark.parametrize("make", [raw_scan, joint_transform])
@pytest.mark.usefixtures("ros_domain")
def test_a_message_passes_dds_unchanged(make: Callable[[], Any]) -> None:
    sent = make()
    with Graph() as sender, Graph() as receiver:
        received = receiver.collect(type(sent), "message")
        publisher = sender.publisher(type(sent), "message")
        publisher.publish(sent)
        receiver.wait_until(lambda: bool(received), "the message")
    assert message_content(received[0]) == message_content(sent)
