"""When each message of a live source is due: at ticks of the ROS clock, in step with all other drivers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from posor_drivers.timeline import Due

if TYPE_CHECKING:
    from collections.abc import Iterator

    from posor_drivers.ros_wait import RosWait
    from posor_drivers.sources.base import LiveSource


@dataclass
class Misses:
    """How many ticks went by while the process was late; a new one for each run."""

    count: int = 0


def live(source: LiveSource[Any], wait: RosWait, misses: Misses) -> Iterator[Due]:
    """Yield what is to be published, each when it is due; ends with the run or with the waiting.

    A tick whose successor is due as well has been missed: it is left out and counted, so that scans never come bunched.
    Where the clock goes back (a simulation that starts over), so do the ticks.
    """
    # Simulated time is zero until the clock's first message, which is no time that has gone by.
    while not wait.ended and wait.until(1):
        tick, last = source.begin(wait.now_ns)
        while (last is None or tick <= last) and wait.until(source.due_ns(tick)):
            present = _newest_due(source, tick, wait.now_ns)
            present = present if last is None else min(present, last)
            misses.count += present - tick
            tick = present
            for message in source.messages(tick):
                yield Due(message.topic, message.data, 0.0)
            tick += 1
        if last is not None and tick > last:
            return


def _newest_due(source: LiveSource[Any], tick: int, now_ns: int) -> int:
    """Return the newest tick that is due, from one on that is."""
    newest = max(tick, source.newest(now_ns))
    while source.due_ns(newest) > now_ns:
        newest -= 1
    return newest
