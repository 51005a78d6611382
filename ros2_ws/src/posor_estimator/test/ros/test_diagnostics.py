"""A node's diagnostics, in pieces that go between the ticks of its process."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from posor_estimator.ros import diagnostics as module
from posor_estimator.ros.diagnostics import Diagnostics, Level
from posor_estimator.ros.qos import DIAGNOSTICS_TOPIC
from posor_estimator.testing.graph import Graph

pytestmark = pytest.mark.usefixtures("ros_domain")


def test_what_is_new_while_the_rest_waits_is_never_followed_by_what_is_old(monkeypatch: pytest.MonkeyPatch) -> None:
    """The message of the second is ready when a status changes: that goes out at once, the message no more."""
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
