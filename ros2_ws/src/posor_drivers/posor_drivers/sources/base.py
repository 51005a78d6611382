"""What every source is: recorded, an iterator of serialised messages with their times, or live, asked tick by tick."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, TypeVar

from posor_estimator.ros.parameters import ParameterGroup

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from posor_estimator.ros.message_types import MessageTypes

ParametersT = TypeVar("ParametersT", bound=ParameterGroup)


@dataclass(frozen=True)
class Topic:
    """A topic that a source publishes on: ``raw`` for the joint's scans, recorded names for anything else."""

    name: str
    type_name: str


class SourceMessage(NamedTuple):
    """One message, serialised as it goes over the wire and into a bag."""

    topic: str
    time_ns: int
    """When it was recorded, or the scan's stamp; the distance to the others' times is the pace of a replay."""
    data: bytes


@dataclass(frozen=True)
class Input:
    """A topic that a live source listens to."""

    topic: Topic
    take: Callable[[Any, int], None]
    """Called with each message and the ROS time [ns]; a PosorError refuses it. Not in the thread of the scans."""


class Source(ABC, Generic[ParametersT]):
    """A source of scans.

    Attributes:
        Parameters: Model of the source's own parameters; in the driver node they are named ``<source>.<parameter>``.

    """

    Parameters: ClassVar[type[ParameterGroup]]

    def __init__(self, parameters: ParametersT, types: MessageTypes) -> None:
        """Store the parameters; nothing is opened yet."""
        self.parameters = parameters
        self.types = types

    @property
    @abstractmethod
    def record(self) -> str:
        """What is read, for the diagnostics: a file, a device."""

    @abstractmethod
    def open(self) -> Sequence[Topic]:
        """Check that the source can be read and return what it publishes; ``raw`` comes first.

        Raises:
            PosorError: it cannot be read, with the sentence that says why.

        """

    def close(self) -> None:
        """Give back what ``open`` took."""


class RecordedSource(Source[ParametersT]):
    """A source that has all its messages from the beginning; the driver replays them at whatever pace it is told."""

    @abstractmethod
    def messages(self) -> Iterator[SourceMessage]:
        """Yield all messages from the beginning, in the order of their times; may be asked for again.

        Raises:
            PosorError: a message cannot be read.

        """


class LiveSource(Source[ParametersT]):
    """A source whose scans happen at ticks of the ROS clock, and which has none before.

    Ticks are whole numbers; each has a time at which its scan is due to be published. All methods but ``inputs`` are
    called in one thread, which drivers of the same rate share: a source that takes its time makes the others late.
    """

    @property
    @abstractmethod
    def rate(self) -> float:
        """Ticks per second, once the source is open."""

    @abstractmethod
    def inputs(self) -> Sequence[Input]:
        """Return what the source listens to, once it is open."""

    @abstractmethod
    def begin(self, now_ns: int) -> tuple[int, int | None]:
        """Begin a run, or begin again after the clock has gone back.

        Returns:
            The first tick later than a time [ns], and the last one of the run; None: endless.

        """

    @abstractmethod
    def newest(self, now_ns: int) -> int:
        """Return the newest tick whose scan has happened by a time [ns]."""

    @abstractmethod
    def due_ns(self, tick: int) -> int:
        """Return the ROS time at which a tick's scan is due to be published [ns]."""

    @abstractmethod
    def messages(self, tick: int) -> Iterable[SourceMessage]:
        """Return the messages of a tick; each tick is asked for once at most, in order."""
