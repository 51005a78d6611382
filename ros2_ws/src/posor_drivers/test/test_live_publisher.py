# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Schedule of a live source: at ticks, in order, never bunched."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import pytest
from posor.messages.message_definitions import MessageTypes
from posor.parameter_model import ParameterGroup
from posor_drivers.sources.source import LiveSource, SourceMessage
from posor_drivers.tick_scheduler import MissedTicks, Pause, schedule_ticks

PERIOD = 10


class Metronome(LiveSource[ParameterGroup]):
    """Ticks every 10 ns; each is published 3 ns later. Six in a run, counted from the first multiple of six."""

    Parameters = ParameterGroup
    endless = False
    record = "nothing"
    rate = 100_000_000

    def open(self) -> Sequence[Any]:
        return []

    def inputs(self) -> Sequence[Any]:
        return []

    def start_run(self, now_ns: int) -> tuple[int, int | None]:
        self.begun = [*getattr(self, "begun", []), now_ns]
        first = now_ns // PERIOD + 1
        return first, None if self.endless else -(-first // 6) * 6 + 5

    def newest_tick(self, now_ns: int) -> int:
        return now_ns // PERIOD

    def publication_time_ns(self, tick: int) -> int:
        return tick * PERIOD + 3

    def read_tick(self, tick: int) -> Iterator[SourceMessage]:
        yield SourceMessage("raw", tick * PERIOD, str(tick).encode())
        yield SourceMessage("truth", tick * PERIOD, b"")


class Wall:
    """Replaces a TickClock: reaches each time waited for, late or in another epoch as given."""

    def __init__(self, now_ns: int, late: dict[int, int] | None = None, steps: dict[int, int] | None = None) -> None:
        self.turn_ns = now_ns
        self.epoch = 0
        self._late = late or {}
        self._steps = steps or {}

    def wait(self, time_ns: int) -> None:
        if time_ns in self._steps:
            self.turn_ns = self._steps.pop(time_ns)
            self.epoch += 1
        else:
            self.turn_ns = max(self.turn_ns, self._late.pop(time_ns, time_ns))


def ticks(wall: Wall, source: Metronome | None = None, count: int = 1000) -> tuple[list[int], MissedTicks]:
    """Return the ticks that are published, up to a count, and what was missed."""
    misses, published = MissedTicks(), list[int]()
    source = source or Metronome(ParameterGroup(), MessageTypes())
    dues = schedule_ticks(source, wall, misses)  # type: ignore[arg-type]
    for due in dues:
        if isinstance(due, Pause):
            wall.wait(due.until_ns)
            continue
        tick = due.time_ns // PERIOD
        assert (due.topic, due.data, due.after_s) == ("raw", str(tick).encode(), 0.0)
        assert source.publication_time_ns(tick) <= wall.turn_ns
        truth = next(dues)
        assert not isinstance(truth, Pause)
        assert (truth.topic, truth.time_ns) == ("truth", due.time_ns)
        published.append(tick)
        if len(published) == count:
            break
    return published, misses


@pytest.mark.parametrize(
    ("begin_ns", "late", "published", "missed"),
    [
        (600, {}, [*range(61, 72)], MissedTicks()),  # from the next tick to the end of a cycle
        (599, {}, [*range(60, 66)], MissedTicks()),
        # Asked to wait for tick 62 at 623, the process comes back at 655: 62, 63, 64 are over, 65 is due.
        (600, {623: 655}, [61, *range(65, 72)], MissedTicks(overruns=1, ticks=3)),
        (600, {623: 632}, [*range(61, 72)], MissedTicks()),  # late, but the next is not due
        # A tick is missed when the next one is due, not when it has happened.
        (600, {623: 651}, [61, 64, *range(65, 72)], MissedTicks(overruns=1, ticks=2)),
        (600, {623: 633}, [61, *range(63, 72)], MissedTicks(overruns=1, ticks=1)),
        # The last tick is published even if the process wakes after the end.
        (600, {693: 90_000}, [*range(61, 69), 71], MissedTicks(overruns=1, ticks=2)),
    ],
)
def test_missed_ticks_are_counted_and_skipped(
    begin_ns: int, late: dict[int, int], published: list[int], missed: MissedTicks
) -> None:
    assert ticks(Wall(begin_ns, dict(late))) == (published, missed)


def test_ticks_that_the_source_keeps_are_published_late() -> None:
    class Keeper(Metronome):
        ticks_kept = 2

    def kept(late: dict[int, int]) -> tuple[list[int], MissedTicks]:
        return ticks(Wall(600, late), Keeper(ParameterGroup(), MessageTypes()))

    assert kept({623: 645}) == (list(range(61, 72)), MissedTicks())
    assert kept({623: 655}) == ([61, *range(63, 72)], MissedTicks(overruns=1, ticks=1))


def test_endless_run_continues_after_a_cycle() -> None:
    source = Metronome(ParameterGroup(), MessageTypes())
    source.endless = True
    assert ticks(Wall(600), source, 40) == (list(range(61, 101)), MissedTicks())


def test_clock_that_goes_back_restarts_the_run() -> None:
    source = Metronome(ParameterGroup(), MessageTypes())
    assert ticks(Wall(600, steps={643: 23}), source) == ([61, 62, 63, *range(3, 12)], MissedTicks())
    assert source.begun == [600, 23]


def test_clock_stepped_forward_restarts_the_run_without_missed_ticks() -> None:
    source = Metronome(ParameterGroup(), MessageTypes())
    assert ticks(Wall(600, steps={643: 90_000}), source) == ([61, 62, 63, *range(9001, 9012)], MissedTicks())


def test_run_waits_for_the_first_simulated_time() -> None:
    source = Metronome(ParameterGroup(), MessageTypes())
    assert ticks(Wall(0, {1: 600}), source) == (list(range(61, 72)), MissedTicks())
    assert source.begun == [600]
