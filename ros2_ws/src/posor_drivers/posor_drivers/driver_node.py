# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""driver_node: publishes the raw scans of one joint from a source.

Publishes ``raw`` (posor_msgs/RawScan) in the joint's namespace, for instance ``-r __ns:=/joint1``, and the other topics
of the source. Recorded messages are published as recorded unless the parameter group ``conditioning`` asks for means;
the driver does not judge scans, the POSOR node does.
"""

from __future__ import annotations

import math
import time
from functools import partial
from typing import TYPE_CHECKING, Any

from posor.errors import PosorError
from posor.messages.message_definitions import MessageTypes
from posor.parameter_model import help_text
from posor.plugins import registered
from posor.ros_names import RAW_TOPIC
from posor_ros.diagnostics import Level
from posor_ros.freshness import InputMonitor
from posor_ros.intra_process import IntraProcessPublisher
from posor_ros.lifecycle_node import PosorNode
from posor_ros.message_classes import message_class, schema_of_class
from posor_ros.node_program import run_node
from posor_ros.qos import RELIABLE_QOS, result_qos

from posor_drivers.conditioning import condition_scans
from posor_drivers.driver_parameters import (
    DriverParameters,
    LiveDriverParameters,
    ReplayDriverParameters,
    driver_parameters_for,
)
from posor_drivers.live_publisher import LivePublisher
from posor_drivers.replay_publisher import ReplayPublisher, schedule_replay
from posor_drivers.sources.source import ENTRY_POINT_GROUP, LiveSource, RecordedSource, load_source_class
from posor_drivers.stated_times import state_times
from posor_drivers.tick_scheduler import RunCalls

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from posor_ros.diagnostics import Status

    from posor_drivers.sources.source import Input, Source, SourceMessage

DELIVERY_TIMEOUT_S = 10.0
"""Longest wait, after the last message, for slow reliable subscribers before the program ends."""


class DriverNode(PosorNode[DriverParameters]):
    """Publishes the raw scans of one joint, read from a source.

    Each activation replays a recorded source from its beginning; a live source continues with the present tick.
    """

    NAME = "driver_node"
    Parameters = ReplayDriverParameters

    _source: Source[Any]

    def __init__(self, **options: Any) -> None:
        """Create the node; ``options`` go to rclpy."""
        super().__init__(**options)
        self._types = MessageTypes()
        self._topic_publishers: dict[str, IntraProcessPublisher] = {}
        self._counts: dict[str, int] = {}
        self._rate_reference = (time.monotonic(), 0)
        self._run: ReplayPublisher | LivePublisher | None = None
        self._pace: Status | None = None
        self._inputs = InputSubscriptions(self)
        self._status = self.diagnostics.add_status("source")
        self._monitor = InputMonitor(self, lambda _: self._report_source())
        self._source_statuses: dict[str, Status] = {}
        self.diagnostics.add_refresh(self._refresh_diagnostics)

    @classmethod
    def parameter_model(cls, overrides: dict[str, object]) -> type[DriverParameters]:
        """Return the driver's parameters with those of the chosen source as a group."""
        return driver_parameters_for(overrides)

    @classmethod
    def help(cls) -> str:
        """Return the help of the node and of every source."""
        sources = [
            f"Parameters of source '{name}':\n{help_text(load_source_class(name).Parameters, f'{name}.')}"
            for name in registered(ENTRY_POINT_GROUP)
        ]
        return "\n\n".join([super().help(), *sources])

    def configure(self) -> None:
        """Open the source and create all publishers, so subscribers can connect before the first message."""
        name = self.parameters.source
        self._source = load_source_class(name)(getattr(self.parameters, name), self._types)
        topics = self._source.open()
        self.add_cleanup(self._source.close)
        self._classes = {topic.name: message_class(topic.type_name) for topic in topics}
        self._topic_publishers = {topic.name: self._new_publisher(topic.name) for topic in topics}
        if isinstance(self._source, RecordedSource):
            self._source.stopping = self.is_stopping
        if isinstance(self._source, LiveSource):
            self._pace = self._pace or self.diagnostics.add_status("pace")
            self._pace.report(Level.OK, "in time")
            self.add_cleanup(self._inputs.close)
            self._inputs.open(self._source.inputs())
            self._report_source()
        self.add_cleanup(self._monitor.clear)
        self._watch = self._monitor.add_source(f"source '{name}'")
        self._status.report(Level.OK, "ready", {"source": name, "record": self._source.record})

    def _new_publisher(self, topic: str) -> IntraProcessPublisher:
        qos = result_qos(self.parameters) if topic == RAW_TOPIC else RELIABLE_QOS
        return IntraProcessPublisher(self, self._classes[topic], topic, qos)

    def activate(self) -> None:
        """Start the replay, or the run of a live source."""
        self._counts = dict.fromkeys(self._topic_publishers, 0)
        self._rate_reference = (time.monotonic(), 0)
        self._monitor.start()
        self._watch.restart(math.inf)  # no scan is expected before the run begins
        self._start_run()

    def _start_run(self) -> None:
        source, parameters = self._source, self.parameters
        calls = RunCalls(self._publish, self._has_subscribers, self._on_begin, self._on_end)
        if isinstance(source, LiveSource) and isinstance(parameters, LiveDriverParameters):
            self._run = LivePublisher(self, source, parameters.spin_us, self._condition, calls)
        else:
            self._run = ReplayPublisher(self._replay_publications, calls)
        self._run.start()

    def deactivate(self) -> None:
        """Stop the run."""
        self._monitor.stop()
        if self._run is not None and self._run.stop():
            self._status.report(Level.OK, "stopped")

    def _replay_publications(self) -> Iterator[SourceMessage]:
        parameters, source = self.parameters, self._source
        if not (isinstance(parameters, ReplayDriverParameters) and isinstance(source, RecordedSource)):
            message = f"source '{parameters.source}' is neither live nor recorded"
            raise TypeError(message)
        now_ns = self.get_clock().now().nanoseconds
        return self._condition(schedule_replay(source, self._classes, parameters, now_ns))

    def _condition(self, items: Iterator[Any]) -> Iterator[Any]:
        """Return what is to be published of what the source yields."""
        return state_times(condition_scans(items, self.parameters.conditioning), self.parameters.time)

    def _has_subscribers(self) -> bool:
        """Return whether every topic has the subscribers to wait for; report those that are missing."""
        missing = []
        for name, publisher in self._topic_publishers.items():
            parameters = self.parameters
            wanted = parameters.wait_for_subscribers if name == RAW_TOPIC else parameters.wait_for_other_subscribers
            if (count := publisher.subscription_count) < wanted:
                missing.append(f"{publisher.topic_name} ({count} of {wanted})")
        if missing:
            text = "waiting for subscriptions to " + ", ".join(missing)
            if self._status.message != text:
                self.get_logger().info(text)
            self._status.report(Level.OK, text)
        return not missing

    def _publish(self, publication: SourceMessage) -> None:
        topic, data = publication.topic, publication.data
        if not isinstance(data, bytes):
            data = schema_of_class(type(data)).serialize(data)
        if self._topic_publishers[topic].publish(data):
            self._counts[topic] += 1
            if topic == RAW_TOPIC:
                self.timing.record(publication.time_ns)
                self._watch.record(time.monotonic())

    def is_stopping(self) -> bool:
        """Return whether the node or its run is about to stop."""
        return super().is_stopping() or (self._run is not None and self._run.stopping)

    def _on_begin(self) -> None:
        """Report that the run has begun."""
        self._status.report(Level.OK, "running")
        if isinstance(self._source, LiveSource):
            self._watch.restart(time.monotonic())

    def _on_end(self, error: Exception | None) -> None:
        """Report the end of the run, and end the program with it; not called in the executor's thread."""
        self._watch.restart(math.inf)
        self._wait_for_delivery()
        self._update_values()
        level, message = (Level.OK, "ended") if error is None else (Level.ERROR, str(error))
        self._status.report(level, message)
        if error is not None or self.parameters.on_end == "exit":
            self.request_exit(error)

    def _report_source(self) -> None:
        """Report the status lines of a live source."""
        for line in self._source.statuses() if isinstance(self._source, LiveSource) else ():
            if line.name not in self._source_statuses:
                self._source_statuses[line.name] = self.diagnostics.add_status(line.name, logged=True)
            level = Level.ERROR if line.fault else Level.OK
            self._source_statuses[line.name].report(level, line.fault or line.text, line.values)

    def _wait_for_delivery(self) -> None:
        """Wait until every reliable subscription has all messages."""
        deadline = time.monotonic() + DELIVERY_TIMEOUT_S
        for publisher in self._topic_publishers.values():
            received = publisher.wait_for_all_acked(deadline - time.monotonic(), self.is_stopping)
            if not received and not self.is_stopping():
                self.get_logger().warning(f"not all messages of {publisher.topic_name} were received")

    def _refresh_diagnostics(self) -> None:
        """Update the diagnostics, and restart the run after a change between wall time and simulated time."""
        self._update_values()
        if isinstance(self._run, LivePublisher) and self._run.clock_has_changed and self._run.stop():
            self._start_run()

    def _update_values(self) -> None:
        """Update counts and rate in the diagnostics."""
        now, count = time.monotonic(), self._counts.get(RAW_TOPIC, 0)
        before, counted = self._rate_reference
        self._rate_reference = (now, count)
        rate = (count - counted) / (now - before) if now > before else 0.0
        messages = sum(self._counts.values())
        self._status.update({"scans_published": count, "messages_published": messages, "scans_per_second": rate})
        if self._pace is not None and isinstance(self._run, LivePublisher):
            self._run.report_pace(self._pace)


class InputSubscriptions:
    """Subscriptions of a live source with a status line for each; the lines stay when subscriptions are closed."""

    def __init__(self, node: PosorNode[Any]) -> None:
        """Start without subscriptions."""
        self._node = node
        self._statuses: dict[str, Status] = {}
        self._counts: dict[str, dict[str, int]] = {}
        self._subscriptions: list[Any] = []

    def open(self, inputs: Sequence[Input]) -> None:
        """Subscribe to all inputs."""
        for source_input in inputs:
            name = source_input.topic.name
            if name not in self._statuses:
                self._statuses[name] = self._node.diagnostics.add_status(f"input {name}")
            self._counts[name] = {"taken": 0, "refused": 0}
            self._statuses[name].report(Level.OK, "no message yet", self._counts[name])
            callback = partial(self._on_message, source_input)
            kind = message_class(source_input.topic.type_name)
            self._subscriptions.append(self._node.create_subscription(kind, name, callback, RELIABLE_QOS))

    def close(self) -> None:
        """Close all subscriptions."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []

    def _on_message(self, source_input: Input, message: Any) -> None:
        name = source_input.topic.name
        counts, status = self._counts[name], self._statuses[name]
        try:
            source_input.on_message(message, self._node.get_clock().now().nanoseconds)
        except PosorError as error:
            counts["refused"] += 1
            status.report(Level.WARN, "refused", {**counts, "reason": str(error)})
        else:
            counts["taken"] += 1
            status.report(Level.OK, "taken", {**counts})


def main() -> int:
    """Run the node as a program."""
    return run_node(DriverNode)
