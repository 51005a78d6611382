"""When each message of a live source is due: at ticks of the ROS clock, in step with all other drivers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from posor_drivers.timeline import Due, Pause

if TYPE_CHECKING:
    from collections.abc import Iterator

    from posor_drivers.ros_time import RosTime
    from posor_drivers.sources.base import LiveSource


@dataclass
class Misses:
    """How often the process was too late for ticks, and how many went by; a new one for each run."""

    overruns: int = 0
    ticks: int = 0


def live(source: LiveSource[Any], time: RosTime, misses: Misses) -> Iterator[Due | Pause]:
    """Yield what is to be published, and pauses until the next is due; ends with the run.

    A tick whose successor is due as well has been missed: it is left out and counted, so that scans never come bunched.
    That is judged by the time of the thread's turn, so that drivers that share it miss the same ticks.
    Where the clock goes back (a simulation that starts over) or is stepped, ticks begin anew and none was missed.
    """
    while True:
        # Simulated time is zero until the clock's first message, which is no time that has gone by.
        while time.turn_ns < 1:
            yield Pause(1)
        epoch = time.epoch
        tick, last = source.begin(time.turn_ns)
        due_ns = source.due_ns(tick)
        while last is None or tick <= last:
            yield Pause(due_ns)
            if time.epoch != epoch:
                break
            due_ns = source.due_ns(tick + 1)
            if due_ns <= time.turn_ns:
                present = _newest_due(source, tick + 1, time.turn_ns)
                present = present if last is None else min(present, last)
                if present > tick:
                    misses.overruns += 1
                    misses.ticks += present - tick
                    tick = present
                    due_ns = source.due_ns(tick + 1)
            for message in source.messages(tick):
                yield Due(message.topic, message.data, 0.0, message.time_ns)
            tick += 1
        else:
            return


def _newest_due(source: LiveSource[Any], tick: int, now_ns: int) -> int:
    """Return the newest tick that is due, from one on that is."""
    newest = max(tick, source.newest(now_ns))
    while newest > tick and source.due_ns(newest) > now_ns:
        newest -= 1
    return newest
