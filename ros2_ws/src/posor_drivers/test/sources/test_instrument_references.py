# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""References of a calibration over devices: an interferometer with a weather station, and an autocollimator."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posor.bags.bag_writer import BagWriter
from posor.bags.calibration_recording import Reference, load_recording
from posor.calibration.design_parts import quantity_entry
from posor.errors import CalibrationError, TrackError
from posor.messages.message_definitions import MessageTypes
from posor.ros_names import RAW_SCAN, REFERENCE_READING
from posor.uncertainty.air_index import Air
from posor_drivers.sources.instrument_source import InstrumentParameters, InstrumentSource
from posor_lab.device_servers.stream_server import StreamServer
from posor_lab.harness.message_conversion import stamp_ns
from posor_lab.harness.program import wait_until
from posor_msgs.msg import RawScan, ReferenceReading
from rclpy.serialization import deserialize_message, serialize_message

from ..instruments.stream_rig import stream_rig, write_rig

UNITS = {"gap": "V", "distance": "mm", "angle": "arcsec", "air": "degC"}
SOUND = (0.5, 250.0, 3.0, 21.0)
ARCSEC = np.pi / 180.0 / 3600.0
WAVELENGTH, ASSUMED_INDEX = 632.991e-9, 1.00027
TYPES = MessageTypes()


def instruments(port: int) -> dict[str, Any]:
    temperature = {"channel": "box/air", "scale": quantity_entry(1.0, "K/degC"), "offset": quantity_entry(273.15, "K")}
    air = {
        "temperature": temperature | {"sigma": quantity_entry(0.1, "K")},
        "pressure": quantity_entry(101325.0, "Pa", 30.0),
        "relative_humidity": quantity_entry(0.5, "1", 0.05),
        "co2_fraction": quantity_entry(450e-6, "1", 50e-6),
    }
    interferometer = {
        "wavelength": quantity_entry(WAVELENGTH, "m"),
        "assumed_index": ASSUMED_INDEX,
        "index_uncertainty": 2e-8,
        "air": air,
        "abbe_offsets": [{"offset": quantity_entry(0.01, "m"), "angle": quantity_entry(2e-6, "rad")}],
    }
    common = {"joint": "elbow", "frame_id": "table"}
    references = {
        "laser": {
            **common,
            "unit": "m",
            "channel": "box/distance",
            "scale": quantity_entry(1e-3, "m/mm"),
            "standard_uncertainty": quantity_entry(2e-8, "m"),
            "interferometer": interferometer,
        },
        "mirror": {
            **common,
            "unit": "rad",
            "channel": "box/angle",
            "scale": quantity_entry(ARCSEC, "rad/arcsec"),
            "standard_uncertainty": quantity_entry(5e-7, "rad"),
        },
    }
    return stream_rig(port, UNITS, {"gap_voltages": [{"channel": "box/gap"}]}) | {"references": references}


def opened(folder: Path, content: dict[str, Any]) -> InstrumentSource:
    return InstrumentSource(InstrumentParameters(file=write_rig(folder, content), joint="elbow"), TYPES)


@pytest.fixture
def values() -> list[Sequence[float]]:
    return [SOUND]


@pytest.fixture
def source(tmp_path: Path, values: list[Sequence[float]]) -> Iterator[InstrumentSource]:
    with StreamServer(lambda _: values[0]) as server:
        source = opened(tmp_path, instruments(server.port))
        topics = source.open()
        assert [topic.name for topic in topics] == ["raw", "/reference/laser", "/reference/mirror"]
        yield source
        source.close()


def wait_for_messages(source: InstrumentSource, count: int) -> dict[str, Any]:
    """Return the messages of one tick by topic, the first time that there are so many."""
    found: dict[str, Any] = {}

    def arrived() -> bool:
        messages = source.read_tick(source.newest_tick(time.time_ns()))
        found.clear()
        for each in messages:
            kind = RawScan if each.topic == "raw" else ReferenceReading
            found[each.topic] = deserialize_message(each.data, kind)
            assert stamp_ns(found[each.topic]) == each.time_ns
        return len(found) == count

    wait_until(arrived, f"{count} messages")
    return found


def test_references_are_corrected_and_have_the_stamp_of_the_scan(source: InstrumentSource) -> None:
    found = wait_for_messages(source, 3)
    laser, mirror = found["/reference/laser"], found["/reference/mirror"]
    assert stamp_ns(laser) == stamp_ns(mirror) == stamp_ns(found["raw"])
    assert (laser.header.frame_id, laser.unit, mirror.unit) == ("table", "m", "rad")
    index = Air(temperature=294.15, pressure=101325.0, relative_humidity=0.5, co2_fraction=450e-6).index(WAVELENGTH)
    assert laser.reading == pytest.approx(0.25, abs=1e-12)
    assert laser.value == pytest.approx(0.25 * ASSUMED_INDEX / index - 0.01 * 2e-6, abs=1e-12)
    # 0.1 K and 30 Pa change the index by 95e-9 and 81e-9, so 0.25 m by 24 and 20 nm; 5 % humidity by 11 nm.
    assert laser.standard_uncertainty == pytest.approx(np.hypot(2e-8, 33.4e-9), rel=0.05)
    assert mirror.value == mirror.reading == pytest.approx(3.0 * ARCSEC)
    assert mirror.standard_uncertainty == 5e-7


def test_air_out_of_range_and_an_invalid_reading_are_named(
    source: InstrumentSource, values: list[Sequence[float]]
) -> None:
    wait_for_messages(source, 3)
    gap, distance, angle, air = SOUND
    values[0] = (gap, distance, angle, 150.0)
    assert "/reference/laser" not in wait_for_messages(source, 2)
    assert "expected a value from 273.15 to 373.15 K" in source.statuses()[1].fault
    values[0] = (gap, distance, float("nan"), air)

    def sound_air() -> bool:
        wait_for_messages(source, 2)
        return not source.statuses()[1].fault

    wait_until(sound_air, "sound air", lambda: None)
    assert "/reference/mirror" not in wait_for_messages(source, 2)
    status = source.statuses()[2]
    assert (status.name, status.fault) == ("reference mirror", "no reading: box/angle is invalid")
    assert int(status.values["readings_missing"]) > 0
    values[0] = SOUND
    wait_for_messages(source, 3)
    assert source.statuses()[2].fault == ""


def record(folder: Path, messages: Sequence[tuple[str, int, bytes]]) -> Path:
    path = folder / "bag"
    with BagWriter(path) as writer:
        for topic, time_ns, data in messages:
            kind = RAW_SCAN if topic == "raw" else REFERENCE_READING
            if topic not in writer.counts:
                writer.add_topic(topic, kind, TYPES.definition(kind), [])
            writer.write(topic, time_ns, data)
    return path


def test_a_recorded_reference_keeps_stamp_and_uncertainty(source: InstrumentSource, tmp_path: Path) -> None:
    messages: list[tuple[str, int, bytes]] = []

    def ten_ticks() -> bool:
        found = source.read_tick(source.newest_tick(time.time_ns()))
        if len(found) == 3 and found[0].time_ns > max((each[1] for each in messages), default=0):
            messages.extend((each.topic, each.time_ns, each.data) for each in found)
        return len(messages) == 30

    wait_until(ten_ticks, "ten ticks")
    recording = load_recording(record(tmp_path, messages))
    laser = recording.tracks["/reference/laser"]
    np.testing.assert_array_equal(laser.stamps_ns, recording.scans.stamps_ns)
    assert laser.values[:, 0] == pytest.approx(0.25, abs=1e-6)
    assert laser.sigmas[0] == pytest.approx(np.hypot(2e-8, 33.4e-9), rel=0.05)
    given = load_recording(tmp_path / "bag", references=[Reference("/reference/laser", (1e-7,))])
    assert given.tracks["/reference/laser"].sigmas[0] == 1e-7


def test_readings_in_two_units_are_refused(source: InstrumentSource, tmp_path: Path) -> None:
    laser = wait_for_messages(source, 3)["/reference/laser"]
    scan = next(each for each in source.read_tick(source.newest_tick(time.time_ns())) if each.topic == "raw")
    messages = [("raw", scan.time_ns, scan.data)]
    for unit in ("m", "rad"):
        laser.unit = unit
        messages.append(("/reference/laser", scan.time_ns, serialize_message(laser)))
    with pytest.raises(TrackError, match="readings in m, rad; expected one unit only"):
        load_recording(record(tmp_path, messages))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"joint": "wrist"}, "joint 'wrist'; expected one of elbow"),
        ({"channel": "box/none"}, "channel 'box/none'; expected one of box/air, box/angle, box/distance, box/gap"),
        ({"unit": "rad"}, "standard uncertainty in m; expected rad"),
        ({"scale": quantity_entry(1.0, "m/V")}, "scale in m/V; expected one number in m/mm"),
        (
            {"interferometer": {"dead_path": quantity_entry(0.05, "m")}},
            "only one of dead_path and air_at_zero; expected both",
        ),
    ],
)
def test_an_invalid_reference_is_refused(tmp_path: Path, changes: dict[str, Any], sentence: str) -> None:
    content = instruments(1)
    laser = content["references"]["laser"]
    if "interferometer" in changes:
        changes = {"interferometer": laser["interferometer"] | changes["interferometer"]}
    laser |= changes
    with pytest.raises(CalibrationError) as caught:
        opened(tmp_path, content).open()
    assert sentence in str(caught.value)
