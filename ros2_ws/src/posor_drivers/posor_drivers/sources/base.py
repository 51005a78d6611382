"""What every source is: an iterator of serialised messages with their times."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Generic, TypeVar

from posor_estimator.ros.parameters import ParameterGroup

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from posor_drivers.message_types import MessageTypes

ParametersT = TypeVar("ParametersT", bound=ParameterGroup)


@dataclass(frozen=True)
class Topic:
    """A topic that a source publishes on: ``raw`` for the joint's scans, recorded names for anything else."""

    name: str
    type_name: str


@dataclass(frozen=True, slots=True)
class SourceMessage:
    """One message, serialised as it goes over the wire and into a bag."""

    topic: str
    time_ns: int
    """When it was recorded; its distance to the other messages' times is the pace of the replay."""
    data: bytes


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

    @abstractmethod
    def messages(self) -> Iterator[SourceMessage]:
        """Yield all messages from the beginning, in the order of their times; may be asked for again.

        Raises:
            PosorError: a message cannot be read.

        """

    def close(self) -> None:
        """Give back what ``open`` took."""
