"""Source ``bag``: scans recorded in a rosbag2 bag, MCAP or SQLite."""

from __future__ import annotations

import struct
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from posor_estimator.errors import BagError, PosorError
from posor_estimator.ros.parameters import ParameterGroup
from posor_estimator.ros.qos import RAW_TOPIC
from pydantic import Field
from rosbags.rosbag2 import Reader

from posor_drivers.message_types import RAW_SCAN
from posor_drivers.sources.base import RecordedSource, SourceMessage, Topic

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rosbags.interfaces import Connection


EXPECTED = "a rosbag2 bag, MCAP or SQLite, that was closed properly"
SQLITE_MAGIC = b"SQLite format 3\0"


class BagParameters(ParameterGroup):
    """Parameters of the source ``bag``."""

    path: Annotated[str, Field(min_length=1)] = Field(
        description="bag: folder with metadata.yaml, or a single .mcap or .db3 file"
    )
    topic: str = Field(default="", description="recorded topic of this joint's scans; empty: the only one there is")
    other_topics: tuple[str, ...] = Field(
        default=(), description="further recorded topics to replay, under their recorded names"
    )


class BagSource(RecordedSource[BagParameters]):
    """Replays the recorded bytes of the chosen topics; what the scans hold is the POSOR node's to judge."""

    Parameters = BagParameters

    _names: dict[str, str]

    @property
    def record(self) -> str:
        """The file."""
        return self.parameters.path

    def open(self) -> Sequence[Topic]:
        """Check that the bag can be read to its end of index and holds the topics, in the versions installed here."""
        with self._reader() as reader:
            if not reader.message_count:
                raise BagError("holds no messages", where=self.parameters.path)
            scans = self._scan_topic(reader.connections)
            if scans in self.parameters.other_topics:
                raise BagError(f"topic {scans} is this joint's", where="bag.other_topics", expected="other topics only")
            self._names = {scans: RAW_TOPIC} | {name: name for name in self.parameters.other_topics}
            topics = [self._topic(reader.connections, name) for name in self._names]
            if not sum(connection.msgcount for connection in reader.connections if connection.topic == scans):
                raise BagError(f"topic {scans} holds no messages", where=self.parameters.path)
        return topics

    def messages(self) -> Iterator[SourceMessage]:
        """Yield the recorded messages in the order of their log times."""
        with self._reader() as reader:
            chosen = [connection for connection in reader.connections if connection.topic in self._names]
            count, promised = 0, sum(connection.msgcount for connection in chosen)
            for connection, time_ns, data in reader.messages(chosen):
                count += 1
                yield SourceMessage(self._names[connection.topic], time_ns, bytes(data))
            if count != promised:
                raise BagError(
                    f"holds {count} messages of {', '.join(self._names)}",
                    where=self.parameters.path,
                    expected=f"{promised}, as its index says",
                )

    @contextmanager
    def _reader(self) -> Iterator[Reader]:
        """Open the bag; whatever the storage layers stumble over becomes one sentence that names the bag."""
        path = Path(self.parameters.path)
        if not path.exists():
            raise BagError("does not exist", where=str(path), expected=EXPECTED)
        try:
            _check_size(path)
            with Reader(path) as reader:
                yield reader
        except PosorError:
            raise
        except Exception as error:
            reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
            raise BagError(f"the bag cannot be read, {reason}", where=str(path), expected=EXPECTED) from error

    def _scan_topic(self, connections: Sequence[Connection]) -> str:
        if self.parameters.topic:
            return self.parameters.topic
        names = sorted({connection.topic for connection in connections if connection.msgtype == RAW_SCAN})
        if len(names) == 1:
            return names[0]
        if names:
            what, expected = f"scans are on {len(names)} topics", "parameter 'bag.topic' as one of " + ", ".join(names)
        else:
            what, expected = f"there is no topic of type {RAW_SCAN}", f"one among {_listed(connections)}"
        raise BagError(what, where=self.parameters.path, expected=expected)

    def _topic(self, connections: Sequence[Connection], name: str) -> Topic:
        """Return the topic under the name it is published by, after checking that its type is the one installed."""
        found = next((connection for connection in connections if connection.topic == name), None)
        if found is None:
            raise BagError(
                f"there is no topic {name}", where=self.parameters.path, expected=f"one of {_listed(connections)}"
            )
        public = self._names[name]
        if public == RAW_TOPIC and found.msgtype != RAW_SCAN:
            raise BagError(f"topic {name} is of type {found.msgtype}", where=self.parameters.path, expected=RAW_SCAN)
        installed = self.types.definition(found.msgtype).type_hash
        if found.digest and found.digest != installed:
            raise BagError(
                f"topic {name} was recorded with another version of {found.msgtype}, {found.digest}",
                where=self.parameters.path,
                expected=installed,
            )
        return Topic(public, found.msgtype)


def _listed(connections: Sequence[Connection]) -> str:
    """Return the topics of a bag with their types, in words."""
    return ", ".join(sorted({f"{connection.topic} ({connection.msgtype})" for connection in connections})) or "none"


def _check_size(bag: Path) -> None:
    """Refuse an SQLite file that lacks its end; SQLite itself notices only where it happens to read there."""
    for path in sorted(bag.glob("*.db3")) if bag.is_dir() else [bag]:
        with path.open("rb") as file:
            head = file.read(32)
        if len(head) == len(SQLITE_MAGIC) + 16 and head.startswith(SQLITE_MAGIC):
            page_size, pages = struct.unpack(">H10xI", head[16:])
            if path.stat().st_size < (page_size if page_size > 1 else 65536) * pages:
                raise BagError("the file is cut short", where=str(path), expected=EXPECTED)
