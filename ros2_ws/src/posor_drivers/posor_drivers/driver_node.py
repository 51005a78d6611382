"""driver_node: publishes the raw scans of one joint, from whatever source.

Publishes ``raw`` (posor_msgs/RawScan) in the joint's namespace, for instance ``-r __ns:=/joint1``, and whatever else
the source holds. What a source recorded is passed on as recorded, unless parameter group ``conditioning`` asks for
means of several scans: whether a scan is any good is for the POSOR node to judge.
"""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING, Any

from posor_estimator.ros.diagnostics import Level
from posor_estimator.ros.main import run
from posor_estimator.ros.message_types import MessageTypes, message_class
from posor_estimator.ros.node import PosorNode
from posor_estimator.ros.parameters import help_text
from posor_estimator.ros.qos import RAW_TOPIC, RELIABLE_QOS, sensor_qos
from posor_estimator.ros.wire import Outlet
from rclpy.serialization import serialize_message

from posor_drivers.conditioned_scans import conditioned
from posor_drivers.driver_parameters import (
    DriverParameters,
    LiveDriverParameters,
    ReplayDriverParameters,
    parameters_for,
)
from posor_drivers.live import Misses, live
from posor_drivers.live_run import LiveRun
from posor_drivers.pace import Pace
from posor_drivers.replayer import Replayer, ReplayState
from posor_drivers.source_inputs import SourceInputs
from posor_drivers.sources.base import LiveSource, RecordedSource
from posor_drivers.sources.registry import source_class, source_entries
from posor_drivers.timeline import timeline

if TYPE_CHECKING:
    from collections.abc import Iterator

    from posor_drivers.ros_time import RosTime
    from posor_drivers.sources.base import Source
    from posor_drivers.timeline import Due, Pause

DELIVERY_S = 10.0
"""How long to wait, after the last message, for slow reliable subscribers before the program ends."""


class DriverNode(PosorNode[DriverParameters]):
    """Publishes the raw scans of one joint, read from a source.

    Each activation replays a recorded source from its beginning; a live one goes on with the present tick.
    """

    NAME = "driver_node"
    Parameters = ReplayDriverParameters

    _source: Source[Any]

    def __init__(self, **options: Any) -> None:
        """Create the node; ``options`` go to rclpy."""
        super().__init__(**options)
        self._types = MessageTypes()
        self._outputs: dict[str, Outlet] = {}
        self._counts: dict[str, int] = {}
        self._rated = (time.monotonic(), 0)
        self._run: Replayer | LiveRun | None = None
        self._pace: Pace | None = None
        self._inputs = SourceInputs(self)
        self._status = self.diagnostics.add("source")
        self.diagnostics.before_each(self._refresh)

    @classmethod
    def parameter_model(cls, overrides: dict[str, object]) -> type[DriverParameters]:
        """Return the driver's parameters and, as a group, those of the source that the user chose."""
        return parameters_for(overrides)

    @classmethod
    def help(cls) -> str:
        """Return the help of the node and of every source."""
        sources = [
            f"Parameters of source '{name}':\n{help_text(source_class(name).Parameters, f'{name}.')}"
            for name in source_entries()
        ]
        return "\n\n".join([super().help(), *sources])

    def configure(self) -> None:
        """Open the source and make the publishers, so that listeners can match before anything is published."""
        name = self.parameters.source
        self._source = source_class(name)(getattr(self.parameters, name), self._types)
        topics = self._source.open()
        self.when_cleaned_up(self._source.close)
        self._classes = {topic.name: message_class(topic.type_name) for topic in topics}
        self._outputs = {topic.name: self._output(topic.name) for topic in topics}
        if isinstance(self._source, LiveSource):
            self._pace = self._pace or Pace(self.diagnostics.add("pace"), self.get_logger())
            self.when_cleaned_up(self._inputs.close)
            self._inputs.open(self._source.inputs())
        self._status.report(Level.OK, "ready", {"source": name, "record": self._source.record})

    def _output(self, topic: str) -> Outlet:
        qos = sensor_qos(self.parameters) if topic == RAW_TOPIC else RELIABLE_QOS
        return Outlet(self, self._classes[topic], topic, qos, given_up=lambda: self._stopping)

    def activate(self) -> None:
        """Begin the replay, or the scans of a live source."""
        self._counts = dict.fromkeys(self._outputs, 0)
        self._rated = (time.monotonic(), 0)
        self._run = self._new_run()
        self._run.start()

    def _new_run(self) -> Replayer | LiveRun:
        source, parameters = self._source, self.parameters
        if isinstance(source, LiveSource) and isinstance(parameters, LiveDriverParameters) and self._pace is not None:
            dues = partial(self._live, source, self._pace.restarted())
            listened = self._has_listeners
            run = LiveRun(self, source.rate, parameters.spin_us, dues, self._publish, listened, self._on_state)
            self._pace.follow(run)
            return run
        return Replayer(self._recorded, self._publish, self._has_listeners, self._on_state)

    def deactivate(self) -> None:
        """End it."""
        if self._run is not None and self._run.stop():
            self._status.report(Level.OK, "stopped")

    def _recorded(self) -> Iterator[Due]:
        parameters, source = self.parameters, self._source
        if not (isinstance(parameters, ReplayDriverParameters) and isinstance(source, RecordedSource)):
            message = f"source '{parameters.source}' is neither live nor recorded"
            raise TypeError(message)
        now_ns = self.get_clock().now().nanoseconds
        return conditioned(timeline(source, self._classes, parameters, now_ns), parameters.conditioning)

    def _live(self, source: LiveSource[Any], misses: Misses, time: RosTime) -> Iterator[Due | Pause]:
        return conditioned(live(source, time, misses), self.parameters.conditioning)

    def _has_listeners(self) -> bool:
        missing = []
        for name, output in self._outputs.items():
            scans = name == RAW_TOPIC
            wanted = self.parameters.wait_for_subscribers if scans else self.parameters.wait_for_other_subscribers
            if (count := output.count) < wanted:
                missing.append(f"{output.topic_name} ({count} of {wanted})")
        if missing:
            self._status.report(Level.OK, "waiting for subscriptions to " + ", ".join(missing))
        return not missing

    def _publish(self, due: Due) -> None:
        """Publish one message."""
        topic, data = due.topic, due.content
        if not isinstance(data, bytes):
            data = serialize_message(data)
        if self._outputs[topic].publish(data):
            self._counts[topic] += 1
            if topic == RAW_TOPIC:
                self.timing.note(due.stamp_ns)

    @property
    def _stopping(self) -> bool:
        return self._run is not None and self._run.stopping

    def _on_state(self, state: ReplayState, error: Exception | None) -> None:
        """Report what the replay does, and end the program with it. Not in the executor's thread."""
        if state is ReplayState.RUNNING:
            self._status.report(Level.OK, "running")
        elif state in (ReplayState.ENDED, ReplayState.FAILED):
            self._deliver()
            self._tell()
            level, message = (Level.OK, "ended") if error is None else (Level.ERROR, str(error))
            self._status.report(level, message)
            if error is not None or self.parameters.on_end == "exit":
                self.request_exit(error)

    def _deliver(self) -> None:
        """Wait until every reliable subscription has all messages."""
        deadline = time.monotonic() + DELIVERY_S
        for output in self._outputs.values():
            if not output.deliver(deadline - time.monotonic(), lambda: self._stopping) and not self._stopping:
                self.get_logger().warning(f"not all messages of {output.topic_name} were received")

    def _refresh(self) -> None:
        """Bring the diagnostics up to date, and begin anew where the time has become simulated, or is no longer."""
        self._tell()
        if isinstance(self._run, LiveRun) and self._run.clock_has_changed and self._run.stop():
            self._run = self._new_run()
            self._run.start()

    def _tell(self) -> None:
        """Bring counts and rate up to date."""
        now, count = time.monotonic(), self._counts.get(RAW_TOPIC, 0)
        before, counted = self._rated
        self._rated = (now, count)
        rate = (count - counted) / (now - before) if now > before else 0.0
        messages = sum(self._counts.values())
        self._status.update({"scans_published": count, "messages_published": messages, "scans_per_second": rate})
        if self._pace is not None:
            self._pace.report()


def main() -> int:
    """Run the node as a program."""
    return run(DriverNode)
