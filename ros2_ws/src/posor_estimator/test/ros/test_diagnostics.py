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
    from collections.abc import Callable

    from posor_estimator.ros.diagnostics import Words

pytestmark = pytest.mark.usefixtures("ros_domain")

FLAPS = 1000


def heard(graph: Graph, other: Graph) -> list[DiagnosticArray]:
    """Return the list into which the other graph's diagnostics come, once they are heard."""
    messages: list[DiagnosticArray] = graph.collect(DiagnosticArray, DIAGNOSTICS_TOPIC)
    publisher = other.node.create_publisher(DiagnosticArray, DIAGNOSTICS_TOPIC, RELIABLE_QOS)
    graph.wait_until(lambda: publisher.get_subscription_count() > 0, "a listener", other.receive)
    return messages


def done_in_a_thread(work: Callable[[], None]) -> None:
    """Do something in a thread of its own, as scans come."""
    thread = Thread(target=work)
    thread.start()
    thread.join()


def test_what_is_said_in_the_thread_of_the_scans_is_put_into_words_and_published_in_the_executors() -> None:
    with Graph() as graph, Graph() as other:
        diagnostics = Diagnostics(other.node)
        messages = heard(graph, other)
        line = diagnostics.add("line")
        threads = []

        def words() -> Words:
            threads.append(current_thread())
            return "lost", {"reason": "a cable"}

        def scans() -> None:
            line.report_news(Level.ERROR, words)
            line.report(Level.OK, "ok", {"scans": 2})

        done_in_a_thread(scans)
        assert threads == []

        def said() -> list[str]:
            return [message.status[0].message for message in messages]

        graph.wait_until(lambda: said()[-1:] == ["ok"], "what holds now", other.receive)
        assert said() == ["lost", "ok"]
        assert threads == [current_thread()]
        assert messages[0].status[0].level == DiagnosticStatus.ERROR
        assert values_of(messages[0].status[0])["reason"] == "a cable"
        assert values_of(messages[1].status[0])["scans"] == "2"


def test_a_state_that_comes_and_goes_at_every_scan_costs_a_few_messages_and_none_of_the_bad_ones_is_hidden() -> None:
    with Graph() as graph, Graph() as other:
        diagnostics = Diagnostics(other.node)
        messages = heard(graph, other)
        line, last = diagnostics.add("line"), diagnostics.add("last")
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
            return bool(messages) and [status.message for status in messages[-1].status] == ["ok", "done"]

        graph.wait_until(holds, "what holds now", other.receive)
        assert told == list(range(FLAPS - MOST_WAITING + 1, FLAPS))
        assert [message.status[0].message for message in messages][: MOST_WAITING - 1] == [f"lost {n}" for n in told]


def test_changes_wait_until_the_least_time_since_the_last_publication_has_gone_by(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_s, looks = 100.0, 0

    def monotonic() -> float:
        nonlocal looks
        looks += 1
        return now_s

    monkeypatch.setattr(module, "monotonic", monotonic)
    monkeypatch.setattr(module, "PERIOD_S", 1000.0)
    with Graph() as graph, Graph() as other:
        diagnostics = Diagnostics(other.node)
        messages = heard(graph, other)
        line = diagnostics.add("line")
        line.report(Level.OK, "ok")
        graph.wait_until(lambda: bool(messages), "the first message", other.receive)
        line.report(Level.WARN, "degraded")
        before = looks
        graph.wait_until(lambda: looks >= before + 3, "three looks at a clock that stands", other.receive)
        assert [message.status[0].message for message in messages] == ["ok"]
        now_s += LEAST_S
        graph.wait_until(lambda: len(messages) > 1, "the second message", other.receive)
        assert messages[1].status[0].message == "degraded"


def test_what_has_not_been_said_yet_is_said_when_the_node_ends() -> None:
    with Graph() as graph, Graph() as other:
        diagnostics = Diagnostics(other.node)
        messages = heard(graph, other)
        line = diagnostics.add("line")
        line.report(Level.OK, "running")
        graph.wait_until(lambda: bool(messages), "the first message", other.receive)
        line.report(Level.WARN, "stopped")
        line.report(Level.OK, "ended")
        diagnostics.close()
        line.report(Level.ERROR, "never")
        graph.wait_until(lambda: messages[-1].status[0].message == "ended", "the last message")
        assert [message.status[0].message for message in messages][-2:] == ["stopped", "ended"]
        other.receive()
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


def test_what_is_new_while_the_rest_waits_is_never_followed_by_what_is_old(monkeypatch: pytest.MonkeyPatch) -> None:
    """A status changes while the node waits for a time between ticks to say what it said a second ago."""
    with Graph() as graph, Graph() as other:
        messages = graph.collect(DiagnosticArray, DIAGNOSTICS_TOPIC)
        diagnostics = Diagnostics(other.node)
        line, last = diagnostics.add("line"), diagnostics.add("last")
        looks = []

        def between_ticks() -> bool:
            looks.append(line.message)
            if line.message == "old" and len(looks) % 2 == 0:
                line.report(Level.ERROR, "new")
            return True

        line.report(Level.OK, "old")
        graph.wait_until(lambda: bool(messages), "the first message", other.receive)
        monkeypatch.setattr(module, "between_ticks", between_ticks)
        graph.wait_until(lambda: line.message == "new", "a second to pass", other.receive)
        last.report(Level.OK, "the last")
        graph.wait_until(lambda: messages[-1].status[-1].message == "the last", "the last message", other.receive)
        said = [message.status[0].message for message in messages]
        assert said == sorted(said, reverse=True)
        assert said.count("new") >= 2
