from __future__ import annotations

import time
from threading import Event
from typing import TYPE_CHECKING

from posor_drivers.replayer import Replayer, ReplayState
from posor_drivers.timeline import Due
from posor_estimator.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator


class Stage:
    """Stands in for the node around a replayer, and writes down what happens."""

    def __init__(self, *dues: Due, failure: Exception | None = None) -> None:
        self.dues = dues
        self.failure = failure
        self.listening = True
        self.asked = Event()
        self.published: list[tuple[str, float]] = []
        self.first = Event()
        self.states: list[ReplayState] = []
        self.error: Exception | None = None
        self.over = Event()
        self.replayer = Replayer(self.timeline, self.publish, self.may_start, self.on_state)

    def timeline(self) -> Iterator[Due]:
        yield from self.dues
        if self.failure is not None:
            raise self.failure

    def may_start(self) -> bool:
        self.asked.set()
        return self.listening

    def publish(self, due: Due) -> None:
        self.published.append((due.topic, time.monotonic()))
        self.first.set()

    def on_state(self, state: ReplayState, error: Exception | None) -> None:
        self.states.append(state)
        if state in (ReplayState.ENDED, ReplayState.FAILED):
            self.error = error
            self.over.set()


def test_nothing_is_published_before_it_is_due() -> None:
    stage = Stage(*(Due(str(number), b"", 0.02 * number) for number in range(6)))
    begin = time.monotonic()
    stage.replayer.start()
    assert stage.over.wait(30.0)
    assert [topic for topic, _ in stage.published] == [str(number) for number in range(6)]
    assert all(at - begin >= 0.02 * number for number, (_, at) in enumerate(stage.published))
    assert stage.states == [ReplayState.WAITING, ReplayState.RUNNING, ReplayState.ENDED]
    stage.replayer.stop()


def test_replay_waits_for_listeners() -> None:
    stage = Stage(Due("a", b"", 0.0))
    stage.listening = False
    stage.replayer.start()
    assert stage.asked.wait(30.0)
    assert stage.published == []
    stage.listening = True
    assert stage.over.wait(30.0)
    assert len(stage.published) == 1
    stage.replayer.stop()
    assert not stage.replayer.stop()


def test_replay_can_be_stopped_while_it_waits_for_listeners() -> None:
    stage = Stage(Due("a", b"", 0.0))
    stage.listening = False
    stage.replayer.start()
    assert stage.asked.wait(30.0)
    stage.replayer.stop()
    assert stage.published == []
    assert stage.states == [ReplayState.WAITING]


def test_replay_can_be_stopped_between_messages() -> None:
    stage = Stage(Due("a", b"", 0.0), Due("b", b"", 1000.0))
    stage.replayer.start()
    assert stage.first.wait(30.0)
    assert stage.replayer.stop()
    assert [topic for topic, _ in stage.published] == ["a"]
    assert stage.states == [ReplayState.WAITING, ReplayState.RUNNING]


def test_failure_of_the_source_is_handed_on() -> None:
    for failure in (BagError("is broken"), KeyError("a bug")):
        stage = Stage(Due("a", b"", 0.0), failure=failure)
        stage.replayer.start()
        assert stage.over.wait(30.0)
        assert stage.states[-1] is ReplayState.FAILED
        assert stage.error is failure
        assert len(stage.published) == 1
        stage.replayer.stop()
