# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Base classes of all sources, and their registry. An instrument is not a source: see ``instruments/device.py``.

How to add a source:

1. Declare its parameters in a subclass of ``ParameterGroup``. Parameter ``port`` of the source ``mybox`` is the ROS
   parameter ``mybox.port`` of ``driver_node``.
2. Derive the source from ``LiveSource`` for hardware, or from ``RecordedSource`` for data that exist already, and set
   its class attribute ``Parameters``. ``looped_source.py`` and ``table_source.py`` are short examples.
3. Register the class under its name in the entry point group ``posor_drivers.sources`` of its package's ``setup.py``:
   ``"posor_drivers.sources": ["mybox = my_package.mybox:MyBoxSource"]``.

Then ``driver_node`` runs it with ``-p source:=mybox``. Errors that a user can correct are raised as ``PosorError``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, TypeVar

from posor.errors import ParameterError
from posor.numerics.stamps import first_tick_after, tick_stamp_ns
from posor.parameter_model import ParameterGroup
from posor.plugins import load_class, registered

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.messages.message_definitions import MessageTypes
    from posor_ros.diagnostics import Value

ENTRY_POINT_GROUP = "posor_drivers.sources"

ParametersT = TypeVar("ParametersT", bound=ParameterGroup)


@dataclass(frozen=True)
class Topic:
    """A topic of a source: ``raw`` for the scans of the joint, absolute names for everything else."""

    name: str
    type_name: str


class SourceMessage(NamedTuple):
    """One message of a source, or one to publish."""

    topic: str
    time_ns: int
    """Log time of a recorded message, which sets the pace of a replay, or the stamp of the scan; 0 in a replay."""
    data: Any
    """Serialised (CDR); in a replay and after conditioning a message where it had to change."""
    after_s: float = 0.0
    """In a replay: time after its start [s]."""


@dataclass(frozen=True)
class Input:
    """A topic that a live source subscribes to."""

    topic: Topic
    on_message: Callable[[Any, int], None]
    """Called with each message and the ROS time [ns], in the executor's thread; raises a PosorError to refuse it."""


class SourceStatus(NamedTuple):
    """A status line of a live source in the diagnostics of its driver."""

    name: str
    fault: str
    """What is wrong; empty: nothing."""
    text: str
    values: Mapping[str, Value]


class Source(ABC, Generic[ParametersT]):
    """A source of raw scans.

    Attributes:
        Parameters: Model of the source's parameters.
        parameters: Their values.
        types: Message types, to serialise messages with.

    """

    Parameters: ClassVar[type[ParameterGroup]]

    def __init__(self, parameters: ParametersT, types: MessageTypes) -> None:
        """Store the parameters; ``open`` opens files and devices."""
        self.parameters = parameters
        self.types = types

    @property
    @abstractmethod
    def record(self) -> str:
        """File or device that is read, for the diagnostics."""

    @abstractmethod
    def open(self) -> Sequence[Topic]:
        """Open the source, check it, and return the published topics; ``raw`` comes first.

        Raises:
            PosorError: The source cannot be read.

        """

    def close(self) -> None:
        """Release what ``open`` acquired."""

    def check(self, calibration: Calibration) -> None:
        """Check before any node starts that the source fits a joint, without connecting to a device; by default not.

        Raises:
            PosorError: A file of the source is missing, invalid, or not for a joint with this calibration.

        """


class RecordedSource(Source[ParametersT]):
    """A source whose messages all exist already; ``driver_node`` replays them at a chosen pace.

    Attributes:
        stopping: Whether ``read_messages`` should end early; the driver sets this function.

    """

    stopping: Callable[[], bool] = staticmethod(lambda: False)

    @property
    def has_own_pace(self) -> bool:
        """Whether ``read_messages`` waits for messages, so that each is published at once."""
        return False

    def check(self, calibration: Calibration) -> None:
        """Open the recording as the driver will."""
        del calibration
        self.open()
        self.close()

    @abstractmethod
    def read_messages(self) -> Iterator[SourceMessage]:
        """Yield all messages from the beginning, in the order of their times; may be called repeatedly.

        Raises:
            PosorError: A message cannot be read.

        """


class LiveSource(Source[ParametersT]):
    """A source with one scan at each tick of the ROS clock: tick k is at k / rate seconds, see ``numerics.stamps``.

    A subclass must define ``rate`` and ``read_tick``. All methods but ``inputs`` and ``statuses`` are called in one
    thread, which drivers of the same rate share, so a slow source delays the other drivers.
    """

    @property
    @abstractmethod
    def rate(self) -> int:
        """Ticks per second, once the source is open."""

    @abstractmethod
    def read_tick(self, tick: int) -> Iterable[SourceMessage]:
        """Return the messages of a tick; ticks are read in ascending order, each at most once."""

    @property
    def ticks_kept(self) -> int:
        """Number of past ticks that can still be read, which are read late rather than missed."""
        return 0

    def inputs(self) -> Sequence[Input]:
        """Return the topics to subscribe to, once the source is open."""
        return ()

    def statuses(self) -> Sequence[SourceStatus]:
        """Return status lines, always the same names, once the source is open; called often, in another thread."""
        return ()

    def start_run(self, now_ns: int) -> tuple[int, int | None]:
        """Start a run, or restart it after the clock has gone back.

        Returns:
            The first tick later than ``now_ns``, and the last tick of the run; None: endless.

        """
        return first_tick_after(now_ns, self.rate), None

    def newest_tick(self, now_ns: int) -> int:
        """Return the newest tick at a time [ns]."""
        return first_tick_after(now_ns, self.rate) - 1

    def publication_time_ns(self, tick: int) -> int:
        """Return the ROS time at which the scan of a tick is published [ns]; by default the time of the tick."""
        return tick_stamp_ns(tick, self.rate)


def load_source_class(name: str) -> type[Source[Any]]:
    """Return the source registered as ``name``.

    Raises:
        ParameterError: The name is unknown, or the source cannot be loaded.

    """
    where = "parameter 'source'"
    entries = registered(ENTRY_POINT_GROUP)
    if name not in entries:
        names = ", ".join(f"'{known}'" for known in entries)
        expected = f"one of {names}"
        raise ParameterError(f"source '{name}' is unknown", where=where, expected=expected, parameter="source")
    refuse = partial(ParameterError, where=f"{where}, '{name}'", parameter="source")
    found: type[Source[Any]] = load_class(entries[name], Source, refuse)
    return found
