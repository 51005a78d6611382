# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Source ``instruments``: what becomes of the channels of a device in a scan, over a real socket."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posor.calibration.design_parts import quantity_entry
from posor.errors import ParameterError
from posor.messages.message_definitions import MessageTypes
from posor.model.scan import DARK_SUBTRACTED, HOME_BUMP, SATURATED
from posor_drivers.instruments.device_reader import DeviceReader
from posor_drivers.sources.instrument_source import InstrumentParameters, InstrumentSource
from posor_lab.device_servers.stream_server import StreamServer
from posor_lab.harness.message_conversion import stamp_ns
from posor_lab.harness.program import wait_until
from posor_msgs.msg import RawScan
from rclpy.serialization import deserialize_message

from ..instruments.stream_rig import stream_rig, write_rig

CURRENTS = tuple(1e-6 * n for n in range(1, 9))
SOUND = (1e-4, *CURRENTS, 3.0, 0.0, 21.5)


def instruments(port: int) -> dict[str, Any]:
    currents = [f"current_{n}" for n in range(len(CURRENTS))]
    units = {"gap": "m", **dict.fromkeys(currents, "A"), "source": "1", "home": "1", "plate": "degC"}
    joint = {
        "gap_voltages": [
            {"channel": "box/gap", "scale": quantity_entry(1e4, "V/m"), "offset": quantity_entry(-0.5, "V")}
        ],
        "diode_currents": [{"channel": f"box/{name}"} for name in currents],
        "lit_sources": [{"channel": "box/source"}, 7],
        "home_mark": {"channel": "box/home"},
        "temperature": {
            "channel": "box/plate",
            "scale": quantity_entry(1, "K/degC"),
            "offset": quantity_entry(273.15, "K"),
        },
    }
    return stream_rig(port, units, joint)


@contextmanager
def opened(folder: Path, port: int, joint: str = "elbow", content: Any = None) -> Iterator[InstrumentSource]:
    file = write_rig(folder, instruments(port) if content is None else content)
    source = InstrumentSource(InstrumentParameters(file=file, joint=joint), MessageTypes())
    try:
        source.open()
        yield source
    finally:
        source.close()


def test_a_scan_whose_stamp_has_no_error_yet_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A device may lose its connection between the reading of its values and that of their error."""
    with StreamServer(lambda _: SOUND) as server, opened(tmp_path, server.port) as source:
        scan_of(source)
        monkeypatch.setattr(DeviceReader, "stamp_error_at", lambda *_: None)
        assert not list(source.read_tick(source.newest_tick(time.time_ns())))
        assert source.statuses()[0].fault.startswith("no scan: no frames of box around the tick")


def scan_of(source: InstrumentSource, accepted: Callable[[Any], bool] = lambda _: True) -> Any:
    """Return the first accepted scan of the newest ticks."""
    found: list[Any] = []

    def accept() -> bool:
        for message in source.read_tick(source.newest_tick(time.time_ns())):
            scan = deserialize_message(message.data, RawScan)
            assert stamp_ns(scan) == message.time_ns
            if accepted(scan):
                found.append(scan)
        return bool(found)

    wait_until(accept, "scan")
    return found[0]


def wait_for_no_scan(source: InstrumentSource, words: str) -> None:
    def left_out() -> bool:
        source.read_tick(source.newest_tick(time.time_ns()))
        return words in source.statuses()[0].fault

    wait_until(left_out, words)


def test_channels_become_the_readings_of_a_scan(tmp_path: Path) -> None:
    with StreamServer(lambda _: SOUND) as server, opened(tmp_path, server.port) as source:
        scan = scan_of(source)
        assert scan.header.frame_id == "receiving"
        np.testing.assert_allclose(scan.gap_voltages, [0.5], rtol=1e-12)
        np.testing.assert_allclose(scan.diode_currents, CURRENTS, rtol=1e-12)
        assert list(scan.lit_sources) == [3, 7]
        assert list(scan.ring_voltages) == []
        assert scan.temperature == pytest.approx(294.65)
        assert np.isnan(scan.supply_voltage)
        assert scan.status == 0
        assert source.statuses()[0].fault == ""


def test_a_device_that_demodulates_and_a_reference_voltage_are_stated_in_each_scan(tmp_path: Path) -> None:
    content = instruments(1)
    reference = {"channel": "box/gap", "scale": quantity_entry(5e4, "V/m")}
    content["joints"]["elbow"] |= {"demodulated": True, "reference_voltage": reference}
    with StreamServer(lambda _: SOUND) as server:
        content["devices"]["box"]["port"] = server.port
        with opened(tmp_path, server.port, content=content) as source:
            scan = scan_of(source)
    assert scan.status == DARK_SUBTRACTED
    assert scan.reference_voltage == pytest.approx(5.0)


def test_flags_and_refusals_follow_the_channels(tmp_path: Path) -> None:
    values: list[Sequence[float]] = [SOUND]
    gap, *currents, lit, _, plate = SOUND
    with StreamServer(lambda _: values[0]) as server, opened(tmp_path, server.port) as source:
        scan_of(source)
        values[0] = (gap, *currents, lit, 1.0, plate)
        assert scan_of(source, lambda scan: scan.status != 0).status == HOME_BUMP
        values[0] = (9.9e37, *currents, lit, 0.0, plate)
        saturated = scan_of(source, lambda scan: scan.status not in {0, HOME_BUMP})
        assert saturated.status == SATURATED
        assert np.isnan(saturated.gap_voltages).all()
        for refused in (3.5, 300.0, -1.0):
            values[0] = (gap, *currents, refused, 0.0, plate)
            wait_for_no_scan(source, f"lit sources [{refused}, 7.0]; expected whole numbers from 0 to 255")
        missing = int(source.statuses()[0].values["scans_missing"])
        values[0] = SOUND
        assert scan_of(source).status == 0
        assert missing > 0


def test_scans_between_two_light_sources_and_without_frames_are_left_out(tmp_path: Path) -> None:
    def switched(time_ns: int) -> Sequence[float]:
        return (*SOUND[:-3], float(time_ns // 1_000_000 % 2), *SOUND[-2:])

    with StreamServer(switched) as server, opened(tmp_path, server.port) as source:
        wait_for_no_scan(source, "no frames of box around the tick, or frames with different light sources")
        wait_until(lambda: not source.statuses()[1].fault, "frames")
        tick = source.newest_tick(time.time_ns())
        assert all(len(source.read_tick(tick - n)) == 0 for n in range(10))


def test_another_joint_is_refused(tmp_path: Path) -> None:
    expected = pytest.raises(ParameterError, match=r"'wrist' is not a joint of .*expected one of elbow")
    with expected, opened(tmp_path, 1, "wrist"):
        pass
