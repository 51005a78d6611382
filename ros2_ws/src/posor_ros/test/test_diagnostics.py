# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a node: formatted and published by the executor's thread, between the ticks of its process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import Thread, current_thread

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from posor.ros_names import DIAGNOSTICS_TOPIC
from posor_lab.harness.graph import Graph, values_of
from posor_ros import diagnostics as diagnostics_module
from posor_ros.diagnostics import (
    MAX_QUEUED,
    MIN_INTERVAL_S,
    Diagnostics,
    LastingErrorLog,
    Level,
    StatusReport,
    StatusText,
)
from posor_ros.qos import RELIABLE_QOS

pytestmark = pytest.mark.usefixtures("ros_domain")

CHANGES = 1000


class Observer:
    def __init__(self, graph: Graph, reporter: Graph) -> None:
        self.graph, self.reporter = graph, reporter
        self.diagnostics = Diagnostics(reporter.node)
        self.messages: list[DiagnosticArray] = graph.collect(DiagnosticArray, DIAGNOSTICS_TOPIC)
        publisher = reporter.node.create_publisher(DiagnosticArray, DIAGNOSTICS_TOPIC, RELIABLE_QOS)
        self.wait_until(lambda: publisher.get_subscription_count() > 0, "the subscription")

    def wait_until(self, condition: Callable[[], bool], what: str) -> None:
        """Wait while the executor of the reporting node works."""
        self.graph.wait_until(condition, what, self.reporter.receive)

    def first_status_messages(self) -> list[str]:
        return [message.status[0].message for message in self.messages]


@pytest.fixture
def observer() -> Iterator[Observer]:
    with Graph() as graph, Graph() as reporter:
        yield Observer(graph, reporter)


def run_in_thread(work: Callable[[], None]) -> None:
    thread = Thread(target=work)
    thread.start()
    thread.join()


def test_the_executors_thread_formats_and_publishes_reports_of_another_thread(observer: Observer) -> None:
    status = observer.diagnostics.add_status("status")
    threads = []

    def format_report() -> StatusText:
        threads.append(current_thread())
        return "lost", {"reason": "a cable"}

    def report_scans() -> None:
        status.report_status_change(Level.ERROR, format_report)
        status.report(Level.OK, "ok", {"scans": 2})

    run_in_thread(report_scans)
    assert threads == []
    observer.wait_until(lambda: observer.first_status_messages()[-1:] == ["ok"], "the present report")
    assert observer.first_status_messages() == ["lost", "ok"]
    assert threads == [current_thread()]
    lost, ok = (message.status[0] for message in observer.messages)
    assert lost.level == DiagnosticStatus.ERROR
    assert values_of(lost)["reason"] == "a cable"
    assert values_of(ok)["scans"] == "2"


def test_a_state_that_changes_at_every_scan_costs_few_messages_and_no_error_is_hidden(observer: Observer) -> None:
    status, last = observer.diagnostics.add_status("status"), observer.diagnostics.add_status("last")
    formatted = []

    def format_lost(number: int) -> StatusText:
        formatted.append(number)
        return f"lost {number}", {}

    def report_scans() -> None:
        status.report(Level.WARN, "degraded")
        for number in range(CHANGES):
            status.report_status_change(Level.ERROR, lambda number=number: format_lost(number))  # type: ignore[misc]
            status.report(Level.OK, "ok")
        last.report(Level.OK, "done")

    run_in_thread(report_scans)

    def is_up_to_date() -> bool:
        messages = observer.messages
        return bool(messages) and [status.message for status in messages[-1].status] == ["ok", "done"]

    observer.wait_until(is_up_to_date, "the present report")
    assert formatted == list(range(CHANGES - MAX_QUEUED + 1, CHANGES))
    assert observer.first_status_messages()[: MAX_QUEUED - 1] == [f"lost {number}" for number in formatted]


def test_a_change_waits_for_the_shortest_interval_between_publications(
    observer: Observer, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s, polls = 100.0, 0

    def monotonic() -> float:
        nonlocal polls
        polls += 1
        return now_s

    monkeypatch.setattr(diagnostics_module, "monotonic", monotonic)
    monkeypatch.setattr(diagnostics_module, "PERIOD_S", 1000.0)
    status = observer.diagnostics.add_status("status")
    status.report(Level.OK, "ok")
    observer.wait_until(lambda: bool(observer.messages), "the first message")
    kept = observer.reporter.node.default_callback_group.entities  # of which rclpy forgets none
    entities = len(kept)
    status.report(Level.WARN, "degraded")
    before = polls
    observer.wait_until(lambda: polls >= before + 3, "three polls of a stopped clock")
    assert observer.first_status_messages() == ["ok"]
    now_s += MIN_INTERVAL_S
    observer.wait_until(lambda: len(observer.messages) > 1, "the second message")
    assert observer.first_status_messages()[1] == "degraded"
    assert len(kept) == entities


def test_queued_reports_are_published_when_the_node_ends(observer: Observer) -> None:
    status = observer.diagnostics.add_status("status")
    status.report(Level.OK, "running")
    observer.wait_until(lambda: bool(observer.messages), "the first message")
    status.report(Level.WARN, "stopped")
    status.report(Level.OK, "ended")
    observer.diagnostics.close()
    status.report(Level.ERROR, "never")
    observer.graph.wait_until(lambda: observer.first_status_messages()[-1] == "ended", "the last message")
    assert observer.first_status_messages()[-2:] == ["stopped", "ended"]
    observer.reporter.receive()
    assert status.message == "never"


def test_a_lasting_error_and_its_end_are_logged_once(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    now_s = 100.0
    monkeypatch.setattr(diagnostics_module, "monotonic", lambda: now_s)
    with Graph() as graph:
        log = LastingErrorLog(graph.node, "estimate")
        lost = StatusReport(Level.ERROR, "lost: RANGE", {"reason": "scan 7: too far."})
        ok = StatusReport(Level.OK, "ok", {})
        for report in (lost, ok, lost, lost):
            log.add(report)
        now_s += 1.9
        log.add(lost)
        assert capfd.readouterr().err == ""
        for _ in range(3):
            now_s += 0.2
            log.add(lost)
        for report in (StatusReport(Level.WARN, "lost once", {}), ok, ok):
            log.add(report)
    error, warning, end = capfd.readouterr().err.splitlines()
    assert error.startswith("[ERROR]")
    assert error.endswith("[test_graph]: estimate: lost: RANGE; scan 7: too far.")
    assert (warning.startswith("[INFO]"), end.startswith("[INFO]")) == (True, True)
    assert warning.endswith("[test_graph]: estimate: lost once")
    assert end.endswith("[test_graph]: estimate: ok")


def test_a_report_during_the_wait_for_an_idle_moment_is_not_followed_by_an_older_one(
    observer: Observer, monkeypatch: pytest.MonkeyPatch
) -> None:
    status, last = observer.diagnostics.add_status("status"), observer.diagnostics.add_status("last")
    waits = []

    def run_when_idle(work: Callable[[], None]) -> None:
        waits.append(status.message)
        if status.message == "old" and len(waits) % 2 == 0:
            status.report(Level.ERROR, "new")
        work()

    status.report(Level.OK, "old")
    observer.wait_until(lambda: bool(observer.messages), "the first message")
    monkeypatch.setattr(diagnostics_module, "run_when_idle", run_when_idle)
    observer.wait_until(lambda: status.message == "new", "a second to pass")
    last.report(Level.OK, "the last")
    observer.wait_until(lambda: observer.messages[-1].status[-1].message == "the last", "the last message")
    messages = observer.first_status_messages()
    assert messages == sorted(messages, reverse=True)
    assert messages.count("new") >= 2
