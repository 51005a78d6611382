"""A node's diagnostics: put into words and published by the executor's thread, between the ticks of its process."""

from __future__ import annotations

from threading import Thread, current_thread
from typing import TYPE_CHECKING

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from posor_estimator.ros import diagnostics as module
from posor_estimator.ros.diagnostics import LEAST_S, MOST_WAITING, Diagnostics, Level, Log, Said
from posor_estimator.ros.qos import DIAGNOSTICS_TOPIC, RELIABLE_QOS
from posor_estimator.testing.graph import Graph, values_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from posor_estimator.ros.diagnostics import Words

pytestmark = pytest.mark.usefixtures("ros_domain")

FLAPS = 1000


class Heard:
    """A node's diagnostics, and the messages that come of them over DDS."""

    def __init__(self, graph: Graph, other: Graph) -> None:
        self.graph, self.other = graph, other
        self.diagnostics = Diagnostics(other.node)
        self.messages: list[DiagnosticArray] = graph.collect(DiagnosticArray, DIAGNOSTICS_TOPIC)
        publisher = other.node.create_publisher(DiagnosticArray, DIAGNOSTICS_TOPIC, RELIABLE_QOS)
        self.wait_until(lambda: publisher.get_subscription_count() > 0, "a listener")

    def wait_until(self, holds: Callable[[], bool], what: str) -> None:
        """Wait while the node's executor works."""
        self.graph.wait_until(holds, what, self.other.receive)

    def said(self) -> list[str]:
        """Return what the first line said in each message."""
        return [message.status[0].message for message in self.messages]


@pytest.fixture
def heard() -> Iterator[Heard]:
    with Graph() as graph, Graph() as other:
        yield Heard(graph, other)


def done_in_a_thread(work: Callable[[], None]) -> None:
    """Do something in a thread of its own, as scans come."""
    thread = Thread(target=work)
    thread.start()
    thread.join()


def test_what_is_said_in_the_thread_of_the_scans_is_put_into_words_and_published_in_the_executors(heard: Heard) -> None:
    line = heard.diagnostics.add("line")
    threads = []

    def words() -> Words:
        threads.append(current_thread())
        return "lost", {"reason": "a cable"}

    def scans() -> None:
        line.report_news(Level.ERROR, words)
        line.report(Level.OK, "ok", {"scans": 2})

    done_in_a_thread(scans)
    assert threads == []
    heard.wait_until(lambda: heard.said()[-1:] == ["ok"], "what holds now")
    assert heard.said() == ["lost", "ok"]
    assert threads == [current_thread()]
    lost, ok = (message.status[0] for message in heard.messages)
    assert lost.level == DiagnosticStatus.ERROR
    assert values_of(lost)["reason"] == "a cable"
    assert values_of(ok)["scans"] == "2"


def test_a_state_that_comes_and_goes_at_every_scan_costs_a_few_messages_and_none_of_the_bad_ones_is_hidden(
    heard: Heard,
) -> None:
    line, last = heard.diagnostics.add("line"), heard.diagnostics.add("last")
    told = []

    def lost(number: int) -> Words:
        told.append(number)
        return f"lost {number}", {}

    def scans() -> None:
        line.report(Level.WARN, "degraded")
        for number in range(FLAPS):
            line.report_news(Level.ERROR, lambda number=number: lost(number))  # type: ignore[misc]
            line.report(Level.OK, "ok")
        last.report(Level.OK, "done")

    done_in_a_thread(scans)

    def holds() -> bool:
        return bool(heard.messages) and [status.message for status in heard.messages[-1].status] == ["ok", "done"]

    heard.wait_until(holds, "what holds now")
    assert told == list(range(FLAPS - MOST_WAITING + 1, FLAPS))
    assert heard.said()[: MOST_WAITING - 1] == [f"lost {n}" for n in told]


def test_changes_wait_until_the_least_time_since_the_last_publication_has_gone_by(
    heard: Heard, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s, looks = 100.0, 0

    def monotonic() -> float:
        nonlocal looks
        looks += 1
        return now_s

    monkeypatch.setattr(module, "monotonic", monotonic)
    monkeypatch.setattr(module, "PERIOD_S", 1000.0)
    line = heard.diagnostics.add("line")
    line.report(Level.OK, "ok")
    heard.wait_until(lambda: bool(heard.messages), "the first message")
    line.report(Level.WARN, "degraded")
    before = looks
    heard.wait_until(lambda: looks >= before + 3, "three looks at a clock that stands")
    assert heard.said() == ["ok"]
    now_s += LEAST_S
    heard.wait_until(lambda: len(heard.messages) > 1, "the second message")
    assert heard.said()[1] == "degraded"


def test_what_has_not_been_said_yet_is_said_when_the_node_ends(heard: Heard) -> None:
    line = heard.diagnostics.add("line")
    line.report(Level.OK, "running")
    heard.wait_until(lambda: bool(heard.messages), "the first message")
    line.report(Level.WARN, "stopped")
    line.report(Level.OK, "ended")
    heard.diagnostics.close()
    line.report(Level.ERROR, "never")
    heard.graph.wait_until(lambda: heard.said()[-1] == "ended", "the last message")
    assert heard.said()[-2:] == ["stopped", "ended"]
    heard.other.receive()
    assert line.message == "never"


def test_an_error_that_lasts_goes_into_the_log_once_and_so_does_its_end(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    now_s = 100.0
    monkeypatch.setattr(module, "monotonic", lambda: now_s)
    with Graph() as graph:
        log = Log(graph.node, "estimate")
        lost = Said(Level.ERROR, "lost: RANGE", {"reason": "scan 7: too far."}, None)
        fine = Said(Level.OK, "ok", {}, None)
        for said in (lost, fine, lost, lost):
            log.note(said)
        now_s += 1.9
        log.note(lost)
        assert capfd.readouterr().err == ""
        for _ in range(3):
            now_s += 0.2
            log.note(lost)
        for _ in range(2):
            log.note(fine)
    error, end = capfd.readouterr().err.splitlines()
    assert error.startswith("[ERROR]")
    assert error.endswith("[test_graph]: estimate: lost: RANGE; scan 7: too far.")
    assert end.startswith("[INFO]")
    assert end.endswith("[test_graph]: estimate: ok")


def test_what_is_new_while_the_rest_waits_is_never_followed_by_what_is_old(
    heard: Heard, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A status changes while the node waits for a time between ticks to say what it said a second ago."""
    line, last = heard.diagnostics.add("line"), heard.diagnostics.add("last")
    looks = []

    def between_ticks() -> bool:
        looks.append(line.message)
        if line.message == "old" and len(looks) % 2 == 0:
            line.report(Level.ERROR, "new")
        return True

    line.report(Level.OK, "old")
    heard.wait_until(lambda: bool(heard.messages), "the first message")
    monkeypatch.setattr(module, "between_ticks", between_ticks)
    heard.wait_until(lambda: line.message == "new", "a second to pass")
    last.report(Level.OK, "the last")
    heard.wait_until(lambda: heard.messages[-1].status[-1].message == "the last", "the last message")
    said = heard.said()
    assert said == sorted(said, reverse=True)
    assert said.count("new") >= 2
