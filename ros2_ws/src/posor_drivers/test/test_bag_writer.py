# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from posor.bags.bag_writer import BagWriter, replace_bag
from posor.errors import BagError, OutputError
from posor.messages.message_definitions import MessageTypes
from posor.ros_names import RAW_SCAN
from posor_lab.harness.recorded_messages import read_bag
from posor_ros.qos import RELIABLE_QOS
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader

from .sample_bags import point, scan

BEST_EFFORT_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def write(path: Path) -> None:
    types = MessageTypes()
    with BagWriter(path) as writer:
        for record, qos in ((scan(1, 100), BEST_EFFORT_QOS), (point(100), RELIABLE_QOS)):
            definition = types.definition(record.type_name)
            writer.add_topic(record.topic, record.type_name, definition, [qos])
        for record in (scan(1, 100), point(100), scan(2, 200)):
            writer.write(record.topic, record.time_ns, record.data)
        assert writer.counts == {"/joint1/raw": 2, "/truth/machining_centre": 1}


def test_same_calls_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write(tmp_path / name / "bag")
    for file in ("bag_0.mcap", "metadata.yaml"):
        assert (tmp_path / "a/bag" / file).read_bytes() == (tmp_path / "b/bag" / file).read_bytes()


def replace(path: Path, scans: int, *, fail: bool = False) -> None:
    definition = MessageTypes().definition(scan(1, 100).type_name)
    with replace_bag(path) as writer:
        writer.add_topic("/joint1/raw", scan(1, 100).type_name, definition, [RELIABLE_QOS])
        for number in range(1, scans + 1):
            writer.write("/joint1/raw", 100 * number, scan(number, 100 * number).data)
        if fail:
            raise BagError("the simulator has no such scan")


def test_bag_is_replaced_only_by_a_complete_bag(tmp_path: Path) -> None:
    bag = tmp_path / "new" / "bag"
    for scans in (3, 1):
        replace(bag, scans)
        assert [number for _, number, _ in read_bag(bag)] == [100 * n for n in range(1, scans + 1)]
        assert list(bag.parent.iterdir()) == [bag]
    with pytest.raises(BagError, match="no such scan"):
        replace(bag, 2, fail=True)
    assert len(read_bag(bag)) == 1
    assert list(bag.parent.iterdir()) == [bag]


def test_messages_are_stored_with_their_times(tmp_path: Path) -> None:
    write(tmp_path / "bag")
    assert read_bag(tmp_path / "bag") == [
        ("/joint1/raw", 100, scan(1, 100).data),
        ("/truth/machining_centre", 100, point(100).data),
        ("/joint1/raw", 200, scan(2, 200).data),
    ]


def test_metadata_are_those_of_rosbag2_version_9(tmp_path: Path) -> None:
    write(tmp_path / "bag")
    information: dict[str, Any] = yaml.safe_load((tmp_path / "bag/metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert information["version"] == 9
    assert information["storage_identifier"] == "mcap"
    assert information["relative_file_paths"] == ["bag_0.mcap"]
    assert information["message_count"] == 3
    assert information["starting_time"] == {"nanoseconds_since_epoch": 100}
    assert information["duration"] == {"nanoseconds": 100}
    first = information["topics_with_message_count"][0]
    assert first["message_count"] == 2
    topic = first["topic_metadata"]
    assert (topic["name"], topic["type"], topic["serialization_format"]) == (
        "/joint1/raw",
        "posor_msgs/msg/RawScan",
        "cdr",
    )
    assert topic["type_description_hash"] == MessageTypes().definition("posor_msgs/msg/RawScan").type_hash
    (qos,) = topic["offered_qos_profiles"]
    assert (qos["reliability"], qos["durability"], qos["history"], qos["depth"]) == (
        "best_effort",
        "volatile",
        "keep_last",
        5,
    )
    infinite = {"sec": 9223372036, "nsec": 854775807}
    assert [qos[name] for name in ("deadline", "lifespan", "liveliness_lease_duration")] == [infinite] * 3


def test_storage_holds_the_definitions(tmp_path: Path) -> None:
    write(tmp_path / "bag")
    with Reader(tmp_path / "bag/bag_0.mcap") as reader:
        by_topic = {connection.topic: connection for connection in reader.connections}
    definition = MessageTypes().definition("posor_msgs/msg/RawScan")
    assert by_topic["/joint1/raw"].msgdef.data == definition.text
    assert by_topic["/joint1/raw"].msgdef.format.name == "MSG"


def test_existing_path_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "file"):
        (tmp_path / "file").touch()
        with pytest.raises(BagError) as caught:
            BagWriter(path)
        assert str(caught.value) == f"{path}: exists already; expected a new folder."


def test_impossible_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError) as caught:
        BagWriter(tmp_path / "file/bag")
    assert str(caught.value) == f"{tmp_path}/file/bag: cannot be written, Not a directory."


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full to stand for a full disk")
def test_full_disk_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real_open = Path.open

    def onto_full_disk(path: Path, mode: str = "r", *arguments: Any, **options: Any) -> Any:
        return real_open(Path("/dev/full"), "wb") if mode == "xb" else real_open(path, mode, *arguments, **options)

    monkeypatch.setattr(Path, "open", onto_full_disk)
    with pytest.raises(OutputError, match="cannot be written, No space left on device"):
        write(tmp_path / "bag")


def interrupted_recording(path: Path) -> None:
    record = scan(1, 100)
    with BagWriter(path) as writer:
        writer.add_topic(record.topic, record.type_name, MessageTypes().definition(record.type_name), [])
        writer.write(record.topic, record.time_ns, record.data)
        raise KeyError("something else went wrong")


def test_bag_is_closed_properly_after_an_error(tmp_path: Path) -> None:
    with pytest.raises(KeyError):
        interrupted_recording(tmp_path / "bag")
    assert len(read_bag(tmp_path / "bag")) == 1


def test_finite_durations_are_written(tmp_path: Path) -> None:
    qos = QoSProfile(depth=1, deadline=Duration(nanoseconds=1_500_000_000))
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/raw", RAW_SCAN, MessageTypes().definition(RAW_SCAN), [qos])
    with Reader(tmp_path / "bag") as reader:
        (connection,) = reader.connections
        assert isinstance(connection.ext, ConnectionExtRosbag2)
        (written,) = connection.ext.offered_qos_profiles
    assert (written.deadline.sec, written.deadline.nsec) == (1, 500_000_000)
