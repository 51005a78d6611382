# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The recorder as a program: its bag, its end, its refusals."""

from __future__ import annotations

import signal
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from geometry_msgs.msg import PointStamped
from posor.messages.message_definitions import MessageTypes
from posor_drivers.recorder import DEPTH, RecordedTopic, strictest_request
from posor_lab.harness.graph import Graph, values_of
from posor_lab.harness.program import TIMEOUT_S, Program, installed, script
from posor_lab.harness.recorded_messages import read_bag
from posor_msgs.msg import RawScan
from posor_ros.qos import KEEP_ALL_QOS
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from .driver_program import LOSSLESS, driver_program
from .sample_bags import scan, write_bag

pytestmark = pytest.mark.usefixtures("ros_domain")

PUBLISHER = script(Path(__file__).with_name("scan_publisher.py"))
BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def record(bag: Path, *topics: str) -> Program:
    topic_options = ["--topics", *topics] if topics else ["--all"]
    return Program([*installed("posor_drivers", "record"), "--output", str(bag), *topic_options])


def refusal(*arguments: str) -> tuple[int, list[str]]:
    with Program([*installed("posor_drivers", "record"), *arguments]) as program:
        return program.wait(), program.stderr


def delivered(publisher: object) -> bool:
    return bool(publisher.wait_for_all_acked(Duration(seconds=30)))  # type: ignore[attr-defined]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_closes_the_bag_with_all_received_messages(tmp_path: Path, number: signal.Signals) -> None:
    bag = tmp_path / "deep/bag"
    with Graph() as graph, record(bag, "words", "/joint1/raw") as program:
        words = graph.publisher(String, "/words", RELIABLE)
        scans = graph.publisher(RawScan, "/joint1/raw", RELIABLE)
        program.wait_for_line("ready: recording /words /joint1/raw to ")
        for index in range(50):
            words.publish(String(data=f"word {index}"))
        scans.publish(scan(7, 100).data)
        assert delivered(words)
        assert delivered(scans)
        assert program.end(number) == 0
        assert program.stderr == []
        counts = program.stdout[-1].removeprefix(f"closed {bag}: ")
        assert sorted(counts.split(", ")) == ["/joint1/raw 1", "/words 50"]
    messages = read_bag(bag)
    assert [data for topic, _, data in messages if topic == "/joint1/raw"] == [scan(7, 100).data]
    texts = [deserialize_message(data, String).data for topic, _, data in messages if topic == "/words"]
    assert texts == [f"word {index}" for index in range(50)]


def test_bag_holds_types_hashes_and_offered_quality_of_service(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    with Graph() as graph, record(bag, "/joint1/raw", "/map") as program:
        scans = graph.node.create_publisher(RawScan, "/joint1/raw", BEST_EFFORT)
        latched = graph.node.create_publisher(String, "/map", LATCHED)
        latched.publish(String(data="sent before anybody listened"))
        program.wait_for_line("ready: ")
        graph.wait_until(
            lambda: scans.get_subscription_count() == latched.get_subscription_count() == 1, "the recorder"
        )
        assert delivered(latched)
        assert program.end() == 0
    information = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (information["version"], information["storage_identifier"]) == (9, "mcap")
    topics = {entry["topic_metadata"]["name"]: entry for entry in information["topics_with_message_count"]}
    for name, type_name, reliability, durability, count in (
        ("/joint1/raw", "posor_msgs/msg/RawScan", "best_effort", "volatile", 0),
        ("/map", "std_msgs/msg/String", "reliable", "transient_local", 1),
    ):
        metadata = topics[name]["topic_metadata"]
        (qos,) = metadata["offered_qos_profiles"]
        assert (qos["reliability"], qos["durability"]) == (reliability, durability)
        assert metadata["type"] == type_name
        assert metadata["type_description_hash"] == MessageTypes().definition(type_name).type_hash
        assert topics[name]["message_count"] == count


@pytest.mark.long
def test_no_scan_of_five_joints_at_a_kilohertz_is_lost(tmp_path: Path) -> None:
    bag, ticks = tmp_path / "bag", 4000
    topics = [f"/joint{joint}/raw" for joint in range(1, 6)]
    with record(bag, *topics) as program, Program([*PUBLISHER, str(ticks), "1000"]) as publisher:
        publisher.wait_for_line("all received")
        assert publisher.wait() == 0
        assert program.end(signal.SIGTERM) == 0
        assert program.stderr == []
    numbers: Mapping[str, list[int]] = {topic: [] for topic in topics}
    for topic, _, data in read_bag(bag):
        numbers[topic].append(deserialize_message(data, RawScan).scan)
    assert numbers == {topic: list(range(ticks)) for topic in topics}


@pytest.mark.long
def test_recording_of_a_replay_is_the_replayed_bag(tmp_path: Path) -> None:
    records = [scan(number, 1000 + number) for number in range(300)]
    original = write_bag(tmp_path / "original", records)
    copy = tmp_path / "copy"
    with record(copy, "/joint1/raw") as program:
        with driver_program(source="bag", bag__path=str(original), rate=0.0, **LOSSLESS) as replay:
            assert replay.wait() == 0
        assert program.end() == 0
    assert [data for _, _, data in read_bag(copy)] == [record.data for record in records]


def test_option_all_records_later_topics_too(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    with Graph() as graph, record(bag) as program:
        program.wait_for_line(f"ready: recording every topic to {bag}")
        for topic in ("/early", "/late"):
            publisher = graph.publisher(String, topic, RELIABLE)
            program.wait_for_line(f"found {topic} [std_msgs/msg/String]")
            publisher.publish(String(data=topic))
            assert delivered(publisher)
        hidden = graph.node.create_publisher(String, "/_hidden", RELIABLE)
        last = graph.publisher(String, "/last", RELIABLE)
        program.wait_for_line("found /last")
        assert hidden.get_subscription_count() == 0
        assert delivered(last)
        assert program.end() == 0
    recorded = {topic: data for topic, _, data in read_bag(bag)}
    assert "/_hidden" not in recorded
    for topic in ("/early", "/late"):
        assert deserialize_message(recorded[topic], String).data == topic


def test_progress_is_in_the_diagnostics(tmp_path: Path) -> None:
    with Graph() as graph, record(tmp_path / "bag", "/words") as program:
        graph.watch_diagnostics()
        graph.wait_for_status("/recorder: recording", "waiting for topics")
        words = graph.publisher(String, "/words", RELIABLE)
        graph.wait_for_status("/recorder: recording", "recording")
        for _ in range(3):
            words.publish(String(data="word"))
        graph.wait_until(
            lambda: values_of(graph.latest("/recorder: recording")).get("/words") == "3", "the count in the diagnostics"
        )
        assert program.end() == 0


def test_existing_output_is_refused(tmp_path: Path) -> None:
    assert refusal("--output", str(tmp_path), "--all") == (1, [f"{tmp_path}: exists already; expected a new folder."])


@pytest.mark.long
def test_invalid_command_line_is_refused_with_one_sentence(tmp_path: Path) -> None:
    bag = str(tmp_path / "bag")
    for arguments in ([], ["--output", bag], ["--all"], ["--output", bag, "--all", "--topics", "/x"], ["--what"]):
        code, (sentence,) = refusal(*arguments)
        assert code == 2
        assert sentence.startswith("record: ")
        assert sentence.endswith("expected options as 'posor record --help' lists them.")
    assert not (tmp_path / "bag").exists()


def test_invalid_topic_name_is_refused(tmp_path: Path) -> None:
    code, (sentence,) = refusal("--output", str(tmp_path / "bag"), "--topics", "/1st topic")
    assert code == 2
    assert sentence.startswith("record: '/1st topic' is not a topic name")


def test_missing_topic_makes_the_recording_fail_but_readable(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    with Graph() as graph, record(bag, "/words", "/nobody") as program:
        words = graph.publisher(String, "/words", RELIABLE)
        words.publish(String(data="word"))
        assert delivered(words)
        assert program.end() == 1
        assert program.stderr == [f"{bag}: topic /nobody never appeared."]
        assert not any("ready" in line for line in program.stdout)
    assert len(read_bag(bag)) == 1


def test_incompatible_publisher_is_reported(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    with Graph() as graph, record(bag, "/words") as program:
        graph.watch_diagnostics()
        graph.publisher(String, "/words", RELIABLE)
        program.wait_for_line("ready")
        graph.node.create_publisher(String, "/words", BEST_EFFORT)
        graph.wait_for_status("/recorder: recording", "best effort among reliable publishers")
        assert program.end() == 1
        (sentence,) = program.stderr
        assert sentence == f"{bag}: /words of /test_graph, best effort among reliable publishers, is missing."


def test_topic_with_two_types_is_refused(tmp_path: Path) -> None:
    with Graph() as one, Graph() as other:
        one.node.create_publisher(String, "/odd", RELIABLE)
        other.node.create_publisher(PointStamped, "/odd", RELIABLE)
        with record(tmp_path / "bag", "/odd") as program:
            one.wait_until(lambda: program.ended, "the end of the recorder")
            assert program.wait() == 1
            (sentence,) = program.stderr
    assert sentence.startswith("topic /odd has several types, ")


@pytest.mark.parametrize("count", [1, 2])
def test_lost_messages_of_each_publisher_are_counted(count: int) -> None:
    sent = (DEPTH + 300) // count  # by each publisher: more than the subscription holds, and nothing is taken meanwhile
    with Graph() as graph:
        tap = Node("_tap", context=graph.node.context, enable_rosout=False)
        publishers = [graph.node.create_publisher(String, "/words", KEEP_ALL_QOS) for _ in range(count)]
        topic = RecordedTopic(tap, "/words", "std_msgs/msg/String", [KEEP_ALL_QOS])
        matched = lambda: all(each.get_subscription_count() == 1 for each in publishers)  # noqa: E731
        graph.wait_until(lambda: matched() and topic.matched, "the subscription")
        for each in publishers:
            each.publish(String(data="first"))
        graph.wait_until(lambda: topic.received == count, "the first messages", lambda: list(topic.take_messages()))
        for index in range(sent):
            for each in publishers:
                each.publish(String(data=str(index)))
        for each in publishers:
            assert each.wait_for_all_acked(Duration(seconds=TIMEOUT_S))
        taken = [deserialize_message(data, String).data for _, data in topic.take_messages()]
        assert len(taken) == DEPTH
        if count == 1:
            assert taken == [str(index) for index in range(300, sent)]
        assert (topic.received, topic.lost) == (count + DEPTH, 300)
        tap.destroy_node()


def test_messages_before_the_recording_are_not_lost() -> None:
    with Graph() as graph:
        earlier, later = (graph.node.create_publisher(String, "/words", KEEP_ALL_QOS) for _ in range(2))
        for _ in range(50):
            earlier.publish(String(data="before"))
        tap = Node("_tap", context=graph.node.context, enable_rosout=False)
        topic = RecordedTopic(tap, "/words", "std_msgs/msg/String", [KEEP_ALL_QOS])
        matched = lambda: earlier.get_subscription_count() == later.get_subscription_count() == 1  # noqa: E731
        graph.wait_until(lambda: matched() and topic.matched, "the subscription")

        def publish(publisher: Any, count: int) -> None:
            publisher.publish(String(data="now"))
            graph.wait_until(lambda: topic.received == count, "a message", lambda: list(topic.take_messages()))

        for count, publisher in enumerate((later, earlier, later, earlier), start=1):
            publish(publisher, count)
        assert topic.lost == 0
        tap.destroy_node()


def test_a_recording_that_lost_messages_of_one_of_two_publishers_fails_and_states_how_many(tmp_path: Path) -> None:
    """The recorder is stopped while a publisher that keeps ten messages sends 3000."""
    bag = tmp_path / "bag"
    with Graph() as graph, record(bag, "/words") as program:
        short, other = (graph.publisher(String, "/words", QoSProfile(depth=10)) for _ in range(2))
        program.wait_for_line("ready")
        for each in (short, other):
            each.publish(String(data="first"))
            assert delivered(each)
        program.process.send_signal(signal.SIGSTOP)
        for index in range(3000):
            short.publish(String(data=str(index)))
        program.process.send_signal(signal.SIGCONT)
        for each in (short, other):
            each.publish(String(data="last"))
            assert delivered(each)
        assert program.end() == 1
    texts = [deserialize_message(data, String).data for _, _, data in read_bag(bag)]
    lost = 3004 - len(texts)
    assert lost > 0
    assert program.stderr == [f"{bag}: {lost} messages of /words were lost."]


@pytest.mark.parametrize(
    ("offers", "reliable", "latched"),
    [
        ([RELIABLE], True, False),
        ([BEST_EFFORT], False, False),
        ([RELIABLE, BEST_EFFORT], False, False),
        ([LATCHED], True, True),
        ([LATCHED, RELIABLE], True, False),
    ],
)
def test_request_is_the_strictest_that_all_offers_satisfy(
    offers: list[QoSProfile], *, reliable: bool, latched: bool
) -> None:
    profile = strictest_request(offers, 9)
    assert profile.depth == 9
    assert (profile.reliability == ReliabilityPolicy.RELIABLE) == reliable
    assert (profile.durability == DurabilityPolicy.TRANSIENT_LOCAL) == latched
