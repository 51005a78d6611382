"""Writes rosbag2 bags: MCAP storage, metadata version 9, type definitions and hashes, offered quality of service."""

from __future__ import annotations

import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

from posor_estimator.errors import BagError
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.errors import WriterError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from types import TracebackType

    from posor_estimator.ros.message_types import Definition
    from rosbags.interfaces import Connection, Qos

METADATA_VERSION: Literal[9] = 9


class BagWriter:
    """A bag being written; a context manager that closes it.

    The same calls give the same bytes.
    """

    def __init__(self, path: Path) -> None:
        """Create the bag's folder.

        Raises:
            BagError: it exists already or cannot be created.

        """
        self.path = path
        self.counts: dict[str, int] = {}
        self._connections: dict[str, Connection] = {}
        if path.exists():
            raise BagError("exists already", where=str(path), expected="a folder that is yet to be made")
        with self._told():
            self._writer = Writer(path, version=METADATA_VERSION, storage_plugin=StoragePlugin.MCAP)
            self._writer.open()

    def add_topic(self, name: str, type_name: str, definition: Definition, qos: Sequence[Qos]) -> None:
        """Add a topic; ``qos`` holds the profiles that its publishers offer.

        Raises:
            BagError: the storage fails.

        """
        with self._told():
            self._connections[name] = self._writer.add_connection(
                name, type_name, msgdef=definition.text, rihs01=definition.type_hash, offered_qos_profiles=list(qos)
            )
        self.counts[name] = 0

    def write(self, topic: str, time_ns: int, data: bytes) -> None:
        """Write one serialised message.

        Raises:
            BagError: the storage fails.

        """
        with self._told():
            self._writer.write(self._connections[topic], time_ns, data)
        self.counts[topic] += 1

    def close(self) -> None:
        """Write index and metadata.

        Raises:
            BagError: the storage fails.

        """
        with self._told():
            self._writer.close()

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Turn what the storage layers raise into one sentence that names the bag."""
        try:
            yield
        except (WriterError, OSError) as error:
            reason = getattr(error, "strerror", None) or str(error).rstrip(".")
            raise BagError(f"the bag cannot be written, {reason.lower()}", where=str(self.path)) from error

    def __enter__(self) -> Self:
        """Return the writer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the bag, so that what was written can be read even after an error."""
        self.close()


@contextmanager
def replacement(bag: Path) -> Iterator[BagWriter]:
    """Write a bag that takes the place of any of that name, but only once it is whole.

    Raises:
        BagError: The storage fails.

    """
    bag.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=bag.parent, prefix=".making-") as making:
        made = Path(making) / bag.name
        with BagWriter(made) as writer:
            yield writer
        if bag.exists():
            shutil.rmtree(bag)
        made.rename(bag)
