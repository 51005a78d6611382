# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A bag of arbitrary content, arrangement and writer, with the record of what was written into it."""

from __future__ import annotations

import shutil
from collections import Counter
from dataclasses import dataclass, field
from functools import cache
from random import Random
from typing import TYPE_CHECKING, Any

import yaml
import zstandard
from posor.messages.message_definitions import MessageTypes, installed_schema
from posor.numerics.stamps import NS
from posor.ros_names import RAW_SCAN

from posor_lab.foreign_bags.mcap_variants import GivenMessage, GivenTopic, happens, write_mcap
from posor_lab.foreign_bags.sqlite_variants import write_sqlite

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

BEGIN_NS = 1_700_000_000 * NS
STRING = "std_msgs/msg/String"
METADATA_VERSIONS = range(4, 10)
OTHERS = (
    GivenTopic("/notes", "note", "json", "jsonschema", b'{"type": "object"}'),
    GivenTopic("/log", "foxglove.Log", "protobuf", "protobuf", b"\x0a\xff\xfe\x80abc"),
    GivenTopic("/plain", "", "json", "", b""),
    GivenTopic("/old", "std_msgs/String", "ros1", "ros1msg", b"string data"),
    GivenTopic("/flat", "any.Flat", "flatbuffer", "flatbuffer", b"\0\1\2"),
    GivenTopic("/untyped", "", "cdr", "", b""),
    GivenTopic("/own", "own/Type", "cdr", "protobuf", b"\0"),
)
"""Topics that are left out."""
STATES_MORE = "metadata.yaml states too many messages"
"""Fault of a bag that is read with a note."""
INFINITE = "{sec: 9223372036, nsec: 854775807}"
QOS = """- history: {}
  depth: 0
  reliability: {}
  durability: {}
  deadline: {infinite}
  lifespan: {infinite}
  liveliness: {}
  liveliness_lease_duration: {infinite}
  avoid_ros_namespace_conventions: false"""
QOS_TEXTS = (
    "",
    QOS.format(3, 1, 2, 1, infinite=INFINITE),
    QOS.format("unknown", "reliable", "volatile", "automatic", infinite=INFINITE),
    "- reliability: 17",
    "[: no YAML",
)
DEFINITIONS: Mapping[str, Callable[[str], tuple[str, str]]] = {
    "plain": lambda text: ("ros2msg", text),
    "line ends of Windows": lambda text: ("ros2msg", text.replace("\n", "\r\n")),
    "byte order mark": lambda text: ("ros2msg", f"\ufeff{text}"),
    "none": lambda _: ("", ""),
}
"""Encoding and text of a definition."""


@dataclass
class GeneratedBag:
    """A bag, and what was written into it."""

    path: Path  # to open: the folder, or its only file
    messages: list[GivenMessage] = field(default_factory=list)  # all that was written
    options: list[str] = field(default_factory=list)  # what is unusual
    fault: str = ""  # what is wrong, if anything; then the bag may be refused
    is_mcap: bool = True

    @property
    def left_out(self) -> Counter[str]:
        """Number of the messages of other encodings, by topic."""
        return Counter(each.topic.name for each in self.messages if each.topic in OTHERS)

    @property
    def read(self) -> Counter[tuple[str, int, bytes]]:
        """Messages that a reader of ROS 2 bags reads: topic, log time, bytes."""
        return Counter((each.topic.name, each.time_ns, each.data) for each in self.messages if each.topic not in OTHERS)

    @property
    def can_be_recovered(self) -> bool:
        """Whether ``recover`` must copy every message."""
        return self.is_mcap and not self.fault and not any(option.startswith("zstd") for option in self.options)


@cache
def _definition(name: str) -> str:
    return MessageTypes().definition(name).text


def generate_bag(folder: Path, seed: str) -> GeneratedBag:
    """Write a bag into an empty folder. Equal seeds give equal bags."""
    chance = Random(seed)  # noqa: S311  not cryptography
    return _Generator(folder, chance).write()


class _Generator:
    def __init__(self, folder: Path, chance: Random) -> None:
        self._folder, self._chance = folder / "bag", chance
        self._folder.mkdir()
        self._bag = GeneratedBag(self._folder, is_mcap=happens(chance, 0.65))

    def write(self) -> GeneratedBag:
        chance, bag = self._chance, self._bag
        topics = self._choose_topics()
        messages = self._messages(topics)
        mode = chance.choice(["", "", "", "FILE", "MESSAGE"])
        names = self._write_files(messages, topics, mode)
        bag.messages = messages
        if len(names) == 1 and happens(chance, 0.3):
            bag.path = self._folder / names[0]
            bag.options.append("a file without metadata.yaml")
        else:
            self._write_metadata(names, messages, topics, mode)
        if happens(chance, 0.1):
            self._spoil(names)
        return bag

    def _choose_topics(self) -> list[GivenTopic]:
        chance = self._chance
        style = chance.choice(list(DEFINITIONS))
        self._bag.options.append(f"definitions: {style}")
        own = []
        for n, kind in enumerate(chance.choices([STRING, RAW_SCAN], k=chance.randrange(1, 4))):
            encoding, text = DEFINITIONS[style](_definition(kind))
            own.append(GivenTopic(f"/arm/joint{n}/raw", kind, "cdr", encoding, text.encode()))
        others = chance.sample(OTHERS, chance.choice([0, 0, 1, 2])) if self._bag.is_mcap else []
        return own + others

    def _messages(self, topics: Sequence[GivenTopic]) -> list[GivenMessage]:
        """Return messages in the order in which the file is written; scans have numbers by log time."""
        chance = self._chance
        count = chance.choice([1, 3, 20, 60, 60, 150])
        times = sorted(BEGIN_NS + each for each in chance.choices(range(2 * NS), k=count))
        if happens(chance, 0.2):
            times = [BEGIN_NS + (each - BEGIN_NS) // (NS // 10) for each in times]
            self._bag.options.append("equal log times")
        messages = [self._message(chance.choice(topics), number, each) for number, each in enumerate(times)]
        if happens(chance, 0.5):
            order = sorted(range(count), key=lambda n: n + chance.uniform(-8, 8))
            messages = [messages[n] for n in order]
            self._bag.options.append("log times that go back")
        return messages

    def _message(self, topic: GivenTopic, number: int, time_ns: int) -> GivenMessage:
        if topic in OTHERS:
            return GivenMessage(topic, time_ns, self._chance.randbytes(self._chance.randrange(60)))
        if topic.type_name == STRING:
            values: dict[str, Any] = {"data": "x" * self._chance.randrange(40) + str(number)}
        else:
            values = {"header.stamp.sec": time_ns // NS, "header.stamp.nanosec": number, "scan": number}
        return GivenMessage(topic, time_ns, installed_schema(topic.type_name).encode(values))

    def _write_files(self, messages: Sequence[GivenMessage], topics: Sequence[GivenTopic], mode: str) -> list[str]:
        chance, bag, compress = self._chance, self._bag, zstandard.ZstdCompressor(level=1).compress
        suffix, names = ".mcap" if bag.is_mcap else ".db3", list[str]()
        bag.options += [suffix, *([f"zstd: {mode}"] if mode else [])]
        for n, part in enumerate(self._split(messages)):
            stored = [each._replace(data=compress(each.data)) for each in part] if mode == "MESSAGE" else part
            path = self._folder / f"bag_{n}{suffix}"
            if bag.is_mcap:
                path.write_bytes(write_mcap(stored, topics, chance))
            else:
                bag.options.append(write_sqlite(path, stored, topics, chance.choice(QOS_TEXTS), chance))
            if mode == "FILE" and not any(
                path.with_name(f"{path.name}-{each}").exists() for each in ("wal", "journal")
            ):
                compressed = path.with_name(f"{path.name}.zstd")
                compressed.write_bytes(compress(path.read_bytes()))
                if not happens(chance, 0.1):
                    path.unlink()
                    path = compressed
                else:
                    compressed.unlink()
                    bag.options.append("decompressed by hand")
            names.append(path.name)
        return names

    def _split(self, messages: Sequence[GivenMessage]) -> list[list[GivenMessage]]:
        """Return the messages of each file."""
        chance, count = self._chance, self._chance.choice([1, 1, 2, 3, 12])
        if count > 1 and happens(chance, 0.3):
            self._bag.options.append("files that overlap in time")
            return [list(messages[n::count]) for n in range(count)]
        ordered = sorted(messages, key=lambda each: each.time_ns)
        parts = [ordered[len(ordered) * n // count : len(ordered) * (n + 1) // count] for n in range(count)]
        return [chance.sample(part, len(part)) for part in parts] if count > 1 else [list(messages)]

    def _write_metadata(
        self, names: Sequence[str], messages: Sequence[GivenMessage], topics: Sequence[GivenTopic], mode: str
    ) -> None:
        chance, bag = self._chance, self._bag
        counts = Counter(message.topic for message in messages)
        if happens(chance, 0.1):
            counts = Counter({topic: count // 2 for topic, count in counts.items()})
            bag.options.append("metadata.yaml states too few messages")
        listed = chance.sample(names, len(names))
        if mode == "FILE" and happens(chance, 0.2):
            listed = [each.removesuffix(".zstd") for each in listed]
        version, times = chance.choice(METADATA_VERSIONS), [message.time_ns for message in messages]
        information: dict[str, Any] = {
            "version": version,
            "storage_identifier": chance.choice(["mcap" if bag.is_mcap else "sqlite3", ""]),
            "relative_file_paths": [chance.choice(["", "bag/"]) + each for each in listed],
            "duration": {"nanoseconds": max(times) - min(times)},
            "starting_time": {"nanoseconds_since_epoch": min(times)},
            "message_count": counts.total(),
            "topics_with_message_count": [
                {"topic_metadata": self._topic_metadata(topic), "message_count": counts[topic]}
                for topic in topics
                if topic.type_name
            ],
            "compression_format": "zstd" if mode else "",
            "compression_mode": chance.choice([mode, mode.lower()]) if mode else chance.choice(["", "NONE"]),
        }
        text = yaml.safe_dump({"rosbag2_bagfile_information": information})
        (self._folder / "metadata.yaml").write_text(text)

    def _topic_metadata(self, topic: GivenTopic) -> dict[str, Any]:
        qos: object = self._chance.choice([*QOS_TEXTS, []])
        return {
            "name": topic.name,
            "type": topic.type_name,
            "serialization_format": topic.encoding,
            "offered_qos_profiles": qos,
        }

    def _spoil(self, names: Sequence[str]) -> None:
        """Make the bag invalid, so that it may be refused."""
        bag, path = self._bag, self._folder / self._chance.choice(names)
        faults: dict[str, Callable[[], object]] = {"a cut file": lambda: self._cut(path)}
        if bag.path == self._folder:
            faults |= {"a missing file": path.unlink, STATES_MORE: self._state_more}
        if bag.path == self._folder and path.suffix != ".zstd":
            faults["a file that is not listed"] = lambda: shutil.copyfile(path, path.with_stem("more"))
        bag.fault = self._chance.choice(list(faults))
        faults[bag.fault]()

    def _cut(self, path: Path) -> None:
        data = path.read_bytes()
        path.write_bytes(data[: self._chance.randrange(len(data))])

    def _state_more(self) -> None:
        path = self._folder / "metadata.yaml"
        content = yaml.safe_load(path.read_text())
        topic = content["rosbag2_bagfile_information"]["topics_with_message_count"][0]
        topic["message_count"] = 1000
        path.write_text(yaml.safe_dump(content))
