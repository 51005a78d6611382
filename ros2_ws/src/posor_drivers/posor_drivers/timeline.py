"""When each message of a replay is due."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from posor_estimator.errors import ParameterError
from posor_estimator.ros.parameters import NodeParameters
from posor_estimator.ros.qos import RAW_TOPIC
from pydantic import Field, model_validator

from posor_drivers.retiming import NS, Extent, Retiming

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from posor_drivers.sources.base import RecordedSource, SourceMessage


class ReplayParameters(NodeParameters):
    """How a recording is replayed."""

    rate: Annotated[float, Field(ge=0.0, le=10_000.0)] = Field(
        default=1.0, description="speed of the replay, 1 is real time; 0: as fast as possible"
    )
    loop: bool = Field(
        default=False, description="start over at the end; stamps and scan numbers continue as if the record went on"
    )
    restamp: bool = Field(
        default=False, description="move the stamps so that the replay begins now; false: keep the recorded stamps"
    )
    start_offset: Annotated[float, Field(ge=0.0)] = Field(
        default=0.0, description="skip this much of the record's beginning [s]"
    )
    stop_offset: Annotated[float, Field(gt=0.0, allow_inf_nan=True)] = Field(
        default=math.inf, description="stop before this distance from the record's beginning [s]; .inf: at its end"
    )

    @model_validator(mode="after")
    def _window_has_extent(self) -> ReplayParameters:
        if not self.stop_offset > self.start_offset:
            text = f"'stop_offset' {self.stop_offset} is not greater than 'start_offset' {self.start_offset}"
            raise ValueError(text)
        return self


class Due(NamedTuple):
    """What to publish on a topic, and when."""

    topic: str
    content: Any
    """Recorded bytes, or a message where its stamp had to change."""
    after_s: float
    """Since the beginning of the replay [s]; 0 where it is as fast as possible, and for a live source."""
    stamp_ns: int = 0
    """Stamp of the scan that it belongs to [ns]; 0 where that is not of the present."""


@dataclass(slots=True)
class Pause:
    """Nothing to publish before a ROS time [ns]."""

    until_ns: int


def timeline(
    source: RecordedSource[Any], classes: Mapping[str, Any], options: ReplayParameters, now_ns: int
) -> Iterator[Due]:
    """Yield what is to be published, in order; endless where the replay loops.

    Args:
        source: An open source.
        classes: Message class of each of its topics.
        options: Rate, offsets, looping and stamps.
        now_ns: Time of the ROS clock at which the replay begins [ns].

    Raises:
        ParameterError: no scan lies between the offsets.
        PosorError: the source cannot be read.

    """
    speed = options.rate or 1.0
    retiming = Retiming(classes, options.loop, options.restamp, now_ns, speed)
    length_ns = 0
    for turn in itertools.count():
        retiming.turn = turn
        everything, scans = Extent(), Extent()
        for message in _window(source, options):
            everything.see(message.time_ns)
            if message.topic == RAW_TOPIC:
                scans.see(message.time_ns)
            after_ns = turn * length_ns + message.time_ns - everything.first
            yield Due(message.topic, retiming.apply(message), after_ns / NS / speed if options.rate else 0.0)
        if not scans.count:
            raise ParameterError(
                f"no scan lies between 'start_offset' {options.start_offset} and 'stop_offset' {options.stop_offset}",
                expected="offsets within the record",
            )
        if not options.loop:
            return
        length_ns = everything.span + scans.period


def _window(source: RecordedSource[Any], options: ReplayParameters) -> Iterator[SourceMessage]:
    """Yield the messages between the offsets, which count from the first message."""
    origin_ns = None
    for message in source.messages():
        origin_ns = message.time_ns if origin_ns is None else origin_ns
        offset_s = (message.time_ns - origin_ns) / NS
        if offset_s >= options.stop_offset:
            return
        if offset_s >= options.start_offset:
            yield message
