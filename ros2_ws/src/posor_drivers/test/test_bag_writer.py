from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from posor_drivers.bag_writer import BagWriter, replacement
from posor_drivers.offered_qos import kept_in_bag, request_for
from posor_estimator.errors import BagError
from posor_estimator.ros.message_types import MessageTypes
from posor_estimator.ros.qos import RELIABLE_QOS
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.rosbag2 import Reader

from .bags import point, read_bag, scan

BEST_EFFORT_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def write(path: Path) -> None:
    types = MessageTypes()
    with BagWriter(path) as writer:
        for record, qos in ((scan(1, 100), BEST_EFFORT_QOS), (point(100), RELIABLE_QOS)):
            definition = types.definition(record.type_name)
            writer.add_topic(record.topic, record.type_name, definition, [kept_in_bag(qos)])
        for record in (scan(1, 100), point(100), scan(2, 200)):
            writer.write(record.topic, record.time_ns, record.data)
        assert writer.counts == {"/joint1/raw": 2, "/truth/machining_centre": 1}


def test_same_calls_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write(tmp_path / name / "bag")
    for file in ("bag.mcap", "metadata.yaml"):
        assert (tmp_path / "a/bag" / file).read_bytes() == (tmp_path / "b/bag" / file).read_bytes()


def replace(path: Path, scans: int, *, fail: bool = False) -> None:
    definition = MessageTypes().definition(scan(1, 100).type_name)
    with replacement(path) as writer:
        writer.add_topic("/joint1/raw", scan(1, 100).type_name, definition, [kept_in_bag(RELIABLE_QOS)])
        for number in range(1, scans + 1):
            writer.write("/joint1/raw", 100 * number, scan(number, 100 * number).data)
        if fail:
            raise BagError("the simulator has no such scan")


def test_a_bag_is_replaced_once_the_new_one_is_whole(tmp_path: Path) -> None:
    bag = tmp_path / "new" / "bag"
    for scans in (3, 1):
        replace(bag, scans)
        assert [number for _, number, _ in read_bag(bag)] == [100 * n for n in range(1, scans + 1)]
        assert list(bag.parent.iterdir()) == [bag]
    with pytest.raises(BagError, match="no such scan"):
        replace(bag, 2, fail=True)
    assert len(read_bag(bag)) == 1
    assert list(bag.parent.iterdir()) == [bag]


def test_messages_are_kept_with_their_times(tmp_path: Path) -> None:
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
    assert information["relative_file_paths"] == ["bag.mcap"]
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
    with Reader(tmp_path / "bag/bag.mcap") as reader:
        by_topic = {connection.topic: connection for connection in reader.connections}
    definition = MessageTypes().definition("posor_msgs/msg/RawScan")
    assert by_topic["/joint1/raw"].msgdef.data == definition.text
    assert by_topic["/joint1/raw"].msgdef.format.name == "MSG"


def test_existing_path_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "file"):
        (tmp_path / "file").touch()
        with pytest.raises(BagError) as caught:
            BagWriter(path)
        assert str(caught.value) == f"{path}: exists already; expected a folder that is yet to be made."


def test_place_where_no_folder_can_be_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(BagError) as caught:
        BagWriter(tmp_path / "file/bag")
    assert str(caught.value) == f"{tmp_path}/file/bag: the bag cannot be written, not a directory."


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full to stand for a full disk")
def test_full_disk_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real_open = Path.open

    def onto_full_disk(path: Path, mode: str = "r", *arguments: Any, **options: Any) -> Any:
        return real_open(Path("/dev/full"), "wb") if mode == "xb" else real_open(path, mode, *arguments, **options)

    monkeypatch.setattr(Path, "open", onto_full_disk)
    with pytest.raises(BagError, match="the bag cannot be written, no space left on device"):
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


def test_request_is_the_strictest_that_all_offers_satisfy() -> None:
    def request(*offers: QoSProfile) -> tuple[ReliabilityPolicy, DurabilityPolicy]:
        profile = request_for(offers, 9)
        assert profile.depth == 9
        return profile.reliability, profile.durability

    reliable, best_effort = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
    volatile, latched = DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL
    assert request(RELIABLE_QOS) == (reliable, volatile)
    assert request(BEST_EFFORT_QOS) == (best_effort, volatile)
    assert request(RELIABLE_QOS, BEST_EFFORT_QOS) == (best_effort, volatile)
    assert request(LATCHED_QOS) == (reliable, latched)
    assert request(LATCHED_QOS, RELIABLE_QOS) == (reliable, volatile)


def test_finite_durations_are_kept() -> None:
    qos = kept_in_bag(QoSProfile(depth=1, deadline=Duration(nanoseconds=1_500_000_000)))
    assert (qos.deadline.sec, qos.deadline.nsec) == (1, 500_000_000)
