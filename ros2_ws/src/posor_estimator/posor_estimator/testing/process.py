"""Nodes of one rclpy context in the test's own process: what they tell each other stays within it, as when composed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Self, TypeVar

import rclpy
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter

from posor_estimator.ros.node import PosorNode

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import TracebackType

NodeT = TypeVar("NodeT", bound=PosorNode[Any])


class Process:
    """Stands for a process: two of them reach each other over DDS only. A ``with`` block ends it.

    Attributes:
        nodes: Those started so far.

    """

    def __init__(self) -> None:
        """Start without nodes."""
        self._context = Context()
        rclpy.init(context=self._context)
        self._executor = EventsExecutor(context=self._context)
        self.nodes: list[PosorNode[Any]] = []

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the nodes, the last one first."""
        for node in reversed(self.nodes):
            self._executor.remove_node(node)
            node.stop()
        self._executor.shutdown()
        self._context.try_shutdown()

    def start(
        self, node_class: type[NodeT], namespace: str = "", parameters: Mapping[str, object] | None = None
    ) -> NodeT:
        """Return a new node, configured and active."""
        overrides = [Parameter(name, value=value) for name, value in (parameters or {}).items()]
        node = node_class(context=self._context, namespace=namespace, parameter_overrides=overrides)
        self.nodes.append(node)
        node.start()
        self._executor.add_node(node)
        return node

    def turn(self) -> None:
        """Let one event happen, or a short time pass."""
        self._executor.spin_once(timeout_sec=0.01)
