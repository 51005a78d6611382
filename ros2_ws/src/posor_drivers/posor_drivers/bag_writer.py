"""Writes rosbag2 bags: MCAP storage, metadata version 9, type definitions and hashes, offered quality of service.

Chunks and index have checksums (``posor.bags.mcap_writer``).
"""

from __future__ import annotations

import json
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Self

from posor.bags.mcap_writer import McapBagWriter
from posor.bags.provenance import PENDING
from posor.errors import BagError
from posor.numerics.stamps import NS
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.errors import WriterError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from posor.messages.message_definitions import Definition
    from rclpy.duration import Duration
    from rclpy.qos import QoSProfile
    from rosbags.interfaces import Connection

INFINITE_NS = 2**63 - 1


class BagWriter:
    """A bag that is being written; as a context manager it closes the bag.

    Equal calls give equal bytes.
    """

    def __init__(self, path: Path, custom_data: Mapping[str, str] | None = None) -> None:
        """Create the bag's folder.

        Args:
            path: The folder.
            custom_data: Of the bag's metadata; until the bag is closed it is in a file of its own.

        Raises:
            BagError: The folder exists already or cannot be created.

        """
        self.path = path
        self.counts: dict[str, int] = {}
        self._connections: dict[str, Connection] = {}
        if path.exists():
            raise BagError("exists already", where=str(path), expected="a new folder")
        with self._storage_errors():
            self._writer = McapBagWriter(path)
            self._writer.open()
            if custom_data:
                (path / PENDING).write_text(json.dumps(dict(custom_data), indent=1) + "\n", encoding="utf-8")
                for key, value in custom_data.items():
                    self._writer.set_custom_data(key, value)

    def add_topic(self, name: str, type_name: str, definition: Definition, qos: Sequence[QoSProfile]) -> None:
        """Add a topic; ``qos`` holds the profiles that its publishers offer.

        Raises:
            BagError: The storage fails.

        """
        profiles = [_bag_qos(profile) for profile in qos]
        with self._storage_errors():
            self._connections[name] = self._writer.add_connection(
                name, type_name, msgdef=definition.text, rihs01=definition.type_hash, offered_qos_profiles=profiles
            )
        self.counts[name] = 0

    def write(self, topic: str, time_ns: int, data: bytes) -> None:
        """Write one serialised message with its log time [ns].

        Raises:
            BagError: The storage fails.

        """
        with self._storage_errors():
            self._writer.write(self._connections[topic], time_ns, data)
        self.counts[topic] += 1

    def flush(self) -> None:
        """Hand all messages so far to the operating system; they survive the end of this process, not a loss of power.

        Raises:
            BagError: The storage fails.

        """
        with self._storage_errors():
            self._writer.flush()

    def close(self) -> None:
        """Write index and metadata.

        Raises:
            BagError: The storage fails.

        """
        with self._storage_errors():
            self._writer.close()
            (self.path / PENDING).unlink(missing_ok=True)

    @contextmanager
    def _storage_errors(self) -> Iterator[None]:
        """Turn errors of the storage into a BagError that names the bag."""
        try:
            yield
        except (WriterError, OSError) as error:
            reason = getattr(error, "strerror", None) or str(error).rstrip(".")
            raise BagError(f"the bag cannot be written, {reason.lower()}", where=str(self.path)) from error

    def __enter__(self) -> Self:
        """Return the writer."""
        return self

    def __exit__(self, *_error: object) -> None:
        """Close the bag, so that it is readable even after an error."""
        self.close()


@contextmanager
def replace_bag(bag: Path) -> Iterator[BagWriter]:
    """Write a bag that replaces an existing bag only once it is complete.

    Raises:
        BagError: The storage fails.

    """
    bag.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=bag.parent, prefix=".making-") as folder:
        new = Path(folder) / bag.name
        with BagWriter(new) as writer:
            yield writer
        if bag.exists():
            shutil.rmtree(bag)
        new.rename(bag)


def _bag_qos(profile: QoSProfile) -> Qos:
    """Return an offered profile in the form of a bag's metadata."""
    return Qos(
        history=QosHistory(int(profile.history)),
        depth=profile.depth,
        reliability=QosReliability(int(profile.reliability)),
        durability=QosDurability(int(profile.durability)),
        deadline=_bag_time(profile.deadline),
        lifespan=_bag_time(profile.lifespan),
        liveliness=QosLiveliness(int(profile.liveliness)),
        liveliness_lease_duration=_bag_time(profile.liveliness_lease_duration),
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def _bag_time(duration: Duration) -> QosTime:
    """Return a duration; an unspecified one (zero) is infinite."""
    return QosTime(*divmod(duration.nanoseconds or INFINITE_NS, NS))
