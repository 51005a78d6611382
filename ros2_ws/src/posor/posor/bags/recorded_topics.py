# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the files of a bag say of their topics, whoever wrote them.

Read are topics whose messages are encoded in CDR and whose type is a ROS 2 message. Every other topic is left out and
listed, see ``Unread``.
"""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path, PureWindowsPath
from textwrap import shorten
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2.metadata import parse_qos

from posor.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rosbags.interfaces import Qos

METADATA = "metadata.yaml"
EXPECTED = "a rosbag2 bag, MCAP or SQLite, that was closed properly"
CDR = "cdr"
NO_DEFINITION = MessageDefinition(MessageDefinitionFormat.NONE, "")
FORMATS = {
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
    "omgidl": MessageDefinitionFormat.IDL,
    "": MessageDefinitionFormat.NONE,
    "unknown": MessageDefinitionFormat.NONE,  # rosbag2 did not find the definition
}
"""Format of a definition by its encoding in the file."""
TYPE_HASH = "RIHS01_"


class Unread(NamedTuple):
    """Messages of a file that are left out."""

    topic: str
    why: str  # a clause
    messages: int


@dataclass(frozen=True)
class StoredTopic:
    """A topic as a file describes it: a channel of MCAP, or a row of SQLite's ``topics``."""

    id: int
    name: str
    type_name: str  # empty: the file does not name the type
    encoding: str  # of the messages
    definition_encoding: str
    definition: bytes
    type_hash: str = ""
    qos: Any = ""  # offered profiles, as YAML text or as a list


@dataclass(frozen=True)
class BagMetadata:
    """The content of metadata.yaml that reading needs; of a single file: nothing."""

    files: Sequence[str] = ()  # names of the files, in the order of the list
    types: Mapping[str, str] = field(default_factory=dict)  # message type by topic
    type_hashes: Mapping[tuple[str, str], str] = field(default_factory=dict)  # by topic and type
    counts: Mapping[str, int] = field(default_factory=dict)  # stated number of messages by topic

    @staticmethod
    def load(folder: Path) -> BagMetadata:
        """Read the file of any version of rosbag2. Raises BagError: it is invalid."""
        path = folder / METADATA
        try:
            whole = yaml.safe_load(path.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
            compression, mode = (str(whole.get(f"compression_{each}") or "") for each in ("format", "mode"))
            files = Counter(PureWindowsPath(each).name for each in dict.fromkeys(whole["relative_file_paths"]))
            topics = [
                (each["topic_metadata"], int(each.get("message_count") or 0))
                for each in whole.get("topics_with_message_count") or ()
            ]
            types = {each["name"]: each["type"] for each, _ in topics}
            hashes = {(each["name"], each["type"]): each.get("type_description_hash") or "" for each, _ in topics}
            counts = dict.fromkeys(types, 0)
            for each, count in topics:
                counts[each["name"]] += count
        except (OSError, ValueError, KeyError, TypeError, AttributeError, yaml.YAMLError) as error:
            reason = "its content is not that of a bag"
            if isinstance(error, (KeyError, OSError, yaml.YAMLError)):
                reason = f"{'no ' * isinstance(error, KeyError)}{shorten(str(error), 120).rstrip('.')}"
            expected = "what 'ros2 bag reindex' writes, or 'recover' of posor for MCAP files"
            raise BagError(f"cannot be read, {reason}", where=str(path), expected=expected) from error
        if mode.lower() not in ("", "none") and compression not in ("", "zstd"):
            raise BagError(f"the bag is compressed with {compression}", where=str(path), expected="zstd")
        if repeated := [name for name, count in files.items() if count > 1]:
            what, expected = (
                f"lists two files of the name {repeated[0]}",
                f"each file once, in the folder of {METADATA}",
            )
            raise BagError(what, where=str(path), expected=expected)
        return BagMetadata(list(files), types, hashes, counts)


def connection_of(topic: StoredTopic, messages: int, metadata: BagMetadata) -> Connection | Unread:
    """Return a topic of a file that holds so many messages, as the readers of this stack know topics."""
    name = topic.type_name or metadata.types.get(topic.name, "")
    if topic.encoding != CDR:
        return Unread(topic.name, f"encoded as '{topic.encoding}', not '{CDR}'", messages)
    if topic.definition_encoding not in FORMATS:
        return Unread(topic.name, f"defined in '{topic.definition_encoding}', not as a ROS 2 message", messages)
    if not name:
        return Unread(topic.name, "of no stated type", messages)
    if name.count("/") == 1:
        name = name.replace("/", "/msg/")
    type_hash = topic.type_hash or metadata.type_hashes.get((topic.name, name), "")
    form, text = FORMATS[topic.definition_encoding], topic.definition.decode(errors="replace")
    text = text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n").rstrip("\0")
    return Connection(
        id=topic.id,
        topic=topic.name,
        msgtype=name,
        msgdef=MessageDefinition(form, text) if text else NO_DEFINITION,
        digest=type_hash if type_hash.startswith(TYPE_HASH) else "",
        msgcount=messages,
        ext=ConnectionExtRosbag2(topic.encoding, profiles_of(topic.qos)),
        owner=None,
    )


def profiles_of(qos: Any) -> list[Qos]:
    """Return offered profiles of any version of rosbag2; profiles that cannot be read are left out: none is needed."""
    with suppress(Exception):  # rosbags raises whatever the text leads to
        return parse_qos(qos)
    return []
