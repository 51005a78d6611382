from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped
from posor_drivers.sources.base import Topic
from posor_drivers.sources.table import (
    STATUS_DIODES_ESTIMATED,
    STATUS_PROBES_ESTIMATED,
    TableParameters,
    TableSource,
    contact_currents,
)
from posor_estimator.ros.message_types import MessageTypes
from posor_msgs.msg import RawScan
from rclpy.serialization import deserialize_message

from .tables import write_table

if TYPE_CHECKING:
    from pathlib import Path


def messages(path: Path, **parameters: Any) -> tuple[list[RawScan], list[PointStamped]]:
    source = TableSource(TableParameters(path=str(write_table(path / "t.csv")), **parameters), MessageTypes())
    topics = source.open()
    assert topics[0] == Topic("raw", "posor_msgs/msg/RawScan")
    out: dict[str, list[Any]] = {topic.name: [] for topic in topics}
    for message in source.messages():
        content = deserialize_message(message.data, RawScan if message.topic == "raw" else PointStamped)
        stamp = content.header.stamp
        assert message.time_ns == stamp.sec * 1_000_000_000 + stamp.nanosec
        out[message.topic].append(content)
    scans, truths = out.values()
    return scans, truths


def test_constants_are_those_of_the_message() -> None:
    assert STATUS_PROBES_ESTIMATED == RawScan.STATUS_PROBES_ESTIMATED
    assert STATUS_DIODES_ESTIMATED == RawScan.STATUS_DIODES_ESTIMATED


def test_scan_holds_what_the_row_says(tmp_path: Path) -> None:
    scans, _ = messages(tmp_path)
    assert [scan.scan for scan in scans] == [1, 2, 3, 5]
    assert [scan.status for scan in scans] == [0, STATUS_PROBES_ESTIMATED, STATUS_DIODES_ESTIMATED, 0]
    scan = scans[0]
    assert list(scan.gap_voltages) == [0.25, 0.5, 0.75]
    assert list(scan.lit_sources) == [0, 1]
    assert scan.samples == 1
    assert scan.header.frame_id == "posor_receiving"
    assert math.isnan(scan.supply_voltage)
    assert math.isnan(scan.temperature)
    assert [len(scan.ring_voltages), len(scan.gap_voltage_spreads), len(scan.diode_current_spreads)] == [0, 0, 0]


def test_currents_have_the_recorded_ratios_and_the_stated_total(tmp_path: Path) -> None:
    scans, _ = messages(tmp_path, nominal_total=1e-4)
    currents = np.array(scans[0].diode_currents).reshape(2, 4)
    np.testing.assert_allclose(currents.sum(axis=1), 1e-4, rtol=1e-15)
    a, b, c, d = currents.T
    np.testing.assert_allclose(a + c, 0.5e-4, rtol=1e-15)
    np.testing.assert_allclose((a - c) / (a + c), [0.5, -0.5], rtol=1e-15)
    np.testing.assert_allclose((b - d) / (b + d), [0.125, 0.0625], rtol=1e-15)


def test_ratios_survive_to_the_last_digits() -> None:
    ratios = np.random.default_rng(1985).uniform(-1.0, 1.0, 2000)
    a, b, c, d = contact_currents(list(ratios), 200e-6).reshape(-1, 4).T
    recovered = np.stack([(a - c) / (a + c), (b - d) / (b + d)], axis=1).ravel()
    np.testing.assert_allclose(recovered, ratios, atol=5e-16, rtol=0.0)


def test_stamps_are_those_of_the_parameters_and_scan_and_truth_share_them(tmp_path: Path) -> None:
    scans, truths = messages(tmp_path, start=1000.25, period=0.5)
    stamps = [(scan.header.stamp.sec, scan.header.stamp.nanosec) for scan in scans]
    assert stamps == [(1000, 250_000_000), (1000, 750_000_000), (1001, 250_000_000), (1001, 750_000_000)]
    assert [truth.header.stamp for truth in truths] == [scan.header.stamp for scan in scans]


def test_truth_is_in_metres_with_nan_where_nothing_was_recorded(tmp_path: Path) -> None:
    _, truths = messages(tmp_path, truth_topic="/elsewhere")
    assert truths[2].point.x == pytest.approx(0.0508, rel=1e-15)
    assert truths[2].point.y == pytest.approx(-0.0508, rel=1e-15)
    assert truths[2].point.z == pytest.approx(0.0254, rel=1e-15)
    assert math.isnan(truths[1].point.x)
    assert {truth.header.frame_id for truth in truths} == {"machining_centre"}


def test_each_pass_gives_the_same_bytes(tmp_path: Path) -> None:
    source = TableSource(TableParameters(path=str(write_table(tmp_path / "t.csv"))), MessageTypes())
    source.open()
    assert list(source.messages()) == list(source.messages())
