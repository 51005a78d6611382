# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from posor.errors import BagError
from posor.messages.cdr_schema import Schema
from posor.messages.message_definitions import MessageTypes, installed_schema
from posor.messages.raw_scan import LATER_FIELDS
from posor.ros_names import RAW_SCAN
from posor_drivers.sources.bag_source import BagParameters, BagSource
from posor_drivers.sources.source import SourceMessage, Topic
from rosbags.rosbag2 import StoragePlugin, Writer

from ..sample_bags import Record, point, scan, text, write_bag

EXPECTED = "expected a rosbag2 bag, MCAP or SQLite, that was closed properly."
RECOVER = "'recover' of posor writes what is whole to a new bag"
OTHER_HASH = "RIHS01_" + "0" * 64
RECORDS = [scan(1, 100), point(100), scan(2, 300), text(400), scan(3, 500), point(600)]


def read(path: Path, **parameters: Any) -> tuple[list[Topic], list[SourceMessage]]:
    source = BagSource(BagParameters(path=str(path), **parameters), MessageTypes())
    topics = list(source.open())
    return topics, list(source.read_messages())


def refusal(path: Path, **parameters: Any) -> str:
    with pytest.raises(BagError) as caught:
        read(path, **parameters)
    sentence = str(caught.value)
    assert "\n" not in sentence
    return sentence.replace(str(path), "BAG")


@pytest.mark.parametrize("sqlite", [False, True])
def test_messages_come_with_their_recorded_bytes_in_order_of_time(tmp_path: Path, *, sqlite: bool) -> None:
    bag = write_bag(tmp_path / "bag", RECORDS, sqlite=sqlite)
    topics, messages = read(bag)
    assert topics == [Topic("raw", "posor_msgs/msg/RawScan")]
    own = [SourceMessage(record.topic.replace("/joint1/raw", "raw"), record.time_ns, record.data) for record in RECORDS]
    assert messages == [message for message in own if message.topic == "raw"]
    topics, messages = read(bag, other_topics=("/remarks", "/truth/machining_centre"))
    assert [topic.name for topic in topics] == ["raw", "/remarks", "/truth/machining_centre"]
    assert topics[1].type_name == "std_msgs/msg/String"
    assert messages == own


def test_single_file_is_read_without_its_folder_and_each_time_the_same(tmp_path: Path) -> None:
    shutil.move(write_bag(tmp_path / "bag", RECORDS) / "bag.mcap", tmp_path / "alone.mcap")
    source = BagSource(BagParameters(path=str(tmp_path / "alone.mcap")), MessageTypes())
    source.open()
    messages = list(source.read_messages())
    assert len(messages) == 3
    assert list(source.read_messages()) == messages


def test_one_of_several_joints_must_be_chosen(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", [scan(1, 100), scan(7, 100, topic="/joint2/raw")])
    assert refusal(bag) == (
        "BAG: scans are on 2 topics; expected parameter 'bag.topic' as one of /joint1/raw, /joint2/raw."
    )
    _, messages = read(bag, topic="/joint2/raw")
    assert messages == [SourceMessage("raw", 100, scan(7, 100).data)]
    _, messages = read(bag, topic="/joint2/raw", other_topics=("/joint1/raw",))
    assert [message.topic for message in messages] == ["/joint1/raw", "raw"]


TRUTH = "/truth/machining_centre (geometry_msgs/msg/PointStamped)"
THERE = f"expected one of /joint1/raw (posor_msgs/msg/RawScan), {TRUTH}."


@pytest.mark.parametrize(
    ("records", "parameters", "sentence"),
    [
        (RECORDS[:2], {"topic": "/joint9/raw"}, f"BAG: there is no topic /joint9/raw; {THERE}"),
        (RECORDS[:2], {"other_topics": ("/none",)}, f"BAG: there is no topic /none; {THERE}"),
        (
            RECORDS[:2],
            {"topic": "/truth/machining_centre"},
            f"BAG: topic {TRUTH.replace('(', 'is of type ').rstrip(')')}; expected posor_msgs/msg/RawScan.",
        ),
        (RECORDS[1:2], {}, f"BAG: there is no topic of type posor_msgs/msg/RawScan; expected one among {TRUTH}."),
        (
            RECORDS,
            {"other_topics": ("/joint1/raw",)},
            "parameter 'bag.other_topics': topic /joint1/raw holds this joint's scans; expected other topics only.",
        ),
    ],
)
def test_unsuitable_topic_is_refused(
    tmp_path: Path, records: list[Record], parameters: dict[str, Any], sentence: str
) -> None:
    assert refusal(write_bag(tmp_path / "bag", records), **parameters) == sentence


@pytest.mark.parametrize("sqlite", [False, True])
@pytest.mark.parametrize("topic", ["/joint1/raw", "/truth/machining_centre"])
def test_topic_of_several_types_is_refused(tmp_path: Path, topic: str, *, sqlite: bool) -> None:
    bag = write_bag(tmp_path / "bag", [*RECORDS, text(800, topic)], sqlite=sqlite)
    several = {
        "/joint1/raw": "posor_msgs/msg/RawScan, std_msgs/msg/String; expected only posor_msgs/msg/RawScan.",
        "/truth/machining_centre": "geometry_msgs/msg/PointStamped, std_msgs/msg/String; expected only one.",
    }
    others = () if topic == "/joint1/raw" else (topic,)
    assert refusal(bag, other_topics=others) == f"BAG: topic {topic} holds messages of several types, {several[topic]}"


@pytest.mark.parametrize("sqlite", [False, True])
def test_scans_of_an_older_version_are_published_in_the_present_one(tmp_path: Path, *, sqlite: bool) -> None:
    present, records = installed_schema(RAW_SCAN), [scan(number, 100 * number) for number in (1, 2)]
    older = Schema("RawScan", [field for field in present.fields if field.path not in LATER_FIELDS])
    text = MessageTypes().definition(RAW_SCAN).text
    kept = [line for line in text.splitlines() if not any(name in line for name in LATER_FIELDS)]
    bag = write_bag(
        tmp_path / "bag",
        [record._replace(data=older.encode(present.values(record.data))) for record in records],
        sqlite=sqlite,
        type_hash=OTHER_HASH,
        definition_of_scans="\n".join(kept),
    )
    assert [message.data for message in read(bag)[1]] == [record.data for record in records]


def test_scans_of_another_version_without_its_definition_are_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", [scan(1, 100)], sqlite=True, type_hash=OTHER_HASH, definition_of_scans="")
    installed = MessageTypes().definition(RAW_SCAN).type_hash
    assert refusal(bag) == (
        f"BAG: topic /joint1/raw was recorded with another version of posor_msgs/msg/RawScan, {OTHER_HASH}, "
        f"and its definition is not stored; expected {installed}."
    )


@pytest.mark.parametrize("sqlite", [False, True])
def test_empty_bag_is_refused(tmp_path: Path, *, sqlite: bool) -> None:
    assert refusal(write_bag(tmp_path / "bag", [], sqlite=sqlite)) == "BAG: holds no messages."


def test_topic_without_messages_is_refused(tmp_path: Path) -> None:
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for record in (scan(1, 100), point(100)):
            definition = MessageTypes().definition(record.type_name)
            connection = writer.add_connection(
                record.topic, record.type_name, msgdef=definition.text, rihs01=definition.type_hash
            )
        writer.write(connection, 100, point(100).data)
    assert refusal(tmp_path / "bag") == "BAG: topic /joint1/raw holds no messages."


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.9, 0.999, None])
@pytest.mark.parametrize("sqlite", [False, True])
@pytest.mark.parametrize("alone", [False, True])
def test_truncated_or_foreign_storage_is_refused(
    tmp_path: Path, share: float | None, *, sqlite: bool, alone: bool
) -> None:
    bag = write_bag(tmp_path / "bag", [scan(number, 100 * number) for number in range(1, 200)], sqlite=sqlite)
    storage = bag / ("bag.db3" if sqlite else "bag.mcap")
    data = storage.read_bytes()
    storage.write_bytes(bytes(range(256)) * 20 if share is None else data[: int(len(data) * share)])
    sentence = refusal(storage if alone else bag)
    if sqlite:
        assert sentence.startswith(("BAG: ", "BAG/bag.db3: "))
        assert f"; {EXPECTED.rstrip('.')}" in sentence
    else:
        assert sentence.startswith(("BAG: the file is empty", "BAG, byte ") if alone else "BAG/bag.mcap")
        assert sentence.endswith(f"; expected an undamaged file; {RECOVER}.")


@pytest.mark.parametrize("sqlite", [False, True])
def test_storage_with_fewer_messages_than_its_metadata_state_is_read_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, *, sqlite: bool
) -> None:
    bag = write_bag(tmp_path / ("sqlite" if sqlite else "mcap"), RECORDS, sqlite=sqlite)  # a note is logged once
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 3", "message_count: 4"))
    assert len(read(bag)[1]) == 3
    note = f"{bag}: metadata.yaml states 4 messages of /joint1/raw; the files hold 3."
    assert [record.getMessage() for record in caplog.records] == [note]


def test_missing_or_invalid_metadata_are_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", RECORDS)
    metadata = bag / "metadata.yaml"
    good = metadata.read_text()
    for wrong in ("", "a: [", "a: 3"):
        metadata.write_text(wrong)
        assert refusal(bag).startswith("BAG/metadata.yaml: cannot be read, ")
    metadata.write_text(good.replace("version: 9", "version: 99"))
    assert len(read(bag)[1]) == 3
    metadata.write_text(good.replace(".mcap", ".other"))
    assert refusal(bag).startswith("BAG: bag.other is missing; ")
    metadata.unlink()
    missing = "BAG: metadata.yaml is missing in the folder of the bag; expected it"
    itself = "or name the file 'BAG/bag.{}' itself"
    assert refusal(bag) == f"{missing}; {RECOVER} with metadata.yaml; {itself.format('mcap')}."
    (bag / "bag.mcap").rename(bag / "bag.db3")
    assert refusal(bag) == f"{missing}, as 'ros2 bag reindex' makes it; {itself.format('db3')}."


def test_path_without_a_bag_is_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path / "none") == f"BAG: does not exist; {EXPECTED}"
    file = tmp_path / "notes.txt"
    file.write_text("no bag")
    assert refusal(file) == f"BAG: is no file that ends in .mcap or .db3; {EXPECTED}"
    assert refusal(tmp_path) == f"BAG: the folder holds no bag; {EXPECTED}"
