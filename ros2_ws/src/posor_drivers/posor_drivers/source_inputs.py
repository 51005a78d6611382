"""What a live source listens to: subscriptions whose refusals are told in the diagnostics."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from posor_estimator.errors import PosorError
from posor_estimator.ros.diagnostics import Level
from posor_estimator.ros.message_types import message_class
from posor_estimator.ros.qos import RELIABLE_QOS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.ros.diagnostics import Status
    from posor_estimator.ros.node import PosorNode

    from posor_drivers.sources.base import Input


class SourceInputs:
    """The subscriptions of a source, with a status line for each; lines stay when subscriptions are closed."""

    def __init__(self, node: PosorNode[Any]) -> None:
        """Subscribe to nothing yet."""
        self._node = node
        self._statuses: dict[str, Status] = {}
        self._counts: dict[str, dict[str, int]] = {}
        self._subscriptions: list[Any] = []

    def open(self, inputs: Sequence[Input]) -> None:
        """Subscribe."""
        for entry in inputs:
            name = entry.topic.name
            if name not in self._statuses:
                self._statuses[name] = self._node.diagnostics.add(f"input {name}")
            self._counts[name] = {"taken": 0, "refused": 0}
            self._statuses[name].report(Level.OK, "nothing has come yet", self._counts[name])
            kind = message_class(entry.topic.type_name)
            self._subscriptions.append(
                self._node.create_subscription(kind, name, partial(self._take, entry), RELIABLE_QOS)
            )

    def close(self) -> None:
        """Unsubscribe."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []

    def _take(self, entry: Input, message: Any) -> None:
        counts, status = self._counts[entry.topic.name], self._statuses[entry.topic.name]
        try:
            entry.take(message, self._node.get_clock().now().nanoseconds)
        except PosorError as error:
            counts["refused"] += 1
            status.report(Level.WARN, "refused", {**counts, "reason": str(error)})
        else:
            counts["taken"] += 1
            status.report(Level.OK, "taken", {**counts})
