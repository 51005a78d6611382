"""What a driver publishes next, and when: the items that sources, conditioning and schedulers pass on."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple

SUBSCRIBER_POLL_S = 0.02
"""Time between two checks whether enough subscribers are connected."""


class ScheduledPublication(NamedTuple):
    """A message to publish."""

    topic: str
    content: Any
    """Serialised bytes, or a message where its stamp had to change."""
    after_s: float
    """Time after the start of the replay [s]; 0 for a replay without pace and for a live source."""
    stamp_ns: int = 0
    """Stamp of the scan that the message belongs to [ns]; 0 for a replay."""


@dataclass(slots=True)
class Pause:
    """Nothing is published before a ROS time [ns]."""

    until_ns: int


class RunState(Enum):
    """State of the publication of a source."""

    WAITING = "waiting"
    RUNNING = "running"
    ENDED = "ended"
    FAILED = "failed"
