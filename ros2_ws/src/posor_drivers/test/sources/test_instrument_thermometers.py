# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Channels of instruments as thermometers of beams and plates: the topics that the chain reads."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import pytest
from posor.calibration.design_parts import quantity_entry
from posor.errors import CalibrationError
from posor.messages.message_definitions import MessageTypes, installed_schema
from posor.numerics.stamps import NS
from posor.ros_names import TEMPERATURE
from posor_drivers.sources.instrument_source import InstrumentParameters, InstrumentSource
from posor_lab.device_servers.stream_server import StreamServer
from posor_lab.harness.program import wait_until

from ..instruments.stream_rig import stream_rig, write_rig

LOGGER_HZ, READS = 4.0, 400
CELSIUS_SCALE = {"scale": quantity_entry(1.0, "K/degC"), "offset": quantity_entry(273.15, "K")}
UNITS = {"gap": "V", "skin": "degC", "plate": "degC", "other": "V", "wrist": "degC"}


def instruments(port: int) -> dict[str, Any]:
    joint = {"gap_voltages": [{"channel": "box/gap"}], "temperature": {"channel": "box/plate", **CELSIUS_SCALE}}
    content = stream_rig(port, UNITS, joint)
    other = {"gap_voltages": [{"channel": "box/other"}], "temperature": {"channel": "box/wrist", **CELSIUS_SCALE}}
    content["joints"]["wrist"] = {"frame_id": "other_plate", **other}
    content["thermometers"] = {
        name: {"joint": joint, "channel": f"box/{channel}", **CELSIUS_SCALE}
        for name, joint, channel in (("arm_skin", "elbow", "skin"), ("elbow_plate", "elbow", "plate"))
    }
    return content


def with_slow_skin(content: dict[str, Any], port: int) -> dict[str, Any]:
    """Return the file with the skin on a logger of its own, whose frames come too late to interpolate at ticks."""
    slow = stream_rig(port, {"skin": "degC"}, {}, rate_hz=LOGGER_HZ)["devices"]["box"]
    content["devices"]["logger"] = slow
    content["thermometers"]["arm_skin"]["channel"] = "logger/skin"
    return content


def test_the_driver_of_the_joint_publishes_its_thermometers_at_whole_seconds(tmp_path: Path) -> None:
    schema, values = installed_schema(TEMPERATURE), [1.0, 0.0, math.nan, 0.0, 22.0]
    with StreamServer(lambda _: values) as server, StreamServer(lambda _: [21.5], rate=LOGGER_HZ) as logger:
        file = write_rig(tmp_path, with_slow_skin(instruments(server.port), logger.port))
        other = InstrumentSource(InstrumentParameters(file=file, joint="wrist"), MessageTypes())
        assert [topic.name for topic in other.open()] == ["raw"]
        other.close()
        source = InstrumentSource(
            InstrumentParameters(file=file, joint="elbow", temperature_topic="/rig/temperature"), MessageTypes()
        )
        names = ["/rig/temperature/arm_skin", "/rig/temperature/elbow_plate"]
        assert [topic.name for topic in source.open()] == ["raw", *names]
        ticks: dict[int, list[Any]] = {}

        def second_has_passed() -> bool:
            tick = source.newest_tick(time.time_ns())
            ticks[tick] = [each for each in source.read_tick(tick) if each.topic != "raw"]
            return len(ticks[tick]) == len(names)

        wait_until(second_has_passed, "temperatures", lambda: time.sleep(0.002))
        tick, messages = max(ticks.items())
        assert {each % source.rate for each, found in ticks.items() if found} == {0}
        assert [each.fault for each in source.statuses()[1:3]] == ["", "box/plate is invalid"]
        begin_s, read = time.monotonic(), []

        def nothing_new() -> bool:
            read.append(names[0] in {each.topic for each in source.read_tick(tick)})
            return len(read) > READS and not read[-1]

        wait_until(nothing_new, "a read without a new frame", lambda: None)
        assert sum(read) <= LOGGER_HZ * (time.monotonic() - begin_s) + 2.0  # each frame is published once
        assert source.statuses()[1].fault == "no reading: no new frame of logger"
        found = {each.topic: schema.values(each.data) for each in messages}
        assert list(found) == names
        skin, plate = found.values()
        assert (skin["header.frame_id"], skin["header.stamp.sec"]) == ("arm_skin", messages[0].time_ns // NS)
        assert skin["temperature"] == pytest.approx(21.5)
        assert math.isnan(plate["temperature"])  # the chain names it
        source.close()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"joint": "hip"}, "key thermometers.arm_skin.joint: joint 'hip'; expected one of elbow, wrist"),
        ({"scale": None, "offset": None}, "channel 'box/skin' is in degC; expected a scale in K/degC"),
        ({"channel": "box/nose"}, "channel 'box/nose'; expected one of box/gap"),
        ({"channel": "box/plate"}, "channel 'box/plate' is used twice, also by thermometer 'arm_skin'"),
        ({"offset": quantity_entry(0.0, "degC")}, "offset in degC; expected one number in K"),
        ({"channel": "box/wrist"}, "channel 'box/wrist' is the temperature of joint 'wrist'; expected joint: wrist"),
        (
            {"joint": "wrist", "channel": "box/wrist", "offset": quantity_entry(273.0, "K")},
            "another scale or offset; expected scale and offset of joints.wrist.temperature",
        ),
    ],
)
def test_an_invalid_thermometer_is_refused(tmp_path: Path, changes: dict[str, Any], sentence: str) -> None:
    content = instruments(1)
    content["thermometers"]["arm_skin"] |= changes
    with pytest.raises(CalibrationError) as caught:
        InstrumentSource(InstrumentParameters(file=write_rig(tmp_path, content), joint="elbow"), MessageTypes()).open()
    assert sentence in str(caught.value)


def test_a_name_that_ros_refuses_is_refused(tmp_path: Path) -> None:
    content = instruments(1)
    content["thermometers"]["arm/skin"] = content["thermometers"].pop("arm_skin")
    with pytest.raises(CalibrationError) as caught:
        InstrumentSource(InstrumentParameters(file=write_rig(tmp_path, content), joint="elbow"), MessageTypes()).open()
    assert "name 'arm/skin'" in str(caught.value)
