"""Pauses between the messages that a driver publishes, and the states of a run."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

SUBSCRIBER_POLL_S = 0.02
"""Time between two checks whether enough subscribers are connected."""


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
